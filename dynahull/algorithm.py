"""Algorithm 1 of the paper: from a finished map to the points that do not belong in it."""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynahull.clustering import Clusters, fit_clusters, sample_rows
from dynahull.density import SMALLEST_CLUSTER, cluster_densities
from dynahull.errors import InvalidPointsError
from dynahull.ground.methods import ground_mask, height_above_ground
from dynahull.labels import Label
from dynahull.parameters import MethodParameters
from dynahull.progress import Observer, SilentObserver
from dynahull.removal import Removal, remove_least_dense
from dynahull.rescale import removal_percentages
from dynahull.result import NO_CLUSTER, CleaningResult, ClusterSummary

LARGEST_COORDINATE = 1e150
"""Metres from the origin; see `valid_points`."""


def clean(
    points: ArrayLike,
    parameters: MethodParameters | dict[str, Any] | None = None,
    *,
    classification: ArrayLike | None = None,
    threads: int = 1,
    observer: Observer | None = None,
    **sections: Any,
) -> CleaningResult:
    """Label every point of a map: static, dynamic, ground and so on.

    The body is Algorithm 1 of the paper.

    Parameters
    ----------
    points : (N, 3) array_like
        The map, in metres; NaN and infinite coordinates are allowed and labelled invalid.
    parameters : MethodParameters or dict, optional
        All parameters; those of the paper by default.
    classification : (N,) array_like of int, optional
        ASPRS classes, for `ground.method: las_class`.
    threads : int
        Threads of ground, clustering and density. The result does not depend on it.
    observer : Observer, optional
        Told about stages, progress and warnings.
    **sections
        Single sections in place of `parameters`, as models or dictionaries:
        `clean(points, neighbours={"k": 50})`.

    Returns
    -------
    CleaningResult

    Raises
    ------
    InvalidPointsError
        When `points` is not an (N, 3) array of real numbers.
    InvalidParametersError
        When a section or a key is unknown, or a value not allowed.

    Examples
    --------
    >>> import numpy as np, dynahull
    >>> room = np.random.default_rng(0).normal(size=(2_000, 3))
    >>> result = dynahull.clean(room, ground={"method": "none"})
    >>> cleaned = room[result.kept]
    """
    coordinates = checked_points(points)
    classes = None if classification is None else checked_classes(classification, len(coordinates))
    parameters = _chosen_parameters(parameters, sections)
    observer = observer or SilentObserver()

    valid = valid_points(coordinates)
    ground, above = set_ground_aside(
        coordinates, valid, parameters, classes, observer, threads=threads
    )
    rows = np.flatnonzero(valid & ~ground & ~above)
    clusters = find_clusters(
        coordinates.take(rows, axis=0),
        rows,
        _finite_count(coordinates, valid),
        parameters,
        observer,
    )
    membership = _membership(clusters, coordinates, rows, threads)
    warn_of_clusters(
        [len(members) for members in membership], parameters.clustering.count, observer
    )
    densities = _densities(coordinates, membership, parameters, threads, observer)
    percentages = removal_percentages(
        [len(members) for members in membership],
        parameters.removal.min_percent,
        parameters.removal.max_percent,
    )
    removals = [
        remove_least_dense(density, members, percentage, parameters.removal.threshold)
        for density, members, percentage in zip(densities, membership, percentages, strict=True)
    ]
    return CleaningResult(
        labels=_merged_labels(valid, ground, above, membership, removals),
        density=_scattered(np.full(len(coordinates), np.nan), membership, densities),
        cluster=_scattered(
            np.full(len(coordinates), NO_CLUSTER, np.int32), membership, range(len(membership))
        ),
        clusters=_summaries(clusters, membership, percentages, removals),
    )


def checked_points(points: ArrayLike) -> NDArray[np.float64]:
    """Return points as a C-ordered (N, 3) float64 array.

    Raises
    ------
    InvalidPointsError
        When they are anything else.
    """
    try:
        array = np.asarray(points)
    except ValueError as error:
        raise InvalidPointsError(f"points: expected an (N, 3) array, found {error}") from error
    if array.ndim != 2 or array.shape[1] != 3:
        raise InvalidPointsError(f"points: expected an (N, 3) array, found shape {array.shape}")
    if array.dtype.kind not in "fiu":
        raise InvalidPointsError(f"points: expected real numbers, found dtype {array.dtype}")
    return np.ascontiguousarray(array, np.float64)


def checked_classes(classification: ArrayLike, count: int) -> NDArray[np.uint8]:
    """Return ASPRS classes as an (N,) uint8 array.

    Raises
    ------
    InvalidPointsError
        When they are anything else.
    """
    classes = np.asarray(classification)
    if classes.shape != (count,):
        raise InvalidPointsError(
            f"classification: expected one class for each of {count} points, "
            f"found shape {classes.shape}"
        )
    if count and (classes.dtype.kind not in "iu" or classes.min() < 0 or classes.max() > 255):
        raise InvalidPointsError(
            f"classification: expected whole numbers from 0 to 255, found dtype {classes.dtype}"
        )
    return classes.astype(np.uint8)


def valid_points(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which points have coordinates that can be measured: not NaN, not infinite, not absurd.

    Parameters
    ----------
    points : (N, 3) float64 array

    Returns
    -------
    (N,) bool array
        False also where a coordinate is beyond `LARGEST_COORDINATE`: squared distances to such a
        point overflow.
    """
    if len(points) and -LARGEST_COORDINATE <= points.min() <= points.max() <= LARGEST_COORDINATE:
        return np.ones(len(points), np.bool_)
    x, y, z = (np.abs(points[:, axis]) <= LARGEST_COORDINATE for axis in range(3))
    return np.asarray(x & y & z)


def _finite_count(points: NDArray[np.float64], valid: NDArray[np.bool_]) -> int:
    """Count the points of finite coordinates, absurd ones among them."""
    finite = 0 if valid.all() else int(np.isfinite(points[~valid]).all(axis=1).sum())
    return finite + int(np.count_nonzero(valid))


def set_ground_aside(
    points: NDArray[np.float64],
    valid: NDArray[np.bool_],
    parameters: MethodParameters,
    classification: NDArray[np.uint8] | None,
    observer: Observer,
    *,
    threads: int = 1,
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Find the ground, and the points too high above it.

    Returns
    -------
    ground, above : (N,) bool arrays
        Disjoint, and false for invalid points.
    """
    observer.stage("ground", len(points))
    ground, above = np.zeros(len(points), np.bool_), np.zeros(len(points), np.bool_)
    whole = bool(valid.all())
    finite = points if whole else points[valid]
    classes = classification if whole or classification is None else classification[valid]
    found = ground_mask(finite, parameters.ground, classes, threads=threads)
    ground[valid] = found
    if parameters.max_height is not None:
        height = height_above_ground(finite, found, parameters.ground, threads=threads)
        above[valid] = ~found & (height > parameters.max_height)
    observer.advance(len(points))
    return ground, above


def set_aside_labels(
    valid: NDArray[np.bool_], ground: NDArray[np.bool_], above: NDArray[np.bool_]
) -> NDArray[np.uint8]:
    """Label the points that are not scored, each by its reason; all others are static so far.

    Parameters
    ----------
    valid, ground, above : (N,) bool arrays
        See `valid_points` and `set_ground_aside`.

    Returns
    -------
    (N,) uint8 array
    """
    labels = np.full(len(valid), Label.STATIC, np.uint8)
    labels[~valid] = Label.INVALID
    labels[ground] = Label.GROUND
    labels[above] = Label.ABOVE
    return labels


def find_clusters(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    total: int,
    parameters: MethodParameters,
    observer: Observer,
) -> Clusters:
    """Fit the clusters of the ground-free points on a sample of them."""
    observer.stage("clustering", len(points))
    sample = sample_rows(rows, total, parameters.clustering)
    clusters = fit_clusters(points[sample], parameters.clustering)
    observer.advance(len(points))
    return clusters


def warn_of_clusters(counts: Sequence[int], wanted: int, observer: Observer) -> None:
    """Say what is unusual about the clusters of a map.

    Parameters
    ----------
    counts : sequence of int
        N_i, points of each cluster.
    wanted : int
        Clusters asked for.
    observer : Observer
    """
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


def _chosen_parameters(
    parameters: MethodParameters | dict[str, Any] | None, sections: dict[str, Any]
) -> MethodParameters:
    if parameters is None or isinstance(parameters, dict):
        return MethodParameters.of((parameters or {}) | sections)
    return MethodParameters.of(dict(parameters) | sections) if sections else parameters


def _membership(
    clusters: Clusters, points: NDArray[np.float64], rows: NDArray[np.int64], threads: int
) -> list[NDArray[np.int64]]:
    """Return the rows of each cluster, in order."""
    nearest = clusters.nearest(points.take(rows, axis=0), threads=threads)
    order = np.argsort(nearest.astype(np.int16), kind="stable")  # short integers: a radix sort
    ends = np.cumsum(np.bincount(nearest, minlength=len(clusters.centroids)))
    return np.split(rows[order], ends[:-1]) if len(ends) else []


def _densities(
    points: NDArray[np.float64],
    membership: Sequence[NDArray[np.int64]],
    parameters: MethodParameters,
    threads: int,
    observer: Observer,
) -> list[NDArray[np.float64]]:
    observer.stage("density", sum(len(members) for members in membership))
    return [
        cluster_densities(points.take(members, axis=0), members, parameters, threads, observer)
        for members in membership
    ]


def _merged_labels(
    valid: NDArray[np.bool_],
    ground: NDArray[np.bool_],
    above: NDArray[np.bool_],
    membership: Sequence[NDArray[np.int64]],
    removals: Sequence[Removal],
) -> NDArray[np.uint8]:
    """Put static, dynamic and set-aside points together again (the last step of Algorithm 1)."""
    labels = set_aside_labels(valid, ground, above)
    for members, removal in zip(membership, removals, strict=True):
        if len(members) < SMALLEST_CLUSTER:
            labels[members] = Label.UNSCORED
        labels[members[removal.dynamic]] = Label.DYNAMIC
    return labels


def _scattered(
    array: NDArray[Any], membership: Sequence[NDArray[np.int64]], values: Sequence[Any]
) -> NDArray[Any]:
    for members, value in zip(membership, values, strict=True):
        array[members] = value
    return array


def _summaries(
    clusters: Clusters,
    membership: Sequence[NDArray[np.int64]],
    percentages: Sequence[Fraction],
    removals: Sequence[Removal],
) -> tuple[ClusterSummary, ...]:
    return tuple(
        ClusterSummary(
            index=index,
            centroid=(float(centre[0]), float(centre[1]), float(centre[2])),
            count=len(members),
            percentage=float(percentage),
            threshold=removal.threshold,
            removed=int(np.count_nonzero(removal.dynamic)),
        )
        for index, (centre, members, percentage, removal) in enumerate(
            zip(clusters.centroids, membership, percentages, removals, strict=True)
        )
    )
