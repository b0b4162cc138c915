"""DUFOMap (Duberg et al., RA-L 2024, arXiv 2403.01449), by its authors' Python package.

Space that one scan saw to be void, with a margin, cannot hold anything static: whatever any scan
has there moved.
"""

import os

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method, Removal, Unavailable
from benchmarks.compare.scene import Scan, Scene

__all__ = ["METHODS"]

VOXEL, HIT_INFLATION, UNKNOWN_INFLATION = 0.1, 0.2, 2
"""Metres, metres and voxels: what the authors' own program uses for all sensors."""


def _load() -> Removal:
    try:
        import dufomap  # noqa: PLC0415
    except ImportError as error:
        raise Unavailable(f"dufomap is not installed ({error})") from None

    def remove(scene: Scene) -> NDArray[np.bool_]:
        threads = len(os.sched_getaffinity(0))
        grid = dufomap.dufomap(VOXEL, HIT_INFLATION, UNKNOWN_INFLATION, num_threads=threads)
        for scan in scene.scans():
            grid.run(scan.in_sensor_frame(), _pose(scan), cloud_transform=True)
        grid.oncePropagateCluster(if_propagate=True, if_cluster=False)
        removed = np.zeros(len(scene), dtype=np.bool_)
        for scan in scene.scans():
            labels = grid.segment(scan.in_sensor_frame(), _pose(scan), cloud_transform=True)
            removed[scan.rows] = labels == 1
        return removed

    return remove


def _pose(scan: Scan) -> NDArray[np.float64]:
    return np.vstack([scan.pose, [0, 0, 0, 1]])


METHODS = (Method("DUFOMap (0.1 m, 0.2 m, 2)", Family.SCANS, _load),)
