"""The ground's surface: a plane for each cell and storey, fitted to the ground levels near it."""

from functools import partial
from typing import NamedTuple

import numpy as np

from dynahull.compilation import compiled, helper, inlined
from dynahull.ground.columns import Levels
from dynahull.ground.lattice import Floats, Integers, Lattice, disk_offsets, slot_at, starts_of
from dynahull.threads import over_items

HEIGHT, SLOPE_X, SLOPE_Y, NOISE = range(4)
"""Columns of `Surface.planes`."""

_SUPPORT = 12
"""Levels that a plane is fitted to, at most: the nearest."""

_SMALLEST_RANGE = 2_000
"""Cells."""

_STOREYS = 16
"""Storeys above each other in one column, at most; further ones are not fitted."""

_RIDGE = 0.03
"""Cells squared. Holds a plane level where its levels lie on a line or on one side."""

_SMALLEST_VARIANCE = 1e-6
"""Metres squared; noise beneath a millimetre is not told apart."""

_FINEST_VARIANCE = 1e-4
"""Metres squared; levels thinner than a centimetre weigh the same."""


class Surface(NamedTuple):
    """Planes by cell, from the lowest storey up."""

    planes: Floats
    """Height at the cell's centre, metres; slope along x and y; noise, metres; (P, 4)."""
    starts: Integers
    """Where the planes of each cell begin, (cells + 1,)."""


def fit_surface(
    levels: Levels,
    lattice: Lattice,
    wanted: Integers,
    extension: float,
    storey: float,
    thickness: float,
    threads: int = 1,
) -> Surface:
    """Fit planes to the ground levels near some cells.

    Parameters
    ----------
    wanted : (cells,) int64 array
        Slots to fit planes for.
    extension : float
        How far from a cell levels count, metres.
    storey : float
        Levels closer in height than this belong to one plane, metres.
    thickness : float
        Of a layer, metres: its spread where it has too few points is that of an even layer.
    """
    offsets = disk_offsets(extension / lattice.cell)
    starts, unknown = starts_of(levels.slots, lattice.slot_count), thickness / np.sqrt(12.0)
    about = (starts, lattice.neighbours, offsets, lattice.cell)
    fit = partial(_fit_planes, levels, *about, storey, unknown, wanted)
    planes, counts = zip(*over_items(fit, len(wanted), threads, _SMALLEST_RANGE), strict=True)
    return Surface(np.concatenate(planes), np.cumsum(np.concatenate([[0], *counts])))


@inlined
def height_over(point: Floats, plane: Floats, cell: float) -> float:
    """Return the height of a point over a plane of its cell, metres."""
    dx = point[0] - (np.floor(point[0] / cell) + 0.5) * cell
    dy = point[1] - (np.floor(point[1] / cell) + 0.5) * cell
    return point[2] - plane[HEIGHT] - plane[SLOPE_X] * dx - plane[SLOPE_Y] * dy


@compiled
def _fit_planes(
    levels: Levels,
    starts: Integers,
    neighbours: Integers,
    offsets: Integers,
    cell: float,
    storey: float,
    unknown: float,
    wanted: Integers,
    first_cell: int,
    end_cell: int,
) -> tuple[Floats, Integers]:
    heights, spreads = levels.heights, levels.spreads
    planes = np.empty((end_cell - first_cell + _STOREYS, 4), np.float64)
    counts = np.zeros(end_cell - first_cell, np.int64)
    sums = np.empty((_STOREYS, 13), np.float64)
    bases = np.empty(_STOREYS, np.float64)
    found = 0
    for place in range(first_cell, end_cell):
        storeys = 0
        for k in range(len(offsets)):
            slot = slot_at(wanted[place], offsets[k, 0], offsets[k, 1], neighbours)
            for level in range(starts[slot], starts[slot + 1]):
                group = 0
                while group < storeys and abs(heights[level] - bases[group]) > storey:
                    group += 1
                if group == _STOREYS:
                    continue
                if group == storeys:
                    storeys += 1
                    bases[group] = heights[level]
                    for term in range(sums.shape[1]):
                        sums[group, term] = 0.0
                if sums[group, 12] < _SUPPORT:
                    rise = heights[level] - bases[group]
                    known = spreads[level] >= 0
                    spread = spreads[level] if known else unknown
                    _add_level(sums[group], offsets[k], rise, spread, known)
        if found + storeys > len(planes):
            planes = _enlarged(planes)
        for _ in range(storeys):
            lowest = _lowest(bases, storeys)
            _solve(sums[lowest], bases[lowest], cell, planes[found])
            found += 1
            bases[lowest] = np.inf
        counts[place - first_cell] = storeys
    return planes[:found], counts


# Loops in place of slices and sorts: compiled, those take ten seconds to compile and are no faster.
@helper
def _enlarged(planes: Floats) -> Floats:
    larger = np.empty((2 * len(planes), 4), np.float64)
    for place in range(len(planes)):
        for column in range(4):
            larger[place, column] = planes[place, column]
    return larger


@helper
def _lowest(bases: Floats, storeys: int) -> int:
    lowest = 0
    for group in range(1, storeys):
        if bases[group] < bases[lowest]:
            lowest = group
    return lowest


@helper
def _add_level(s: Floats, offset: Integers, z: float, spread: float, known: bool) -> None:
    """Add a level to the weighted sums of its storey; horizontal lengths in cells.

    Near levels weigh more, and thin ones: that of a column with the foot of a wall is thick.
    """
    u, v = np.float64(offset[0]), np.float64(offset[1])
    near = 1.0 / (u * u + v * v + 0.5)
    w = near / (spread * spread + _FINEST_VARIANCE)
    s[0] += w
    s[1] += w * u
    s[2] += w * v
    s[3] += w * z
    s[4] += w * u * u
    s[5] += w * u * v
    s[6] += w * v * v
    s[7] += w * u * z
    s[8] += w * v * z
    s[9] += w * z * z
    if known:
        s[10] += near
        s[11] += near / (spread * spread + _SMALLEST_VARIANCE)
    s[12] += 1.0


@helper
def _solve(s: Floats, base: float, cell: float, plane: Floats) -> None:
    """Weighted least squares about the weighted mean, with a ridge on the slopes."""
    mu, mv, mz = s[1] / s[0], s[2] / s[0], s[3] / s[0]
    uu = s[4] / s[0] - mu * mu + _RIDGE
    uv = s[5] / s[0] - mu * mv
    vv = s[6] / s[0] - mv * mv + _RIDGE
    uz = s[7] / s[0] - mu * mz
    vz = s[8] / s[0] - mv * mz
    determinant = uu * vv - uv * uv
    a = (uz * vv - vz * uv) / determinant
    b = (vz * uu - uz * uv) / determinant
    plane[HEIGHT] = base + mz - a * mu - b * mv
    plane[SLOPE_X] = a / cell
    plane[SLOPE_Y] = b / cell
    variance = max(s[9] / s[0] - mz * mz - a * uz - b * vz, 0.0)
    if s[11] > 0:
        # the harmonic mean: a cell that holds the foot of a wall does not widen the floor's noise
        variance += s[10] / s[11]
    plane[NOISE] = np.sqrt(variance)
