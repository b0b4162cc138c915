"""Preservation and rejection rate of ERASOR, on voxels."""

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from dynahull.progress import Observer
from pipeline.evaluation.confusion import Tally, harmonic_mean, percentage
from pipeline.evaluation.labels import Labels, Truth
from pipeline.evaluation.nearest_point import find_nearest
from pipeline.evaluation.tiled_cloud import TiledCloud, voxel_cells


class Preservation(BaseModel):
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

    model_config = ConfigDict(frozen=True)

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

    Parameters
    ----------
    points : (n, 3) float64 array
        All points of each of their voxels.
    voxel : float
        Edge, metres; the voxels' corners are whole multiples of it.

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

    Parameters
    ----------
    original, cleaned : TiledCloud
        Their labelled points.
    voxel : float
        Edge, metres, as the maps were cut.
    folder : Path
        For the means of the cleaned map.
    observer : Observer
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
