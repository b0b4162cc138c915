"""The cleaned map against the original, point by point: what was removed, and should have been."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from dynahull.progress import Observer
from pipeline.evaluation.confusion import Confusion, DynamicMapAccuracy, Tally
from pipeline.evaluation.labels import Truth
from pipeline.evaluation.nearest_point import look_up
from pipeline.evaluation.options import EvaluationOptions
from pipeline.evaluation.preservation import Preservation, compare_voxels
from pipeline.evaluation.tiled_cloud import TiledCloud, distance_apart

_LEAST_OF_TRUTH = 0.5
"""Share of the truth below which a warning is due: some of it may be hidden in the original."""

_LEAST_OF_CLEANED = 0.99
"""Share of the cleaned map below which a warning is due: all of it should be in the original."""


@dataclass(frozen=True, slots=True)
class Scores:
    """The figures that count points and voxels."""

    confusion: Confusion
    accuracy: DynamicMapAccuracy
    preservation: Preservation


def label_by_map(
    original: TiledCloud, truth: TiledCloud, options: EvaluationOptions, observer: Observer
) -> None:
    """Call static what the truth holds, and dynamic the other points of the original.

    Parameters
    ----------
    original : TiledCloud
        Its points are labelled.
    truth : TiledCloud
    options : EvaluationOptions
        Its `truth_tolerance`.
    observer : Observer
        Is warned where much of the truth is not in the original.
    """
    tolerance = options.truth_tolerance
    for tile, nearest in look_up(original, truth, observer, "labels", tolerance):
        found = np.isfinite(nearest.distances)
        original.relabel(tile, np.where(found, Truth.STATIC, Truth.DYNAMIC))
    static = len(original.choose(Truth.STATIC))
    if 0 < static < _LEAST_OF_TRUTH * len(truth):
        observer.warn(
            f"{truth.name} has {len(truth):,} points, and only {static:,} of {original.name} are "
            f"within {tolerance:g} m of one: if it is another recording, or was rounded, raise "
            "--truth-tolerance"
        )


def label_cleaned(
    cleaned: TiledCloud, original: TiledCloud, options: EvaluationOptions, observer: Observer
) -> None:
    """Give each point of the cleaned map the label of the nearest point of the original.

    Parameters
    ----------
    cleaned : TiledCloud
        Its points are labelled.
    original : TiledCloud
        With its labels.
    options : EvaluationOptions
        Its `cleaned_tolerance`.
    observer : Observer
        Is warned where many of the points are not in the original.
    """
    at_place = 0
    for tile, nearest in look_up(cleaned, original, observer, "cleaned points"):
        cleaned.relabel(tile, nearest.labels)
        at_place += int(np.count_nonzero(nearest.distances <= options.cleaned_tolerance))
    if at_place >= _LEAST_OF_CLEANED * len(cleaned):
        return
    if apart := distance_apart(cleaned, original):
        observer.warn(
            f"{cleaned.name} lies {apart:g} m from {original.name}: is that the map that was "
            "cleaned, in the same coordinates?"
        )
        return
    observer.warn(
        f"only {at_place:,} of the {len(cleaned):,} points of {cleaned.name} are within "
        f"{options.cleaned_tolerance:g} m of a point of {original.name}: if they were thinned "
        "out or rounded, raise --cleaned-tolerance"
    )


def score(
    cleaned: TiledCloud,
    original: TiledCloud,
    removed_known: bool,
    options: EvaluationOptions,
    folder: Path,
    observer: Observer,
) -> Scores:
    """Count what was rightly and wrongly removed.

    Parameters
    ----------
    cleaned : TiledCloud
        Its points of known truth.
    original : TiledCloud
        With its labels.
    removed_known : bool
        Whether the original knows which of its points were removed; otherwise it learns it: those
        without a point of the cleaned map within `options.cleaned_tolerance`.
    options : EvaluationOptions
    folder : Path
        For means of voxels.
    observer : Observer
    """
    tolerance, match_distance = options.cleaned_tolerance, options.match_distance
    decisions, matches = Tally(), Tally()
    at_most = max(tolerance, match_distance)
    for tile, nearest in look_up(original, cleaned, observer, "original points", at_most):
        labels = original.labels(tile)
        if not removed_known:
            original.mark_removed(tile, nearest.distances > tolerance)
        decisions.add(labels, original.removed(tile))
        matches.add(labels, nearest.distances <= match_distance)
    return Scores(
        confusion=Confusion.of(decisions),
        accuracy=DynamicMapAccuracy.of(matches, match_distance),
        preservation=compare_voxels(
            original.choose(Truth.STATIC, Truth.DYNAMIC),
            cleaned,
            options.voxel,
            folder / "voxels",
            observer,
        ),
    )
