"""PDAL's `filters.outlier` with its defaults."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method, Removal, Unavailable
from benchmarks.compare.scene import Scene

__all__ = ["METHODS"]

_NOISE = 7
"""The class it gives to outliers (ASPRS: low point, noise)."""


def _load() -> Removal:
    try:
        import pdal  # noqa: PLC0415
    except ImportError as error:
        raise Unavailable(f"PDAL is not installed ({error})") from None

    def remove(scene: Scene) -> NDArray[np.bool_]:
        points = np.zeros(
            len(scene), dtype=[("X", "f8"), ("Y", "f8"), ("Z", "f8"), ("Classification", "u1")]
        )
        points["X"], points["Y"], points["Z"] = scene.xyz.T
        pipeline = pdal.Filter.outlier().pipeline(points)
        pipeline.execute()
        return np.asarray(pipeline.arrays[0]["Classification"] == _NOISE)

    return remove


METHODS = (Method("PDAL filters.outlier (statistical, 8, 2.0)", Family.MAP, _load),)
