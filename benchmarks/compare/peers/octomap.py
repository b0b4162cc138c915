"""OctoMap (Hornung et al., Autonomous Robots 2013) after a statistical filter on every scan.

What is kept are the points in voxels that are more likely occupied than free in the end; the
filter, as in the DynamicMap benchmark, keeps stray returns from occupying any.
"""

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method, Removal, Unavailable, versions_of
from benchmarks.compare.peers.open3d_outliers import open3d_library, statistical_outliers
from benchmarks.compare.scene import Scene

__all__ = ["METHODS"]

VOXEL = 0.1
"""Metres."""

MAX_RANGE = 50.0
"""Metres, of a ray that frees space."""


def _load() -> Removal:
    try:
        import pyoctomap  # noqa: PLC0415
    except ImportError as error:
        raise Unavailable(f"pyoctomap is not installed ({error})") from None
    open3d = open3d_library()

    def remove(scene: Scene) -> NDArray[np.bool_]:
        tree = pyoctomap.OcTree(VOXEL)
        for scan in scene.scans():
            points = scan.points[~statistical_outliers(open3d, scan.points)]
            tree.insertPointCloud(points, scan.origin, max_range=MAX_RANGE, lazy_eval=True)
        tree.updateInnerOccupancy()
        voxels, voxel_of_point = np.unique(
            np.floor(scene.xyz / VOXEL).astype(np.int64), axis=0, return_inverse=True
        )
        nodes = (tree.search(centre) for centre in (voxels + 0.5) * VOXEL)
        occupied = np.fromiter(
            (node is not None and tree.isNodeOccupied(node) for node in nodes),
            dtype=np.bool_,
            count=len(voxels),
        )
        return ~occupied[voxel_of_point.ravel()]

    return remove


_VERSION = versions_of("pyoctomap", "open3d", "open3d-cpu")

METHODS = (Method(f"OctoMap ({VOXEL} m) with SOR", Family.SCANS, _load, version=_VERSION),)
