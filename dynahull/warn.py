"""What a user should know of a map before trusting what was removed, in one line each.

In memory and over tiles the same numbers come to the same words.
"""

from collections.abc import Sequence
from statistics import median

from dynahull.density import SMALLEST_CLUSTER
from dynahull.parameters import MethodParameters, RemovalParameters
from dynahull.progress import Observer
from dynahull.rescale import removal_percentages, smallest_counted

LITTLE_GROUND = 0.02
"""Share of the points; where people and robots move, a floor is more than that."""

TINY = 20
"""A cluster is tiny with fewer points than one in so many of the median cluster's."""

_FEWEST_COMPARED = 3
"""Clusters; of fewer, the median says nothing."""

_OTHER_GROUND = {"slope": "csf", "csf": "slope", "las_class": "slope"}


def warn_of_ground(ground: int, total: int, method: str, observer: Observer) -> None:
    """Say that hardly any ground was found, if so.

    Parameters
    ----------
    ground, total : int
        Points of the ground, and all that take part.
    method : str
        `ground.method`.
    observer : Observer
    """
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
    """Say what is unusual about the clusters of a map.

    Parameters
    ----------
    counts : sequence of int
        N_i, points of each cluster.
    parameters : MethodParameters
    observer : Observer
    """
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
            observer.warn(f"cluster {index} has {count} points: too few for a hull, kept")
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
