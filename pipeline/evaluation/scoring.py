"""The cleaned map against the original, point by point: what was removed, and should have been."""

import math
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from dynahull.observer import Observer
from pipeline.evaluation.inputs import EvaluationOptions
from pipeline.evaluation.tiled_cloud import (
    TiledCloud,
    distance_apart,
    find_nearest,
    look_up,
    voxel_cells,
)
from pipeline.evaluation.truth import Labels, Truth


def percentage(part: int, whole: int) -> float | None:
    """Return 100 part / whole; None, undefined, where `whole` is 0."""
    return 100 * part / whole if whole else None


def harmonic_mean(first: float | None, second: float | None) -> float | None:
    """Return 2 a b / (a + b); 0 where both are 0, None where one is undefined."""
    if first is None or second is None:
        return None
    return 2 * first * second / (first + second) if first + second else 0.0


class Tally:
    """Points, counted by their truth and by something that is so or not, batch by batch."""

    def __init__(self) -> None:
        self._counts = np.zeros(2 * len(Truth), np.int64)

    def add(self, labels: Labels, so: NDArray[np.bool_]) -> Self:
        """Count some more: their truth, (n,), and whether it is so, (n,)."""
        self._counts += np.bincount(2 * labels.astype(np.intp) + so, minlength=len(self._counts))
        return self

    def of(self, truth: Truth) -> tuple[int, int]:
        """Return of how many points of a truth it is not so, and of how many it is."""
        return int(self._counts[2 * truth]), int(self._counts[2 * truth + 1])


class Confusion(BaseModel, frozen=True):
    """The four counts over the labelled points of the original map, and their shares in percent.

    "Positive" means removed: a false positive is a piece of wall that is gone, a false negative a
    ghost that is left. So a method that removes less has fewer false positives, as the DynaHull
    paper (arXiv 2401.07541) says of its adaptive threshold.

    A share with nothing to be a share of is None.
    """

    true_positives: int
    false_positives: int
    false_negatives: int
    true_negatives: int
    """TP: moved, removed. FP: static, removed. FN: moved, kept. TN: static, kept."""
    false_positive_percent: float | None
    """100 FP / (FP + TN), of the static points."""
    false_negative_percent: float | None
    """100 FN / (FN + TP), of the points that moved."""
    false_positive_percent_of_all: float | None
    false_negative_percent_of_all: float | None
    """The same counts as shares of all labelled points."""
    precision: float | None
    """100 TP / (TP + FP), of what was removed."""
    recall: float | None
    """100 TP / (TP + FN), of what moved."""
    f1: float | None
    """Harmonic mean of precision and recall."""

    def summary(self) -> str:
        """Return the two shares that say most, in words."""
        precision, recall = (
            "undefined" if value is None else f"{value:.1f} %"
            for value in (self.precision, self.recall)
        )
        return (
            f"precision {precision} (of what was removed, what had moved), "
            f"recall {recall} (of what had moved, what was removed)"
        )

    @classmethod
    def of(cls, decisions: "Tally") -> "Confusion":
        """Take them of the labelled points, counted by truth and by whether they were removed."""
        (tn, fp), (fn, tp) = decisions.of(Truth.STATIC), decisions.of(Truth.DYNAMIC)
        precision, recall = percentage(tp, tp + fp), percentage(tp, tp + fn)
        return cls(
            true_positives=tp,
            false_positives=fp,
            false_negatives=fn,
            true_negatives=tn,
            false_positive_percent=percentage(fp, fp + tn),
            false_negative_percent=percentage(fn, fn + tp),
            false_positive_percent_of_all=percentage(fp, tp + fp + fn + tn),
            false_negative_percent_of_all=percentage(fn, tp + fp + fn + tn),
            precision=precision,
            recall=recall,
            f1=harmonic_mean(precision, recall),
        )


class DynamicMapAccuracy(BaseModel, frozen=True):
    """The figures of the DynamicMap benchmark, in percent.

    Zhang, Duberg, Geng, Jia, Wang, Jensfelt: A Dynamic Points Removal Benchmark in Point Cloud Maps
    (ITSC 2023, arXiv 2307.07260), as its code computes them (KTH-RPL/DynamicMap_Benchmark,
    `export_eval_pcd.cpp` and `evaluate_all.py`): a labelled point counts as kept if the cleaned
    map has a point within `match_distance` of it, its own or another's. So a ghost that touches a
    wall is never removed, whatever a method does.
    """

    static_accuracy: float | None
    """SA, static points kept / static points."""
    dynamic_accuracy: float | None
    """DA, points that moved and are not kept / points that moved."""
    associated_accuracy: float | None
    """AA, sqrt(SA DA)."""
    harmonic_accuracy: float | None
    """HA, 2 SA DA / (SA + DA)."""
    match_distance: float
    """Metres."""

    @classmethod
    def of(cls, matches: "Tally", match_distance: float) -> "DynamicMapAccuracy":
        """Take them of points counted by truth and by whether the cleaned map has one so near."""
        static, moved = matches.of(Truth.STATIC), matches.of(Truth.DYNAMIC)
        sa, da = percentage(static[1], sum(static)), percentage(moved[0], sum(moved))
        return cls(
            static_accuracy=sa,
            dynamic_accuracy=da,
            associated_accuracy=None if sa is None or da is None else math.sqrt(sa * da),
            harmonic_accuracy=harmonic_mean(sa, da),
            match_distance=match_distance,
        )


class Preservation(BaseModel, frozen=True):
    """How much of what is static is preserved, and of what moved is rejected; in percent.

    Lim, Hwang, Myung: ERASOR (RA-L 2021, arXiv 2103.04316). The text, as its successor ERASOR++
    (ICRA 2024) quotes it: PR is the share of all static points that are preserved, RR that of all
    dynamic points that are removed, both counted by voxels of 0.2 m. The code, which this follows
    (LimHyungTae/ERASOR, `scripts/analysis.py` and `voxelize_preserving_labels`): both maps become
    one point a voxel, the mean of its points, with the label of the map's point nearest to the
    mean; a point of the original is preserved if the nearest point of the cleaned map is nearer
    than half a voxel's diagonal and has the same label. Of equally near points the static one
    counts here, where in the code the order of the rows decides. The code's list of dynamic classes
    lacks 258, the moving truck; here they are what the user says.
    """

    preservation_rate: float | None
    """PR."""
    rejection_rate: float | None
    """RR."""
    f1: float | None
    """2 PR RR / (PR + RR)."""
    voxel: float
    """Edge, metres."""
    static_voxels: int
    dynamic_voxels: int
    """Of the original."""

    @classmethod
    def of(cls, voxels: Tally, voxel: float) -> "Preservation":
        """Take them of the original's voxels, counted by truth and by whether it is preserved."""
        static, moved = voxels.of(Truth.STATIC), voxels.of(Truth.DYNAMIC)
        kept, rejected = percentage(static[1], sum(static)), percentage(moved[0], sum(moved))
        return cls(
            preservation_rate=kept,
            rejection_rate=rejected,
            f1=harmonic_mean(kept, rejected),
            voxel=voxel,
            static_voxels=sum(static),
            dynamic_voxels=sum(moved),
        )


def voxel_means(points: NDArray[np.float64], voxel: float) -> NDArray[np.float64]:
    """Return the mean of the points in each voxel, as PCL's `VoxelGrid` does.

    The voxels' corners are whole multiples of their edge, in metres. Of (n, 3) points, all of each
    of their voxels, they are (m, 3), by voxel; the order of the points does not change a bit.
    """
    if not len(points):
        return points
    # By cell, and within it by place: sums are rounded, and must not depend on the rows.
    cells = voxel_cells(points, voxel)
    order = np.lexsort((*points.T[::-1], *cells.T[::-1]))
    cells, points = cells[order], points[order]
    starts = np.flatnonzero(np.r_[True, (cells[1:] != cells[:-1]).any(axis=1)])
    counts = np.diff(np.r_[starts, len(points)])
    return np.asarray(np.add.reduceat(points, starts, axis=0) / counts[:, np.newaxis])


def compare_voxels(
    original: TiledCloud, cleaned: TiledCloud, voxel: float, folder: Path, observer: Observer
) -> Preservation:
    """Make one labelled point a voxel of two maps, and compare.

    The edge of a voxel is that by which the maps were cut. The means of the cleaned map lie in the
    folder.
    """
    means = TiledCloud(cleaned.name, folder, len(cleaned.low))
    for tile, xyz, labels in _labelled_means(cleaned, voxel, "voxels, cleaned", observer):
        means.append(tile, xyz, labels)
    reach = voxel * math.sqrt(3) / 2
    voxels = Tally()
    for _, xyz, labels in _labelled_means(original, voxel, "voxels, original", observer):
        nearest = find_nearest(xyz, means, reach)
        voxels.add(labels, (nearest.distances < reach) & (nearest.labels == labels))
    return Preservation.of(voxels, voxel)


def _labelled_means(
    cloud: TiledCloud, voxel: float, stage: str, observer: Observer
) -> Iterator[tuple[int, NDArray[np.float64], Labels]]:
    """Yield tile by tile the means of the voxels, each with the label of the nearest point."""
    for tile in cloud.watched_tiles(stage, observer):
        means = voxel_means(cloud.xyz(tile), voxel)
        yield tile, means, find_nearest(means, cloud).labels


_LEAST_OF_TRUTH = 0.5
"""Share of the truth below which a warning is due: some of it may be hidden in the original."""

_LEAST_OF_CLEANED = 0.99
"""Share of the cleaned map below which a warning is due: all of it should be in the original."""


class Scores(NamedTuple):
    """The figures that count points and voxels."""

    confusion: Confusion
    accuracy: DynamicMapAccuracy
    preservation: Preservation


def label_by_map(
    original: TiledCloud, truth: TiledCloud, options: EvaluationOptions, observer: Observer
) -> None:
    """Call static what the truth holds, and dynamic the other points of the original.

    By `truth_tolerance` of the options. Warn where much of the truth is not in the original.
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

    By `cleaned_tolerance` of the options. Warn where many points are not in the original.
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
    """Count what was rightly and wrongly removed of an original whose labels are known.

    Parameters
    ----------
    removed_known : bool
        Whether the original knows which of its points were removed; otherwise it learns it: those
        without a point of the cleaned map within `options.cleaned_tolerance`.
    folder : Path
        For means of voxels.
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
