"""The voxel filter that SLAM systems thin scans and maps with."""

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from pipeline.simulation.meshes.simulate import Points


def voxel_filter(points: "Points", size: float) -> "Points":
    """Put the centroid of its points in each voxel, as PCL's `VoxelGrid` does.

    Parameters
    ----------
    points : Points
    size : float
        In metres; 0 leaves all as it is.

    Returns
    -------
    Points
        What most points of a voxel are, in the order of their first points.
    """
    if not size or not len(points):
        return points
    cell = np.floor(points.xyz / size).astype(np.int64)
    cell -= cell.min(axis=0)
    sides = cell.max(axis=0) + 1
    key = (cell[:, 0] * sides[1] + cell[:, 1]) * sides[2] + cell[:, 2]
    _, first, voxel = np.unique(key, return_index=True, return_inverse=True)
    count = np.bincount(voxel)
    kept = points.take(first)
    kept.xyz[:] = np.stack(
        [np.bincount(voxel, points.xyz[:, axis]) / count for axis in range(3)], axis=1
    )
    moved = np.bincount(voxel, points.moved) / count
    kept.moved[:] = moved > 0.5
    kept.known[:] = np.bincount(voxel, points.known) / count > 0.5
    return kept.take(np.argsort(first, kind="stable"))
