"""The exact threshold of each cluster over all tiles, without gathering all densities in one place.

The densities of one tile are looked at a time, see `order_statistic`.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dynahull.removal import removable_count, stepped_quartiles, stepped_threshold
from dynahull.rescale import removal_count
from pipeline.tiles.order_statistic import order_statistic

_ROW_BITS = 20
"""Of a row number: that many rows are held at a time when equally dense points are told apart."""


class ScoredTile(Protocol):
    """What is known of the points of a tile that were clustered."""

    def densities(self, cluster: int) -> NDArray[np.float64]:
        """Return the densities of its points in a cluster, in any order."""

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
    densities = _Densities(tiles, cluster)
    removed = min(removal_count(percentage, count), densities.finite())
    if not removed:
        return Cut(None)
    limit = order_statistic(densities, removed - 1)
    below = sum(int(np.count_nonzero(each < limit)) for each in densities)

    def rows() -> Iterator[NDArray[np.int64]]:
        return (tile.rows_at(cluster, limit) for tile in tiles)

    return Cut(limit, _row_of_rank(rows, removed - 1 - below))


def _cut_by_steps(
    tiles: Sequence[ScoredTile], cluster: int, count: int, percentage: Fraction
) -> Cut:
    densities = _Densities(tiles, cluster)
    finite = densities.finite()
    wanted = removable_count(percentage, count, finite)
    if not wanted:
        return Cut(None)
    ranks = (*stepped_quartiles(finite), wanted - 1)
    return Cut(stepped_threshold(*(order_statistic(densities, rank) for rank in ranks)))


class _Densities:
    """The densities of a cluster, one tile after the other, as often as they are asked for."""

    def __init__(self, tiles: Sequence[ScoredTile], cluster: int) -> None:
        self._tiles, self._cluster = tiles, cluster

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        return (tile.densities(self._cluster) for tile in self._tiles)

    def finite(self) -> int:
        return sum(int(np.count_nonzero(np.isfinite(each))) for each in self)


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
