"""The cleaned map against the original, point by point: what was removed, and should have been."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynahull.progress import Observer
from pipeline.evaluation.cloud import Cloud, NearestPoint, look_up
from pipeline.evaluation.confusion import Confusion, DynamicMapAccuracy
from pipeline.evaluation.labels import Labels, Truth
from pipeline.evaluation.options import EvaluationOptions
from pipeline.evaluation.preservation import Preservation, voxel_means

_LEAST_OF_TRUTH = 0.5
"""Share of the truth below which a warning is due: some of it may be hidden in the original."""

_LEAST_OF_CLEANED = 0.99
"""Share of the cleaned map below which a warning is due: all of it should be in the original."""


@dataclass(frozen=True, slots=True)
class ScoredMap:
    """The original map, what is true of its points, and what became of them.

    Attributes
    ----------
    original : Cloud
    labels : (N,) int8 array
        Of `Truth`.
    removed : (N,) bool array
    """

    original: Cloud
    labels: Labels
    removed: NDArray[np.bool_]


@dataclass(frozen=True, slots=True)
class Scores:
    """The figures that count points and voxels, and the points that were counted."""

    confusion: Confusion
    accuracy: DynamicMapAccuracy
    preservation: Preservation
    scored: ScoredMap


def label_by_map(
    original: Cloud, truth: Cloud, options: EvaluationOptions, observer: Observer
) -> Labels:
    """Call static what the truth holds, and dynamic the other points of the original.

    Parameters
    ----------
    original, truth : Cloud
    options : EvaluationOptions
        Its `truth_tolerance`.
    observer : Observer
        Is warned where much of the truth is not in the original.

    Returns
    -------
    (N,) int8 array
        Of `Truth`; unknown where a coordinate is not finite.
    """
    points = truth.points()
    labels = np.full(original.row_count, Truth.UNKNOWN, dtype=np.int8)
    tolerance = options.truth_tolerance
    for rows, distances, _ in look_up(
        original, NearestPoint(points), observer, "labels", tolerance
    ):
        labels[rows] = np.where(distances <= tolerance, Truth.STATIC, Truth.DYNAMIC)
    static = int(np.count_nonzero(labels == Truth.STATIC))
    if static < _LEAST_OF_TRUTH * len(points):
        observer.warn(
            f"{truth.name} has {len(points):,} points, and only {static:,} of {original.name} are "
            f"within {tolerance:g} m of one: if it is another recording, or was rounded, raise "
            "--truth-tolerance"
        )
    return labels


def label_cleaned(
    cleaned: Cloud,
    original: Cloud,
    labels: Labels,
    options: EvaluationOptions,
    observer: Observer,
) -> Labels:
    """Give each point of the cleaned map the label of the nearest point of the original.

    Parameters
    ----------
    cleaned, original : Cloud
    labels : (N,) int8 array
        `Truth` of each row of the original.
    options : EvaluationOptions
        Its `cleaned_tolerance`.
    observer : Observer
        Is warned where many of the points are not in the original.

    Returns
    -------
    (M,) int8 array
        Of `Truth`, one for each row of the cleaned map; unknown where a coordinate is not finite.
    """
    points, labels = original.labelled_points(labels)
    nearest = NearestPoint(points)
    found_labels = np.full(cleaned.row_count, Truth.UNKNOWN, dtype=np.int8)
    count = at_place = 0
    for rows, distances, indices in look_up(cleaned, nearest, observer, "cleaned points"):
        found_labels[rows] = labels[indices]
        count += len(rows)
        at_place += int(np.count_nonzero(distances <= options.cleaned_tolerance))
    if at_place < _LEAST_OF_CLEANED * count:
        observer.warn(
            f"only {at_place:,} of the {count:,} points of {cleaned.name} are within "
            f"{options.cleaned_tolerance:g} m of a point of {original.name}: if they were thinned "
            "out or rounded, raise --cleaned-tolerance"
        )
    return found_labels


def score(
    cleaned: Cloud,
    cleaned_labels: Labels,
    original: Cloud,
    labels: Labels,
    removed: NDArray[np.bool_] | None,
    options: EvaluationOptions,
    observer: Observer,
) -> Scores:
    """Count what was rightly and wrongly removed.

    Parameters
    ----------
    cleaned : Cloud
        Its points with known labels.
    cleaned_labels : (m,) int8 array
        Those labels, in the order of its points.
    original : Cloud
    labels : (N,) int8 array
        `Truth` of each row of the original.
    removed : (N,) bool array or None
        Which rows were removed; None: those without a point of the cleaned map within
        `options.cleaned_tolerance`.
    options : EvaluationOptions
    observer : Observer

    Returns
    -------
    Scores
    """
    means = voxel_means((xyz for _, xyz in cleaned.batches()), options.voxel)
    nearest = NearestPoint(cleaned.points())
    tolerance, match_distance = options.cleaned_tolerance, options.match_distance
    gone, matched = np.zeros((2, original.row_count), dtype=np.bool_)
    at_most = max(tolerance, match_distance)
    for rows, distances, _ in look_up(original, nearest, observer, "original points", at_most):
        gone[rows] = distances > tolerance
        matched[rows] = distances <= match_distance
    mean_labels = cleaned_labels[nearest.find(means)[1]]
    del nearest
    removed = gone if removed is None else removed
    return Scores(
        confusion=Confusion.of(labels, removed),
        accuracy=DynamicMapAccuracy.of(labels, matched, match_distance),
        preservation=_preservation(
            original.choose(labels != Truth.UNKNOWN), labels, means, mean_labels, options.voxel
        ),
        scored=ScoredMap(original, labels, removed),
    )


def _preservation(
    known: Cloud,
    labels: Labels,
    cleaned_means: NDArray[np.float64],
    cleaned_labels: Labels,
    voxel: float,
) -> Preservation:
    """Make the original's labelled points one a voxel, and compare."""
    means = voxel_means((xyz for _, xyz in known.batches()), voxel)
    points, labels = known.labelled_points(labels)
    mean_labels = labels[NearestPoint(points).find(means)[1]]
    return Preservation.of(means, mean_labels, cleaned_means, cleaned_labels, voxel)
