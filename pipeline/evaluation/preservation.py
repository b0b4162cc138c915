"""Preservation and rejection rate of ERASOR, on voxels."""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from pipeline.evaluation.cloud import NearestPoint
from pipeline.evaluation.confusion import harmonic_mean, percentage
from pipeline.evaluation.labels import Labels, Truth

_MOST_VOXELS = 4_000_000
"""Voxels that are gathered from batches before those of the same place are put together."""

_Voxels = tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]
"""Cells, (n, 3), sums of their points, (n, 3), and numbers of their points, (n,)."""


class Preservation(BaseModel):
    """How much of what is static is preserved, and of what moved is rejected; in percent.

    Lim, Hwang, Myung: ERASOR (RA-L 2021, arXiv 2103.04316). The text, as its successor ERASOR++
    (ICRA 2024) quotes it: PR is the share of all static points that are preserved, RR that of all
    dynamic points that are removed, both counted by voxels of 0.2 m. The code, which this follows
    (LimHyungTae/ERASOR, `scripts/analysis.py` and `voxelize_preserving_labels`): both maps become
    one point a voxel, the mean of its points, with the label of the map's point nearest to the
    mean; a point of the original is preserved if the nearest point of the cleaned map is nearer
    than half a voxel's diagonal and has the same label. The code's list of dynamic classes lacks
    258, the moving truck; here they are what the user says.

    Attributes
    ----------
    preservation_rate : float or None
        PR.
    rejection_rate : float or None
        RR.
    f1 : float or None
        2 PR RR / (PR + RR).
    voxel : float
        Edge, metres.
    static_voxels, dynamic_voxels : int
        Of the original.
    """

    model_config = ConfigDict(frozen=True)

    preservation_rate: float | None
    rejection_rate: float | None
    f1: float | None
    voxel: float
    static_voxels: int
    dynamic_voxels: int

    @classmethod
    def of(
        cls,
        original: NDArray[np.float64],
        original_labels: Labels,
        cleaned: NDArray[np.float64],
        cleaned_labels: Labels,
        voxel: float,
    ) -> "Preservation":
        """Compare two maps of one labelled point a voxel.

        Parameters
        ----------
        original, cleaned : (n, 3) and (m, 3) float64 arrays
            Voxel means; m > 0.
        original_labels, cleaned_labels : (n,) and (m,) int8 arrays
            Of `Truth`.
        voxel : float
            Edge, metres.
        """
        distances, nearest = NearestPoint(cleaned).find(original)
        near = distances < voxel * math.sqrt(3) / 2
        preserved = near & (cleaned_labels[nearest] == original_labels)
        static = original_labels == Truth.STATIC
        moved = original_labels == Truth.DYNAMIC
        static_count, moved_count = int(np.count_nonzero(static)), int(np.count_nonzero(moved))
        kept = percentage(int(np.count_nonzero(static & preserved)), static_count)
        rejected = percentage(moved_count - int(np.count_nonzero(moved & preserved)), moved_count)
        return cls(
            preservation_rate=kept,
            rejection_rate=rejected,
            f1=harmonic_mean(kept, rejected),
            voxel=voxel,
            static_voxels=static_count,
            dynamic_voxels=moved_count,
        )


def voxel_means(
    batches: Iterable[NDArray[np.float64]], voxel: float, most_voxels: int = _MOST_VOXELS
) -> NDArray[np.float64]:
    """Return the mean of the points in each voxel, as PCL's `VoxelGrid` does.

    Parameters
    ----------
    batches : iterable of (n, 3) float64 arrays
    voxel : float
        Edge, metres; the voxels' corners are whole multiples of it.
    most_voxels : int
        Memory is bounded by this number and that of all voxels.

    Returns
    -------
    (m, 3) float64 array
        In the order of the voxels.
    """
    parts: list[_Voxels] = [(np.empty((0, 3), np.int64), np.empty((0, 3)), np.empty(0, np.int64))]
    for xyz in batches:
        cells = np.floor(xyz / voxel).astype(np.int64)
        parts.append(_put_together(cells, xyz, np.ones(len(xyz), dtype=np.int64)))
        # Where voxels are many, only when there are twice as many: the sorting stays cheap.
        if sum(len(part[0]) for part in parts) > max(most_voxels, 2 * len(parts[0][0])):
            parts = [_merged(parts)]
    _, sums, counts = _merged(parts)
    return sums / counts[:, np.newaxis]


def _merged(parts: list[_Voxels]) -> _Voxels:
    cells, sums, counts = (np.concatenate(column) for column in zip(*parts, strict=True))
    return _put_together(cells, sums, counts)


def _put_together(
    cells: NDArray[np.int64], sums: NDArray[np.float64], counts: NDArray[np.int64]
) -> _Voxels:
    """Add up what lies in the same cell."""
    if len(cells) == 0:
        return cells, sums, counts
    order = np.lexsort(cells.T)
    cells = cells[order]
    starts = np.flatnonzero(np.r_[True, (cells[1:] != cells[:-1]).any(axis=1)])
    return (
        cells[starts],
        np.add.reduceat(sums[order], starts, axis=0),
        np.add.reduceat(counts[order], starts),
    )
