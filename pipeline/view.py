"""A cleaned map on the screen, what was removed in red: `dynahull-pipeline view`.

Open3D draws it, an optional extra: it does this best, and nothing else here needs it.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.errors import MissingViewerError, OutputError
from pipeline.outputs import RUN_FILE
from tiling.formats import open_map

STATIC_COLOUR = (0.35, 0.4, 0.45)
DYNAMIC_COLOUR = (0.85, 0.15, 0.1)


def read_result(folder: Path) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Read the points of a finished run.

    Parameters
    ----------
    folder : Path
        An output folder of `run`.

    Returns
    -------
    static, dynamic : (n, 3) and (m, 3) float64 arrays
        Finite points, relative to the lowest corner of the map: viewers draw in single precision.

    Raises
    ------
    OutputError
        When the folder holds no complete result.
    """
    try:
        files = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))["files"]
    except (OSError, ValueError, KeyError, TypeError):
        raise OutputError(f"{folder}: expected the output of a run, found no {RUN_FILE}") from None
    static, dynamic = (
        np.concatenate([_finite_points(folder / file[kind]) for file in files])
        for kind in ("static", "dynamic")
    )
    both = np.concatenate([static, dynamic])
    corner = both.min(axis=0) if len(both) else np.zeros(3)
    return static - corner, dynamic - corner


def view_result(folder: Path) -> None:
    """Open a window with the result of a run.

    Raises
    ------
    MissingViewerError
        When Open3D is not installed, or cannot be loaded.
    OutputError
        When the folder holds no complete result.
    """
    static, dynamic = read_result(folder)
    try:
        import open3d  # noqa: PLC0415 (optional, and seconds of import time)
    except (ImportError, OSError) as error:
        raise MissingViewerError(
            f"view needs Open3D: pip install 'dynahull-pipeline[open3d]' ({error})"
        ) from error
    clouds = [
        _cloud(open3d, static, STATIC_COLOUR),
        _cloud(open3d, dynamic, DYNAMIC_COLOUR),
    ]
    open3d.visualization.draw_geometries(clouds, window_name=str(folder))


def _finite_points(path: Path) -> NDArray[np.float64]:
    batches = [np.empty((0, 3)), *(batch.xyz for batch in open_map(path).batches())]
    points = np.concatenate(batches)
    return np.asarray(points[np.isfinite(points).all(axis=1)])


def _cloud(open3d: Any, points: NDArray[np.float64], colour: tuple[float, float, float]) -> Any:
    cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
    cloud.paint_uniform_color(colour)
    return cloud
