"""DUFOMap (Duberg et al., RA-L 2024, arXiv 2403.01449), by its authors' Python package.

Space that one scan saw to be void, with a margin, cannot hold anything static: whatever any scan
has there moved.
"""

import os

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method, Removal, Unavailable, versions_of
from benchmarks.compare.scene import Scan, Scene

__all__ = ["METHODS"]

VOXEL, HIT_INFLATION, UNKNOWN_INFLATION = 0.1, 0.2, 2
"""Metres, metres and voxels: what the authors' own program uses for all sensors."""

MIN_RANGE = 0.3
"""Metres. Some sensors return points at themselves; a single one makes version 1.1.1 find nothing
at all, so nearer points are not shown to it, and kept."""


def _load() -> Removal:
    try:
        import dufomap  # noqa: PLC0415
    except ImportError as error:
        raise Unavailable(f"dufomap is not installed ({error})") from None

    def remove(scene: Scene) -> NDArray[np.bool_]:
        threads = len(os.sched_getaffinity(0))
        grid = dufomap.dufomap(VOXEL, HIT_INFLATION, UNKNOWN_INFLATION, num_threads=threads)
        for scan in scene.scans():
            points, _ = _far(scan)
            grid.run(points, _pose(scan), cloud_transform=True)
        grid.oncePropagateCluster(if_propagate=True, if_cluster=False)
        removed = np.zeros(len(scene), dtype=np.bool_)
        for scan in scene.scans():
            points, rows = _far(scan)
            removed[rows] = grid.segment(points, _pose(scan), cloud_transform=True) == 1
        return removed

    return remove


def _far(scan: Scan) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the points that are not at the sensor itself, in its frame, and their rows."""
    points = scan.in_sensor_frame()
    far = np.linalg.norm(points, axis=1) >= MIN_RANGE
    return points[far], scan.rows[far]


def _pose(scan: Scan) -> NDArray[np.float64]:
    return np.vstack([scan.pose, [0, 0, 0, 1]])


METHODS = (
    Method("DUFOMap (0.1 m, 0.2 m, 2)", Family.SCANS, _load, version=versions_of("dufomap")),
)
