"""The cleaned map against the original, point by point: what was removed, and should have been."""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from dynahull.progress import Observer
from pipeline.evaluation.confusion import (
    Confusion,
    DynamicMapAccuracy,
    Tally,
    harmonic_mean,
    percentage,
)
from pipeline.evaluation.labels import Labels, Truth
from pipeline.evaluation.nearest_point import find_nearest, look_up
from pipeline.evaluation.options import EvaluationOptions
from pipeline.evaluation.tiled_cloud import TiledCloud, distance_apart, voxel_cells


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

    The voxels' corners are whole multiples of their edge, in metres.

    Parameters
    ----------
    points : (n, 3) float64 array
        All points of each of their voxels.

    Returns
    -------
    (m, 3) float64 array
        In the order of the voxels; the order of the points does not change a bit.
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
    observer.stage(stage, len(cloud))
    for tile, count in enumerate(cloud.counts.tolist()):
        if count:
            means = voxel_means(cloud.xyz(tile), voxel)
            yield tile, means, find_nearest(means, cloud).labels
            observer.advance(count)


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
