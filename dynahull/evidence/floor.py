"""What the floor beneath a point says: how high it is, what stands on it, how well it was seen."""

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, inlined
from dynahull.evidence.lattice import Cells, Floats, Integers, find_cell
from dynahull.evidence.surroundings import Surroundings

FLOOR_TERMS = ("height", "aloft", "over", "under", "ground_seen", "ground_near")
"""Height above the floor, up to the reach of people, and above that reach; voxels of 0.4 m that are
occupied above it, in nine columns, and below it, in the point's own; ground points beneath against
those around; ground points in an area of the neighbourhood's own size."""

PEOPLE = np.float32(2.0)
"""Metres: what is higher is seldom part of a person."""


def floor_terms(
    xyz: Floats, height: Floats, scale: npt.NDArray[np.float32], surroundings: Surroundings
) -> npt.NDArray[np.float32]:
    """Return what the floor says of each point, (n, len(FLOOR_TERMS)); NaN where none is near.

    Parameters
    ----------
    xyz : (n, 3) float64 array
    height : (n,) float64 array
    scale : (n,) float32 array
        Logarithm to base 2 of the length of each neighbourhood, metres.
    """
    small, middle, large = (
        (level.cells, level.ground, level.table) for level in surroundings.levels[1:4]
    )
    terms = np.full((len(xyz), len(FLOOR_TERMS)), np.nan, np.float32)
    _floor_terms(xyz, height, scale, small, middle, large, terms)
    return terms


_Lookup = tuple[Cells, Integers, npt.NDArray[np.int32]]


@compiled
def _floor_terms(
    xyz: Floats,
    height: Floats,
    scale: npt.NDArray[np.float32],
    small: _Lookup,
    middle: _Lookup,
    large: _Lookup,
    terms: npt.NDArray[np.float32],
) -> None:
    for p in range(len(xyz)):
        if np.isnan(height[p]):
            continue
        x, y, floor = xyz[p, 0], xyz[p, 1], xyz[p, 2] - height[p]
        i, j, k = _cell(x, 0.4), _cell(y, 0.4), _cell(floor + 0.2, 0.4)
        over = under = 0
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(6, 9):
                    if find_cell(i + di, j + dj, k + dk, middle[0], middle[2]) >= 0:
                        over += 1
        for dk in range(1, 6):
            if find_cell(i, j, k + dk, middle[0], middle[2]) >= 0:
                under += 1
        beneath = _ground_about(_cell(x, 0.2), _cell(y, 0.2), _cell(floor, 0.2), small)
        about = _ground_about(_cell(x, 0.8), _cell(y, 0.8), _cell(floor, 0.8), large)
        above_floor = np.float32(height[p])
        terms[p, 0] = min(above_floor, PEOPLE)
        terms[p, 1] = max(above_floor - PEOPLE, np.float32(0.0))
        terms[p, 2] = over
        terms[p, 3] = under
        terms[p, 4] = np.log2((beneath + 0.5) / (about / 16.0 + 0.5))
        terms[p, 5] = np.log2(about / 5.76 + 0.1) + 2.0 * scale[p]


@inlined
def _cell(place: float, side: float) -> int:
    return int(np.floor(place / side))


@inlined
def _ground_about(i: int, j: int, k: int, lookup: _Lookup) -> int:
    """Count the ground points in 3 x 3 x 3 voxels."""
    count = np.int64(0)
    for di in range(-1, 2):
        for dj in range(-1, 2):
            for dk in range(-1, 2):
                n = find_cell(i + di, j + dj, k + dk, lookup[0], lookup[2])
                if n >= 0:
                    count += lookup[1][n]
    return int(count)
