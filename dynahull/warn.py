"""What a user should know of a map before trusting what was removed, in one line each.

In memory and over tiles the same numbers come to the same words.
"""

from collections.abc import Sequence
from statistics import median

import numpy as np
from numpy.typing import NDArray

from dynahull.density import SMALLEST_CLUSTER
from dynahull.evidence.summaries import logarithms
from dynahull.observer import Observer
from dynahull.parameters import MethodParameters, RemovalParameters
from dynahull.removal import removal_percentages, smallest_counted
from dynahull.result import ClusterSummary

LITTLE_GROUND = 0.02
"""Share of the points; where people and robots move, a floor is more than that."""

TINY = 20
"""A cluster is tiny with fewer points than one in so many of the median cluster's."""

WIDE = 0.25
"""Metres: a neighbourhood whose longest deviation is more is as wide as a person."""

_LOWEST, _HIGHEST, _BINS_EACH = -40, 60, 8
"""Logarithms to base 2 of densities that are told apart, and bins to an octave."""

_PEAK, _POPULATION = 1.2, 0.005
"""A second population has a peak so much above the valley, and such a share of the points."""

MUCH = 1 / 3
"""Of the scored points; people and vehicles hardly ever leave so much in a map."""

_FEWEST_SCORED = 10_000
"""Points; the densities of fewer are too ragged to show populations."""

_FEWEST_COMPARED = 3
"""Clusters; of fewer, the median says nothing."""

_OTHER_GROUND = {"slope": "csf", "csf": "slope", "las_class": "slope"}


def warn_of_ground(ground: int, total: int, method: str, observer: Observer) -> None:
    """Say that hardly any ground was found among the points that take part, if so."""
    if method == "none" or ground >= LITTLE_GROUND * total:
        return
    observer.warn(
        f"hardly any ground was found ({ground:,} of {total:,} points, ground.method {method}): "
        "the floor and the feet of walls are scored like all else, and heights above the floor "
        "are not known; see that z is up and lengths are metres, then try ground.method="
        f"{_OTHER_GROUND[method]}, or none if the map has no floor"
    )


def warn_of_clusters(
    counts: Sequence[int], parameters: MethodParameters, observer: Observer
) -> None:
    """Say what is unusual about the clusters of a map, by the points of each."""
    wanted = parameters.clustering.count
    if not sum(counts):
        observer.warn("no point is left after the ground: nothing was scored")
    elif len(counts) < wanted:
        observer.warn(
            f"{wanted} clusters asked for, {len(counts)} made: there are no more distinct points"
        )
    for index, count in enumerate(counts):
        if count == 0:
            observer.warn(f"cluster {index} is empty: nothing to score in it")
        elif count < SMALLEST_CLUSTER:
            points = "1 point" if count == 1 else f"{count} points"
            observer.warn(f"cluster {index} has {points}: too few for a hull, kept")
    if not parameters.removal.weighs_evidence:
        _warn_of_tiny_cluster(counts, parameters.removal, parameters.neighbours.k, observer)


def _warn_of_tiny_cluster(
    counts: Sequence[int], removal: RemovalParameters, k: int, observer: Observer
) -> None:
    """Say that one tiny cluster decides what all others lose by Eq. 1, if so."""
    counted = [count for count in counts if count >= k]
    if len(counted) < _FEWEST_COMPARED or removal.min_percent == removal.max_percent:
        return
    smallest = smallest_counted(counted, k)
    if TINY * smallest >= median(counted):
        return
    percentages = removal_percentages(counts, removal.min_percent, removal.max_percent, k)
    shares = [
        float(share)
        for count, share in zip(counts, percentages, strict=True)
        if TINY * count >= median(counted)
    ]
    observer.warn(
        f"cluster {counts.index(smallest)} has {smallest:,} points, and half of all clusters "
        f"{int(median(counted)):,} or more: Eq. 1 measures the others by it, and takes "
        f"{min(shares):.1f} to {max(shares):.1f} % of them; another clustering.seed or "
        "clustering.count may divide the map more evenly"
    )


def density_levels(density: NDArray[np.float64]) -> NDArray[np.int64]:
    """Count finite densities by their logarithm, so that the counts of tiles add up, (800,)."""
    known = density[np.isfinite(density) & (density > 0)]
    level = np.floor((logarithms(known) - _LOWEST) * _BINS_EACH)
    bins = (_HIGHEST - _LOWEST) * _BINS_EACH
    return np.bincount(np.clip(level, 0, bins - 1).astype(np.int64), minlength=bins)


def has_sparse_population(levels: NDArray[np.int64]) -> bool:
    """Tell whether there is a second, sparser population below the mode of `density_levels`."""
    smooth = np.convolve(levels, np.ones(5), mode="same")  # over half an octave
    below = smooth[: int(smooth.argmax()) + 1]
    # Of each bin as the valley: the peak before it, and the points up to it.
    peak = np.maximum.accumulate(below)
    rest = np.minimum.accumulate(below[::-1])[::-1]
    enough = np.cumsum(levels)[: len(below)] >= _POPULATION * levels.sum()
    return bool(((peak >= _PEAK * below) & (below == rest) & enough & (below < peak)).any())


def warn_of_densities(levels: NDArray[np.int64], observer: Observer) -> None:
    """Say that densities show no second population, if so: Eq. 1 takes its share all the same."""
    if levels.sum() >= _FEWEST_SCORED and not has_sparse_population(levels):
        observer.warn(
            "the densities show no second, sparser population: Eq. 1 takes its share of each "
            "cluster, whether or not anything moved; -c auto takes what the evidence says"
        )


def wide_neighbourhoods(spread: NDArray[np.float32]) -> int:
    """Count the points whose neighbours reach as wide as a person; see `reference_spreads`."""
    return int(np.count_nonzero(spread[:, 2] > np.float32(WIDE)))


def warn_of_sparse_map(wide: int, scored: int, observer: Observer) -> None:
    """Say that a map is too sparse for a sure decision, if many scored neighbourhoods are wide."""
    if 2 * wide > scored:
        observer.warn(
            "the map is sparse, or was downsampled: the neighbours of most points reach as wide "
            "as a person, and what moved is hard to tell; decide on the map as it was recorded, "
            "before voxel filters, or ask for a higher removal.confidence"
        )


def warn_of_much_removed(clusters: Sequence[ClusterSummary], observer: Observer) -> None:
    """Say that the evidence takes more of a map than is likely to have moved, if so."""
    removed = sum(cluster.removed for cluster in clusters)
    scored = sum(cluster.count for cluster in clusters)
    if removed > MUCH * scored:
        observer.warn(
            f"{removed:,} of {scored:,} scored points go, more than moving things are likely to "
            "leave: furniture may be among them; look at what was removed, and ask for a higher "
            "removal.confidence if so"
        )
