"""Sparse voxels: what a first look at a map suggests, with no neighbours and nothing learnt."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method, Removal
from benchmarks.compare.scene import Scene

__all__ = ["METHODS"]

SIDE = 0.2
"""Metres."""

SHARE = 0.1
"""Of the median count of occupied voxels, below which a voxel goes."""

COLUMN = 0.2
"""Metres: width of the columns of the other method; a wall or a rack fills most of its own."""

FILLED = 0.5


def _load_counts() -> Removal:
    def remove(scene: Scene) -> NDArray[np.bool_]:
        count = _counts(np.floor(scene.xyz / SIDE).astype(np.int64))
        return np.asarray(count < SHARE * np.median(count))

    return remove


def _load_columns() -> Removal:
    def remove(scene: Scene) -> NDArray[np.bool_]:
        cells = np.floor(scene.xyz / COLUMN).astype(np.int64)
        occupied, place = np.unique(cells, axis=0, return_inverse=True)
        columns, of = np.unique(occupied[:, :2], axis=0, return_inverse=True)
        filled = np.bincount(of.ravel(), minlength=len(columns))
        low = np.full(len(columns), np.iinfo(np.int64).max)
        np.minimum.at(low, of.ravel(), occupied[:, 2])
        high = np.full(len(columns), np.iinfo(np.int64).min)
        np.maximum.at(high, of.ravel(), occupied[:, 2])
        column = of.ravel()[place.ravel()]
        above = cells[:, 2] > low[column]  # the lowest voxel is the floor
        gaps = filled[column] < FILLED * (high - low + 1)[column]
        return np.asarray(above & gaps)

    return remove


def _counts(cells: NDArray[np.int64]) -> NDArray[np.int64]:
    _, place, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    return np.asarray(count[place.ravel()])


METHODS = (
    Method(f"Sparse voxels ({SIDE} m, {SHARE} of the median)", Family.MAP, _load_counts),
    Method(f"Columns with gaps ({COLUMN} m, {FILLED})", Family.MAP, _load_columns),
)
