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
from dynahull.parameters import MethodParameters
from dynahull.progress import Observer, SilentObserver
from dynahull.protection import protected_points
from dynahull.removal import Removal, remove_least_dense, remove_likely
from dynahull.rescale import removal_percentages
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

    The body is Algorithm 1 of the paper.

    Parameters
    ----------
    points : (N, 3) array_like, or a cloud of Open3D, laspy, PyTorch or pandas
        The map, in metres; NaN and infinite coordinates are allowed and labelled invalid.
    parameters : MethodParameters, dict or str, optional
        All parameters, or the name of a ready configuration (`"paper"`, `"auto"`, `"indoor"`,
        `"outdoor"`); those of the paper by default.
    classification : (N,) array_like of int, optional
        ASPRS classes, for `ground.method: las_class`.
    left_out : (N,) array_like of bool, optional
        Points that are known to be noise: they decide nothing, and are labelled unscored.
    protected : (N,) array_like of bool, optional
        Points that are never removed, beside those of `removal.protect`.
    scan : (N,) array_like of int, optional
        The scan in which each point was seen, numbered from 0 in the order of time, some 0.1 s
        apart; -1 where it is not known. Only `removal.decision: auto` looks at it.
    poses : (S, 3), (S, 3, 4) or (S, 4, 4) array_like, optional
        Where the sensor was in each scan, in the map's frame, metres: positions, or poses from the
        sensor's frame. `scan` numbers its rows. Places that scans saw through are told by it.
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
        When `points` is not an (N, 3) array of real numbers, or what is said of them does not fit.
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
    noise = None if left_out is None else checked_mask(left_out, len(coordinates))
    scans = None if scan is None else checked_scans(scan, len(coordinates))
    sensor = None if poses is None else checked_poses(poses, scans)
    parameters = MethodParameters.chosen(parameters, sections)
    chosen = parameters.removal
    safe = protected_points(coordinates, classes, chosen.protect_classes, chosen.protect)
    if protected is not None:
        safe |= checked_mask(protected, len(coordinates), "protected")
    threads = checked_threads(threads)
    observer = SilentObserver() if observer is None else checked_observer(observer)

    labels = _first_labels(coordinates, noise, parameters.neighbours.k, observer)
    seen = labels == Label.STATIC
    aside = set_ground_aside(coordinates, seen, parameters, classes, observer, threads=threads)
    total = int(np.count_nonzero(seen))
    warn_of_ground(int(np.count_nonzero(aside.ground)), total, parameters.ground.method, observer)
    rows = np.flatnonzero(seen & ~aside.ground & ~aside.above)
    clusters = find_clusters(coordinates.take(rows, axis=0), rows, total, parameters, observer)
    membership = _membership(clusters, coordinates, rows, threads)
    warn_of_clusters([len(members) for members in membership], parameters, observer)
    densities, spreads = _densities(coordinates, membership, parameters, threads, observer)
    percentages = removal_percentages(
        [len(members) for members in membership],
        parameters.removal.min_percent,
        parameters.removal.max_percent,
        parameters.neighbours.k,
    )
    density = _scattered(np.full(len(coordinates), np.nan), membership, densities)
    judged = Judged.nothing(len(coordinates))
    if parameters.removal.weighs_evidence:
        judged = _weighed(coordinates, rows, density, membership, spreads, aside, scans, sensor,
                          parameters, threads, observer)  # fmt: skip
    removals = _removals(density, judged, membership, percentages, parameters, safe, observer)
    summaries = _summaries(clusters, membership, percentages, removals)
    if parameters.removal.weighs_evidence:
        warn_of_much_removed(summaries, observer)
    return CleaningResult(
        labels=_merged_labels(labels, aside, membership, removals),
        protected=safe,
        density=density,
        score=judged.score,
        reason=judged.reason,
        cluster=_scattered(
            np.full(len(coordinates), NO_CLUSTER, np.int32), membership, range(len(membership))
        ),
        clusters=summaries,
    )


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


def _first_labels(
    points: NDArray[np.float64], left_out: NDArray[np.bool_] | None, k: int, observer: Observer
) -> NDArray[np.uint8]:
    """Label the points that decide nothing, each by its reason; all others are static so far."""
    seen = valid_points(points)
    labels = np.where(seen, Label.STATIC, Label.INVALID).astype(np.uint8)
    if left_out is not None:
        labels[seen & left_out] = Label.UNSCORED
        seen = seen & ~left_out
    outskirts = Outskirts(k)
    outskirts.add(points, chosen=seen)
    strays = outskirts.strays()
    warn_of_strays(strays.heap, len(strays.rows), observer)
    if strays.heap:
        labels[seen & is_at_origin(points)] = Label.INVALID
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
) -> tuple[list[NDArray[np.float64]], list[NDArray[np.float32]]]:
    """Return the densities of each cluster, and how its neighbourhoods are spread."""
    observer.stage("density", sum(len(members) for members in membership))
    found = [
        cluster_densities(points.take(members, axis=0), members, parameters, threads, observer)
        for members in membership
    ]
    return [density for density, _ in found], [spread for _, spread in found]


def _weighed(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    density: NDArray[np.float64],
    membership: Sequence[NDArray[np.int64]],
    spreads: Sequence[NDArray[np.float32]],
    aside: SetAside,
    scans: NDArray[np.int32] | None,
    sensor: NDArray[np.float64] | None,
    parameters: MethodParameters,
    threads: int,
    observer: Observer,
) -> Judged:
    """Weigh the evidence for each scored point, in rows; all others are not judged."""
    observer.stage("evidence", len(rows))
    viewpoints = None
    if scans is not None:
        viewpoints = (
            Viewpoints.of_counts([count_coordinates(points, scans, 0)])
            if sensor is None
            else Viewpoints.of_poses(sensor)
        )
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
    warn_of_sparse_map(wide_neighbourhoods(scored.spread), len(rows), observer)
    unscored = aside.ground | aside.above
    their_scans = None if scans is None else scans[unscored]
    k = parameters.neighbours.k
    found = judge_points(scored, points[unscored], k, threads, their_scans, viewpoints)
    judged = Judged.nothing(len(points))
    judged.score[rows], judged.reason[rows] = found.score, found.reason
    observer.advance(len(rows))
    return judged


def _removals(
    density: NDArray[np.float64],
    judged: Judged,
    membership: Sequence[NDArray[np.int64]],
    percentages: Sequence[Fraction],
    parameters: MethodParameters,
    safe: NDArray[np.bool_],
    observer: Observer,
) -> list[Removal]:
    """Decide what goes of each cluster; what is protected stays."""
    removal = parameters.removal
    if removal.weighs_evidence:
        found = [remove_likely(judged.score[members], removal.confidence) for members in membership]
    else:
        warn_of_densities(density_levels(density), observer)
        found = [
            remove_least_dense(density[members], members, percentage, removal.threshold)
            for members, percentage in zip(membership, percentages, strict=True)
        ]
    return [
        Removal(each.dynamic & ~safe[members], each.threshold)
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
