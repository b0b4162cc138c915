"""Algorithm 1 of the paper: from a finished map to the points that do not belong in it."""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dynahull.checking import (
    checked_classes,
    checked_mask,
    checked_observer,
    checked_points,
    checked_poses,
    checked_scans,
    checked_threads,
    valid_points,
)
from dynahull.clustering import Clusters, fit_clusters, sample_rows
from dynahull.density import SMALLEST_CLUSTER, SPREAD_COLUMNS, cluster_densities
from dynahull.evidence.model import Judged, judge_points
from dynahull.evidence.summaries import ScoredPoints
from dynahull.evidence.viewpoints import Viewpoints, count_coordinates
from dynahull.ground.methods import ground_mask, height_above_ground
from dynahull.labels import Label
from dynahull.observer import Observer, SilentObserver
from dynahull.parameters import MethodParameters
from dynahull.protection import protected_points
from dynahull.removal import Removal, removal_percentages, remove_least_dense, remove_likely
from dynahull.result import NO_CLUSTER, CleaningResult, ClusterSummary
from dynahull.strays import Outskirts, is_at_origin, warn_of_strays
from dynahull.warn import (
    density_levels,
    warn_of_clusters,
    warn_of_densities,
    warn_of_ground,
    warn_of_much_removed,
    warn_of_sparse_map,
    wide_neighbourhoods,
)


class SetAside(NamedTuple):
    """What is not scored, and why."""

    ground: NDArray[np.bool_]
    above: NDArray[np.bool_]
    """(N,): disjoint; `above` is higher than `max_height`."""
    height: NDArray[np.float64]
    """(N,): above the local ground, metres; NaN where none is near, or nobody asked."""


class _Given(NamedTuple):
    """A map, what is said of it, and how it is to be cleaned: all of it checked."""

    points: NDArray[np.float64]
    """(N, 3)"""
    classes: NDArray[np.uint8] | None
    left_out: NDArray[np.bool_] | None
    protected: NDArray[np.bool_]
    """(N,): never removed."""
    scans: NDArray[np.int32] | None
    sensor: NDArray[np.float64] | None
    """(S, 3): where it was in each scan."""
    parameters: MethodParameters
    threads: int
    observer: Observer


def clean(
    points: ArrayLike,
    parameters: MethodParameters | Mapping[str, Any] | str | None = None,
    *,
    classification: ArrayLike | None = None,
    left_out: ArrayLike | None = None,
    protected: ArrayLike | None = None,
    scan: ArrayLike | None = None,
    poses: ArrayLike | None = None,
    threads: int = 1,
    observer: Observer | None = None,
    **sections: Any,
) -> CleaningResult:
    """Label every point of a map: static, dynamic, ground and so on.

    Parameters
    ----------
    points : (N, 3) array_like, or a cloud of Open3D, laspy, PyTorch or pandas
        The map, in metres; NaN and infinite coordinates are labelled invalid.
    parameters : MethodParameters, dict or str, optional
        All, or the name of a ready configuration: `"paper"`, `"auto"`, `"indoor"`, `"outdoor"`.
    classification : (N,) array_like of int, optional
        ASPRS classes, for `ground.method: las_class`.
    left_out, protected : (N,) array_like of bool, optional
        Noise, which decides nothing and is labelled unscored; and what is never removed.
    scan : (N,) array_like of int, optional
        The scan in which each point was seen, numbered from 0 in the order of time, some 0.1 s
        apart; -1 where it is not known. Only `removal.decision: auto` looks at it.
    poses : (S, 3), (S, 3, 4) or (S, 4, 4) array_like, optional
        Where the sensor was in each scan, in the map's frame, metres: positions or poses.
    threads : int
        The result does not depend on them.
    observer : Observer, optional
        Told about stages, progress and warnings.
    **sections
        Keys in place of those of `parameters`: `clean(points, neighbours={"k": 50})`.

    Raises
    ------
    InvalidPointsError, InvalidParametersError
        When these are anything else.

    Examples
    --------
    >>> import numpy as np, dynahull
    >>> room = np.random.default_rng(0).normal(size=(2_000, 3))
    >>> result = dynahull.clean(room, ground={"method": "none"})
    >>> cleaned = room[result.kept]
    """
    chosen = MethodParameters.chosen(parameters, sections)
    said = classification, left_out, protected, scan, poses
    return _algorithm_1(_checked(points, *said, chosen, threads, observer))


def _algorithm_1(given: _Given) -> CleaningResult:
    """Clean a map as Algorithm 1 of the paper does."""
    labels = _first_labels(given)
    aside = _set_aside(given, labels == Label.STATIC)
    rows = np.flatnonzero((labels == Label.STATIC) & ~aside.ground & ~aside.above)
    clusters, membership = _clusters(given, rows, labels)
    density, spreads = _densities(given, membership)
    judged = _judged(given, rows, density, spreads, membership, aside)
    percentages = _percentages(given, membership)
    removals = _removals(given, density, judged, membership, percentages)
    cluster = np.full(len(labels), NO_CLUSTER, np.int32)
    return CleaningResult(
        labels=_merged_labels(labels, aside, membership, removals),
        protected=given.protected,
        density=density,
        score=judged.score,
        reason=judged.reason,
        cluster=_scattered(cluster, membership, range(len(membership))),
        clusters=_summaries(given, clusters, membership, percentages, removals),
    )


def _checked(
    points: ArrayLike,
    classification: ArrayLike | None,
    left_out: ArrayLike | None,
    protected: ArrayLike | None,
    scan: ArrayLike | None,
    poses: ArrayLike | None,
    parameters: MethodParameters,
    threads: int,
    observer: Observer | None,
) -> _Given:
    xyz = checked_points(points)
    classes = None if classification is None else checked_classes(classification, len(xyz))
    noise = None if left_out is None else checked_mask(left_out, len(xyz))
    scans = None if scan is None else checked_scans(scan, len(xyz))
    sensor = None if poses is None else checked_poses(poses, scans)
    removal = parameters.removal
    safe = protected_points(xyz, classes, removal.protect_classes, removal.protect)
    if protected is not None:
        safe |= checked_mask(protected, len(xyz), "protected")
    threads = checked_threads(threads)
    observer = SilentObserver() if observer is None else checked_observer(observer)
    return _Given(xyz, classes, noise, safe, scans, sensor, parameters, threads, observer)


def set_ground_aside(
    points: NDArray[np.float64],
    seen: NDArray[np.bool_],
    parameters: MethodParameters,
    classification: NDArray[np.uint8] | None,
    observer: Observer,
    *,
    threads: int = 1,
) -> SetAside:
    """Find the ground, and the points too high above it, among those that are `seen`."""
    observer.stage("ground", len(points))
    ground, above = np.zeros(len(points), np.bool_), np.zeros(len(points), np.bool_)
    height = np.full(len(points), np.nan)
    whole = bool(seen.all())
    chosen = points if whole else points[seen]
    classes = classification if whole or classification is None else classification[seen]
    found = ground_mask(chosen, parameters.ground, classes, threads=threads)
    ground[seen] = found
    if parameters.needs_heights:
        height[seen] = height_above_ground(chosen, found, parameters.ground, threads=threads)
    if parameters.max_height is not None:
        above = seen & ~ground & (height > parameters.max_height)
    observer.advance(len(points))
    return SetAside(ground, above, height)


def _set_aside(given: _Given, seen: NDArray[np.bool_]) -> SetAside:
    points, parameters, observer = given.points, given.parameters, given.observer
    classes, threads = given.classes, given.threads
    aside = set_ground_aside(points, seen, parameters, classes, observer, threads=threads)
    ground, total = int(np.count_nonzero(aside.ground)), int(np.count_nonzero(seen))
    warn_of_ground(ground, total, parameters.ground.method, observer)
    return aside


def _first_labels(given: _Given) -> NDArray[np.uint8]:
    """Label the points that decide nothing, each by its reason; all others are static so far."""
    seen = valid_points(given.points)
    labels = np.where(seen, Label.STATIC, Label.INVALID).astype(np.uint8)
    if given.left_out is not None:
        labels[seen & given.left_out] = Label.UNSCORED
        seen = seen & ~given.left_out
    outskirts = Outskirts(given.parameters.neighbours.k)
    outskirts.add(given.points, chosen=seen)
    strays = outskirts.strays()
    warn_of_strays(strays.heap, len(strays.rows), given.observer)
    if strays.heap:
        labels[seen & is_at_origin(given.points)] = Label.INVALID
    labels[strays.rows] = Label.UNSCORED
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


def _clusters(
    given: _Given, rows: NDArray[np.int64], labels: NDArray[np.uint8]
) -> tuple[Clusters, list[NDArray[np.int64]]]:
    """Return the clusters of some points, and the rows of each, in order."""
    total = int(np.count_nonzero(labels == Label.STATIC))
    points = given.points.take(rows, axis=0)
    clusters = find_clusters(points, rows, total, given.parameters, given.observer)
    nearest = clusters.nearest(points, threads=given.threads)
    order = np.argsort(nearest.astype(np.int16), kind="stable")  # short integers: a radix sort
    ends = np.cumsum(np.bincount(nearest, minlength=len(clusters.centroids)))
    membership = np.split(rows[order], ends[:-1]) if len(ends) else []
    counts = [len(members) for members in membership]
    warn_of_clusters(counts, given.parameters, given.observer)
    return clusters, membership


def _densities(
    given: _Given, membership: Sequence[NDArray[np.int64]]
) -> tuple[NDArray[np.float64], list[NDArray[np.float32]]]:
    """Return the density of each point, and how the neighbourhoods of each cluster are spread."""
    points, parameters, observer = given.points, given.parameters, given.observer
    observer.stage("density", sum(len(members) for members in membership))
    found = [
        cluster_densities(
            points.take(members, axis=0), members, parameters, given.threads, observer
        )
        for members in membership
    ]
    densities, spreads = [density for density, _ in found], [spread for _, spread in found]
    return _scattered(np.full(len(points), np.nan), membership, densities), spreads


def _judged(
    given: _Given,
    rows: NDArray[np.int64],
    density: NDArray[np.float64],
    spreads: Sequence[NDArray[np.float32]],
    membership: Sequence[NDArray[np.int64]],
    aside: SetAside,
) -> Judged:
    """Weigh the evidence for each scored point, if it decides; all others are not judged."""
    points, scans = given.points, given.scans
    judged = Judged.nothing(len(points))
    if not given.parameters.removal.weighs_evidence:
        return judged
    given.observer.stage("evidence", len(rows))
    viewpoints = None
    if given.sensor is not None:
        viewpoints = Viewpoints.of_poses(given.sensor)
    elif scans is not None:
        counts = count_coordinates(points, scans, 0)
        viewpoints = Viewpoints.of_counts(lambda: [counts])
    spread = _scattered(
        np.full((len(points), SPREAD_COLUMNS), np.nan, np.float32), membership, spreads
    )
    scored = ScoredPoints(
        points.take(rows, axis=0),
        density[rows],
        spread[rows],
        aside.height[rows],
        None if scans is None else scans[rows],
    )
    warn_of_sparse_map(wide_neighbourhoods(scored.spread), len(rows), given.observer)
    unscored = aside.ground | aside.above
    their_scans = None if scans is None else scans[unscored]
    k = given.parameters.neighbours.k
    found = judge_points(scored, points[unscored], k, given.threads, their_scans, viewpoints)
    judged.score[rows], judged.reason[rows] = found.score, found.reason
    given.observer.advance(len(rows))
    return judged


def _percentages(given: _Given, membership: Sequence[NDArray[np.int64]]) -> tuple[Fraction, ...]:
    removal, k = given.parameters.removal, given.parameters.neighbours.k
    counts = [len(members) for members in membership]
    return removal_percentages(counts, removal.min_percent, removal.max_percent, k)


def _removals(
    given: _Given,
    density: NDArray[np.float64],
    judged: Judged,
    membership: Sequence[NDArray[np.int64]],
    percentages: Sequence[Fraction],
) -> list[Removal]:
    """Decide what goes of each cluster; what is protected stays."""
    removal = given.parameters.removal
    if removal.weighs_evidence:
        found = [remove_likely(judged.score[members], removal.confidence) for members in membership]
    else:
        warn_of_densities(density_levels(density), given.observer)
        found = [
            remove_least_dense(density[members], members, percentage, removal.threshold)
            for members, percentage in zip(membership, percentages, strict=True)
        ]
    return [
        Removal(each.dynamic & ~given.protected[members], each.threshold)
        for members, each in zip(membership, found, strict=True)
    ]


def _merged_labels(
    labels: NDArray[np.uint8],
    aside: SetAside,
    membership: Sequence[NDArray[np.int64]],
    removals: Sequence[Removal],
) -> NDArray[np.uint8]:
    """Put static, dynamic and set-aside points together again (the last step of Algorithm 1)."""
    labels[aside.ground] = Label.GROUND
    labels[aside.above] = Label.ABOVE
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
    given: _Given,
    clusters: Clusters,
    membership: Sequence[NDArray[np.int64]],
    percentages: Sequence[Fraction],
    removals: Sequence[Removal],
) -> tuple[ClusterSummary, ...]:
    every = zip(clusters.centroids, membership, percentages, removals, strict=True)
    summaries = tuple(
        ClusterSummary(
            index=index,
            centroid=(float(centre[0]), float(centre[1]), float(centre[2])),
            count=len(members),
            percentage=float(percentage),
            threshold=removal.threshold,
            removed=int(np.count_nonzero(removal.dynamic)),
        )
        for index, (centre, members, percentage, removal) in enumerate(every)
    )
    if given.parameters.removal.weighs_evidence:
        warn_of_much_removed(summaries, given.observer)
    return summaries
