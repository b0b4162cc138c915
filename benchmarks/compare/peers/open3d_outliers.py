"""Outlier removal of Open3D: what a search for "remove noise from a point cloud" finds first."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method, Removal, Unavailable, versions_of
from benchmarks.compare.scene import Scene

__all__ = ["METHODS", "open3d_library", "statistical_outliers"]

NEIGHBOURS, SPREAD = 20, 2.0
"""Of Open3D's own tutorial."""

POINTS, RADIUS = 16, 0.2
"""The tutorial's number of points; its radius of 0.05 m is for one dense depth image."""


def open3d_library() -> Any:
    """Import Open3D."""
    try:
        import open3d  # noqa: PLC0415
    except ImportError as error:
        raise Unavailable(f"open3d is not installed ({error})") from None
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    return open3d


def statistical_outliers(library: Any, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which points are far from their neighbours, by the mean and spread of all."""
    _, kept = _cloud(library, points).remove_statistical_outlier(NEIGHBOURS, SPREAD)
    return _others(kept, len(points))


def _load_statistical() -> Removal:
    library = open3d_library()

    def remove(scene: Scene) -> NDArray[np.bool_]:
        return statistical_outliers(library, scene.xyz)

    return remove


def _load_radius() -> Removal:
    library = open3d_library()

    def remove(scene: Scene) -> NDArray[np.bool_]:
        _, kept = _cloud(library, scene.xyz).remove_radius_outlier(POINTS, RADIUS)
        return _others(kept, len(scene))

    return remove


def _cloud(library: Any, points: NDArray[np.float64]) -> Any:
    return library.geometry.PointCloud(library.utility.Vector3dVector(points))


def _others(kept: Any, count: int) -> NDArray[np.bool_]:
    removed = np.ones(count, dtype=np.bool_)
    removed[np.asarray(kept, dtype=np.intp)] = False
    return removed


_VERSION = versions_of("open3d", "open3d-cpu")

METHODS = (
    Method(
        f"Open3D statistical outliers ({NEIGHBOURS}, {SPREAD})",
        Family.MAP,
        _load_statistical,
        version=_VERSION,
    ),
    Method(
        f"Open3D radius outliers ({POINTS} in {RADIUS} m)",
        Family.MAP,
        _load_radius,
        version=_VERSION,
    ),
)
