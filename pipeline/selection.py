"""The exact threshold of each cluster over all tiles, without gathering all densities in one place.

A positive float64 orders like its bits, so the density of a given rank is found digit by digit:
one histogram of the leading 16 bits of all densities, then one of the next 16 among those that
agree so far, until those left are few enough to be sorted. What is held at a time is one tile, one
histogram a cluster, and those few.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynahull.removal import removable_count, stepped_quartiles, stepped_threshold
from dynahull.rescale import removal_count

_DIGIT = 16
_DIGITS = range(64 - _DIGIT, -1, -_DIGIT)
_VALUES = 1 << _DIGIT

_GATHERED = 2_000_000
"""Keys that agree so far and are few enough to be held, and sorted, all at once."""


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


Tiles = Callable[[], Iterable[ScoredPoints]]
"""Gives the scored points of every tile, one tile after the other, as often as it is called."""


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
    tiles: Tiles,
    counts: Sequence[int],
    percentages: Sequence[Fraction],
    threshold: Literal["rank", "stepped"],
) -> list[Cut]:
    """Find where each cluster is cut, exactly as `dynahull.removal` does on arrays.

    Parameters
    ----------
    tiles : Tiles
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
    finite = np.zeros(len(counts), np.int64)
    for tile in tiles():
        scored = tile.cluster[np.isfinite(tile.density)]
        finite += np.bincount(scored, minlength=len(counts))
    find = _cuts_by_rank if threshold == "rank" else _cuts_by_steps
    return find(tiles, counts, percentages, [int(count) for count in finite])


def _cuts_by_rank(
    tiles: Tiles, counts: Sequence[int], percentages: Sequence[Fraction], finite: Sequence[int]
) -> list[Cut]:
    removed = [
        min(removal_count(percentage, count), removable)
        for percentage, count, removable in zip(percentages, counts, finite, strict=True)
    ]
    ranks = [(cluster, count - 1) for cluster, count in enumerate(removed) if count]
    values, below = _order_statistics(lambda: map(_density_bits, tiles()), ranks)
    limits = {cluster: _as_float(bits) for (cluster, _), bits in zip(ranks, values, strict=True)}
    ties = [(cluster, rank - lower) for (cluster, rank), lower in zip(ranks, below, strict=True)]
    rows, _ = _order_statistics(lambda: (_tied_rows(tile, limits) for tile in tiles()), ties)
    cuts = [Cut(None) for _ in counts]
    for (cluster, _), row in zip(ties, rows, strict=True):
        cuts[cluster] = Cut(limits[cluster], row)
    return cuts


def _cuts_by_steps(
    tiles: Tiles, counts: Sequence[int], percentages: Sequence[Fraction], finite: Sequence[int]
) -> list[Cut]:
    ranks = []
    for cluster, (count, percentage, removable) in enumerate(
        zip(counts, percentages, finite, strict=True)
    ):
        wanted = removable_count(percentage, count, removable)
        if wanted:
            ranks += [(cluster, rank) for rank in (*stepped_quartiles(removable), wanted - 1)]
    values, _ = _order_statistics(lambda: map(_density_bits, tiles()), ranks)
    cuts = [Cut(None) for _ in counts]
    for place in range(0, len(ranks), 5):
        statistics = [_as_float(bits) for bits in values[place : place + 5]]
        cuts[ranks[place][0]] = Cut(stepped_threshold(*statistics))
    return cuts


Keys = tuple[NDArray[np.int32], NDArray[np.uint64]]


def _order_statistics(
    tiles: Callable[[], Iterable[Keys]], ranks: Sequence[tuple[int, int]]
) -> tuple[list[int], list[int]]:
    """Find keys by their rank.

    Parameters
    ----------
    tiles : callable
        Gives, tile by tile, the cluster and the key of points.
    ranks : sequence of (int, int)
        Pairs of a cluster and the rank, from zero, of the key wanted in it.

    Returns
    -------
    keys : list of int
        One for each rank.
    below : list of int
        How many keys of its cluster are smaller.
    """
    prefixes = [0] * len(ranks)
    missing = [rank for _, rank in ranks]
    for shift in _DIGITS if ranks else ():
        # Ranks of one cluster that agree so far share a histogram.
        wanted = {(cluster, prefix) for (cluster, _), prefix in zip(ranks, prefixes, strict=True)}
        histograms = {place: np.zeros(_VALUES, np.int64) for place in wanted}
        for clusters, keys in tiles():
            for place, histogram in histograms.items():
                chosen = _agreeing(clusters, keys, place, shift + _DIGIT)
                digits = (chosen >> np.uint64(shift)) & np.uint64(_VALUES - 1)
                found = np.bincount(digits.astype(np.int64), minlength=_VALUES)
                np.add(histogram, found, out=histogram)
        left: dict[tuple[int, int], int] = {}
        for slot, (cluster, _) in enumerate(ranks):
            histogram = histograms[cluster, prefixes[slot]]
            totals = np.cumsum(histogram)
            digit = int(np.searchsorted(totals, missing[slot], side="right"))
            missing[slot] -= int(totals[digit - 1]) if digit else 0
            prefixes[slot] = prefixes[slot] << _DIGIT | digit
            left[cluster, prefixes[slot]] = int(histogram[digit])
        if shift and sum(left.values()) <= _GATHERED:
            gathered = _gather(tiles, left, shift)
            for slot, (cluster, _) in enumerate(ranks):
                keys = gathered[cluster, prefixes[slot]]
                prefixes[slot] = int(keys[missing[slot]])
                missing[slot] -= int(np.searchsorted(keys, keys[missing[slot]]))
            break
    below = [rank - left for (_, rank), left in zip(ranks, missing, strict=True)]
    return prefixes, below


def _agreeing(
    clusters: NDArray[np.int32], keys: NDArray[np.uint64], place: tuple[int, int], shift: int
) -> NDArray[np.uint64]:
    """Return the keys of a cluster that begin with a prefix, which ends at a bit."""
    cluster, prefix = place
    chosen = keys[clusters == cluster]
    if shift < 64:
        chosen = chosen[chosen >> np.uint64(shift) == np.uint64(prefix)]
    return np.asarray(chosen)


def _gather(
    tiles: Callable[[], Iterable[Keys]], places: Iterable[tuple[int, int]], shift: int
) -> dict[tuple[int, int], NDArray[np.uint64]]:
    """Return, sorted, the keys of each cluster that begin with a prefix: they are few."""
    parts: dict[tuple[int, int], list[NDArray[np.uint64]]] = {place: [] for place in places}
    for clusters, keys in tiles():
        for place, found in parts.items():
            found.append(_agreeing(clusters, keys, place, shift))
    return {place: np.sort(np.concatenate(found)) for place, found in parts.items()}


def _density_bits(tile: ScoredPoints) -> Keys:
    finite = np.isfinite(tile.density)
    return tile.cluster[finite], tile.density[finite].view(np.uint64)


def _tied_rows(tile: ScoredPoints, limits: dict[int, float]) -> Keys:
    limit = np.full(max(limits, default=-1) + 1, np.nan)
    limit[list(limits)] = list(limits.values())
    known = tile.cluster < len(limit)
    tied = np.zeros(len(known), np.bool_)
    tied[known] = tile.density[known] == limit[tile.cluster[known]]
    return tile.cluster[tied], tile.rows[tied].astype(np.uint64)


def _as_float(bits: int) -> float:
    return float(np.array(bits, np.uint64).view(np.float64))
