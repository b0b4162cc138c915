"""PDAL's `filters.outlier` with its defaults, by the program `pdal`: packages have no library.

Its time includes that of reading and writing two LAS files, as it does for who calls it so.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path

import laspy
import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method, Removal, Unavailable
from benchmarks.compare.scene import Scene

__all__ = ["METHODS"]

_NOISE = 7
"""The class it gives to outliers (ASPRS: low point, noise)."""

_GRID = 1e-4
"""Metres, of the coordinates in LAS."""


def _load() -> Removal:
    program = shutil.which("pdal")
    if program is None:
        raise Unavailable("PDAL is not installed (no program pdal)")

    def remove(scene: Scene) -> NDArray[np.bool_]:
        with tempfile.TemporaryDirectory() as folder:
            before, after = Path(folder, "before.las"), Path(folder, "after.las")
            _write(scene.xyz, before)
            command = [program, "translate", str(before), str(after), "outlier"]
            subprocess.run(command, check=True, capture_output=True)
            classes = np.asarray(laspy.read(after).classification)
            return np.asarray(classes == _NOISE, dtype=np.bool_)

    return remove


def _version() -> str:
    program = shutil.which("pdal")
    if program is None:
        return ""
    return subprocess.run(
        [program, "--version"], check=False, capture_output=True, text=True
    ).stdout


def _write(xyz: NDArray[np.float64], path: Path) -> None:
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales, header.offsets = [_GRID] * 3, np.floor(xyz.min(axis=0))
    points = laspy.LasData(header)
    points.xyz = xyz
    points.write(path)


METHODS = (
    Method("PDAL filters.outlier (statistical, 8, 2.0)", Family.MAP, _load, version=_version),
)
