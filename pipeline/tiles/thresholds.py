"""The exact threshold of each cluster over all tiles, without gathering all densities in one place.

Each tile keeps the densities of each cluster in their order. A positive float64 orders like its
bits, so the density of a given rank is found by halving the range of its bits: how many densities
of a tile are no larger is a binary search, which looks at a few pages of a file. What is held at a
time is two places a tile.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dynahull.removal import removable_count, stepped_quartiles, stepped_threshold
from dynahull.rescale import removal_count

_INFINITE = int(np.array(np.inf).view(np.uint64))
"""The bits of infinity; of what is not a number they are more."""

_ROW_BITS = 20
"""Of a row number: that many rows are held at a time when equally dense points are told apart."""


@dataclass(frozen=True, slots=True)
class ScoredPoints:
    """Points of one tile that were clustered.

    Attributes
    ----------
    cluster : (n,) int32 array
    density : (n,) float64 array
        Positive; infinite where the hull has no volume, NaN where not scored.
    rows : (n,) int64 array
    """

    cluster: NDArray[np.int32]
    density: NDArray[np.float64]
    rows: NDArray[np.int64]


class ScoredTile(Protocol):
    """What is known of the points of a tile that were clustered."""

    def ordered(self, cluster: int) -> NDArray[np.float64]:
        """Return the densities of its points in a cluster, ascending: infinite and NaN last."""

    def rows_at(self, cluster: int, density: float) -> NDArray[np.int64]:
        """Return the row numbers of its points in a cluster that have just this density."""


@dataclass(frozen=True, slots=True)
class Cut:
    """Where a cluster is cut: below it all points are dynamic.

    Attributes
    ----------
    density : float or None
        Points of a lower density go; None: no point goes.
    last_row : int
        Of the points of just this density those go whose row number is not above this; -1: none.
    """

    density: float | None
    last_row: int = -1

    def dynamic(self, density: NDArray[np.float64], rows: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Tell which points of the cluster are dynamic."""
        if self.density is None:
            return np.zeros(len(density), np.bool_)
        tied = (density == self.density) & (rows <= self.last_row)
        return np.asarray((density < self.density) | tied)


def find_cuts(
    tiles: Sequence[ScoredTile],
    counts: Sequence[int],
    percentages: Sequence[Fraction],
    threshold: Literal["rank", "stepped"],
) -> list[Cut]:
    """Find where each cluster is cut, exactly as `dynahull.removal` does on arrays.

    Parameters
    ----------
    tiles : sequence of ScoredTile
    counts : sequence of int
        N_i of every cluster of the whole map.
    percentages : sequence of Fraction
        R_i of Eq. 1.
    threshold : {"rank", "stepped"}

    Returns
    -------
    list of Cut
        One for each cluster.
    """
    find = _cut_by_rank if threshold == "rank" else _cut_by_steps
    return [
        find(tiles, cluster, count, percentage)
        for cluster, (count, percentage) in enumerate(zip(counts, percentages, strict=True))
    ]


def _cut_by_rank(
    tiles: Sequence[ScoredTile], cluster: int, count: int, percentage: Fraction
) -> Cut:
    removed = min(removal_count(percentage, count), _finite(tiles, cluster))
    if not removed:
        return Cut(None)
    limit, below = _order_statistic(tiles, cluster, removed - 1)
    tied = [
        tile
        for tile, place in zip(tiles, below, strict=True)
        if (tile.ordered(cluster)[place : place + 1] == limit).any()
    ]

    def rows() -> Iterator[NDArray[np.int64]]:
        return (tile.rows_at(cluster, limit) for tile in tied)

    return Cut(limit, _row_of_rank(rows, removed - 1 - sum(below)))


def _cut_by_steps(
    tiles: Sequence[ScoredTile], cluster: int, count: int, percentage: Fraction
) -> Cut:
    finite = _finite(tiles, cluster)
    wanted = removable_count(percentage, count, finite)
    if not wanted:
        return Cut(None)
    ranks = (*stepped_quartiles(finite), wanted - 1)
    statistics = [_order_statistic(tiles, cluster, rank)[0] for rank in ranks]
    return Cut(stepped_threshold(*statistics))


def _finite(tiles: Sequence[ScoredTile], cluster: int) -> int:
    """Count the points of a cluster whose density is finite."""
    return sum(_no_larger(tile.ordered(cluster), _INFINITE - 1) for tile in tiles)


def _order_statistic(
    tiles: Sequence[ScoredTile], cluster: int, rank: int
) -> tuple[float, list[int]]:
    """Find the density of a rank, from zero, in a cluster, and how many each tile has below it."""
    low, high = 0, _INFINITE
    begins = [0] * len(tiles)
    ends = [len(tile.ordered(cluster)) for tile in tiles]
    while low < high:
        middle = (low + high) // 2
        places = [
            begin + (_no_larger(tile.ordered(cluster)[begin:end], middle) if begin < end else 0)
            for tile, begin, end in zip(tiles, begins, ends, strict=True)
        ]
        if sum(places) > rank:
            high, ends = middle, places
        else:
            low, begins = middle + 1, places
    return float(np.array(low, np.uint64).view(np.float64)), begins


def _no_larger(ordered: NDArray[np.float64], bits: int) -> int:
    """Count the densities, in their order, whose bits are no larger than these."""
    # A Python integer would be compared as float64, of which many bits look the same.
    return int(np.searchsorted(ordered.view(np.uint64), np.uint64(bits), side="right"))


def _row_of_rank(rows: Callable[[], Iterator[NDArray[np.int64]]], rank: int) -> int:
    """Return the row number of a rank, from zero, of those that tiles give, in any order."""
    counts = np.zeros(0, np.int64)
    for of_tile in rows():
        found = np.bincount(of_tile >> _ROW_BITS, minlength=len(counts))
        found[: len(counts)] += counts
        counts = found
    totals = np.cumsum(counts)
    leading = int(np.searchsorted(totals, rank, side="right"))
    left = rank - int(totals[leading] - counts[leading])
    agreeing = np.concatenate([found[found >> _ROW_BITS == leading] for found in rows()])
    return int(np.partition(agreeing, left)[left])
