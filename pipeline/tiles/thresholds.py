"""The exact threshold of each cluster over all tiles, without gathering all densities in one place.

The densities of one tile are looked at a time.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from dynahull.removal import removable_count, removal_count, stepped_quartiles, stepped_threshold

_STEP = 16

_FEW = 1 << 20
"""Numbers that are looked at together: 8 MiB."""


def order_statistic(batches: Iterable[NDArray[np.float64]], rank: int) -> float:
    """Return the number of a rank, from zero, of more numbers than memory holds.

    A float64 that is not negative orders like its bits, so each pass finds sixteen more bits of the
    number: it counts the next sixteen of those that begin with the bits known so far. The last pass
    is the one that finds few of them.
    """
    prefix, below = 0, 0
    for shift in range(64 - _STEP, -1, -_STEP):
        counts, found = np.zeros(1 << _STEP, np.int64), 0
        few: list[NDArray[np.uint64]] = []
        for batch in batches:
            bits = _bits(batch)
            if shift + _STEP < 64:
                bits = bits[bits >> np.uint64(shift + _STEP) == np.uint64(prefix)]
            digits = (bits >> np.uint64(shift)) & np.uint64((1 << _STEP) - 1)
            counts += np.bincount(digits.astype(np.intp), minlength=len(counts))
            found += len(bits)
            few = [*few, bits] if found <= _FEW else []
        if found <= _FEW:
            return float(np.sort(np.concatenate(few))[rank - below].view(np.float64))
        totals = below + np.cumsum(counts)
        digit = int(np.searchsorted(totals, rank, side="right"))
        below = int(totals[digit] - counts[digit])
        prefix = prefix << _STEP | digit
    return float(np.array(prefix, np.uint64).view(np.float64))


def _bits(numbers: NDArray[np.float64]) -> NDArray[np.uint64]:
    # Of the two zeros, the negative one has the largest bits.
    return (numbers + 0.0).view(np.uint64)


class ScoredTile(Protocol):
    """What is known of the points of a tile that were clustered."""

    def densities(self, cluster: int) -> NDArray[np.float64]:
        """Return the densities of its points in a cluster, in any order."""

    def rows_at(self, cluster: int, density: float) -> NDArray[np.int64]:
        """Return the row numbers of its points in a cluster that have just this density."""


@dataclass(frozen=True, slots=True)
class Cut:
    """Where a cluster is cut: below it all points are dynamic."""

    density: float | None
    """Points of a lower density go; None: no point goes."""
    last_row: int = -1
    """Of the points of just this density those go whose row number is not above this; -1: none."""

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
    """Find where each cluster is cut, as `dynahull.removal` does on arrays, by N_i and R_i."""
    find = _cut_by_rank if threshold == "rank" else _cut_by_steps
    return [
        find(tiles, cluster, count, percentage)
        for cluster, (count, percentage) in enumerate(zip(counts, percentages, strict=True))
    ]


def _cut_by_rank(
    tiles: Sequence[ScoredTile], cluster: int, count: int, percentage: Fraction
) -> Cut:
    densities = _Passes(tiles, lambda tile: tile.densities(cluster))
    removed = min(removal_count(percentage, count), _finite(densities))
    if not removed:
        return Cut(None)
    limit = order_statistic(densities, removed - 1)
    below = sum(int(np.count_nonzero(each < limit)) for each in densities)
    # Row numbers are exact as floating point numbers, too.
    tied = _Passes(tiles, lambda tile: tile.rows_at(cluster, limit).astype(np.float64))
    return Cut(limit, int(order_statistic(tied, removed - 1 - below)))


def _cut_by_steps(
    tiles: Sequence[ScoredTile], cluster: int, count: int, percentage: Fraction
) -> Cut:
    densities = _Passes(tiles, lambda tile: tile.densities(cluster))
    finite = _finite(densities)
    wanted = removable_count(percentage, count, finite)
    if not wanted:
        return Cut(None)
    ranks = (*stepped_quartiles(finite), wanted - 1)
    return Cut(stepped_threshold(*(order_statistic(densities, rank) for rank in ranks)))


@dataclass(frozen=True, slots=True)
class _Passes:
    """What is looked at of each tile, one after the other, as often as it is asked for."""

    tiles: Sequence[ScoredTile]
    look: Callable[[ScoredTile], NDArray[np.float64]]

    def __iter__(self) -> Iterator[NDArray[np.float64]]:
        return map(self.look, self.tiles)


def _finite(densities: _Passes) -> int:
    return sum(int(np.count_nonzero(np.isfinite(each))) for each in densities)
