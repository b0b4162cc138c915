"""The nearest points of places anywhere, found in several trees one after the other."""

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.closest import NO_RANK
from dynahull.kernels.compiled_kernels import grown_tree, kernels
from dynahull.kernels.tree import make_walk
from dynahull.threads import over_ranges

_PLACES_AT_A_TIME = 20_000


class NearestSearch:
    """The nearest point of each of some places, of all points that it was offered.

    Parameters
    ----------
    places : (m, 3) float64 array
        Finite, and small enough to square.
    squared_bound : float
        Squared distance beyond which no point is looked for.

    Attributes
    ----------
    squared : (m,) float64 array
        Squared distance of the nearest point so far, (dx dx + dy dy) + dz dz; the bound where there
        is none.
    rank : (m,) int64 array
        The rank of that point, the smallest of equally near ones; `NO_RANK` where there is none.
    """

    def __init__(
        self, places: NDArray[np.float64], squared_bound: float = np.inf, threads: int = 1
    ) -> None:
        self.places = np.require(places, np.float64, ["C", "W"])
        self.squared = np.full(len(places), squared_bound)
        self.rank = np.full(len(places), NO_RANK, np.int64)
        self._threads = threads

    def offer(
        self,
        points: NDArray[np.float64],
        ranks: NDArray[np.int64],
        slots: NDArray[np.intp] | None = None,
    ) -> None:
        """Let places choose among more points, whose ranks need not differ; all by default."""
        asking = slice(None) if slots is None else slots
        places, squared, rank = self.places[asking], self.squared[asking], self.rank[asking]
        if not len(points) or not len(places):
            return
        tree, find = grown_tree(points, ranks), kernels().find
        over_ranges(
            lambda first, end: find(tree, places, first, end, make_walk(), squared, rank),
            [*range(0, len(places), _PLACES_AT_A_TIME), len(places)],
            self._threads,
        )
        self.squared[asking], self.rank[asking] = squared, rank
