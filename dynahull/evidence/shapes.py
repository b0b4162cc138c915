"""The shape of what lies in a box of voxels: thin as a wall, or filled as the trail of a walker."""

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, inlined
from dynahull.evidence.voxels import Cells, Floats, Integers
from dynahull.kernels.spread import principal_axes

STEP = 0.001
"""Metres: coordinates are summed in whole steps."""

MOMENTS = 9
"""Columns: the sums of x, y, z, xx, xy, xz, yy, yz, zz, in steps from the origin.

They wrap around at 64 bits, and so do the differences taken of them; what is left, about the middle
of a voxel or box, is small and exact.
"""

FEWEST = 5
"""Points whose shape can be told."""

SHAPE = 4
"""Numbers a box: thickness against the side of a voxel, flatness and linearity (logarithms to base
2), and |z| of the normal."""

_FARTHEST = 2.0**40


@compiled
def moments_of(points: Floats) -> Integers:
    """Return what each point adds to the moments, (n, MOMENTS)."""
    moments = np.empty((len(points), 9), np.int64)
    for i in range(len(points)):
        x = np.int64(min(max(np.rint(points[i, 0] / 0.001), -_FARTHEST), _FARTHEST))
        y = np.int64(min(max(np.rint(points[i, 1] / 0.001), -_FARTHEST), _FARTHEST))
        z = np.int64(min(max(np.rint(points[i, 2] / 0.001), -_FARTHEST), _FARTHEST))
        moments[i, 0], moments[i, 1], moments[i, 2] = x, y, z
        moments[i, 3], moments[i, 4], moments[i, 5] = x * x, x * y, x * z
        moments[i, 6], moments[i, 7], moments[i, 8] = y * y, y * z, z * z
    return moments


@compiled
def moved_moments(
    cells: Cells, sums: Integers, count: int, first: int, side: float, way: int
) -> Integers:
    """Return sums over voxels, their moments taken from the middles of these instead of the origin.

    They are small there, and take few bytes.

    Parameters
    ----------
    cells, sums, count, first, side
        As of `shapes_of`.
    way : int
        1, or -1 to go back to the origin.
    """
    moved = sums.copy()
    steps = np.int64(np.rint(side / 0.001))
    for v in range(len(cells)):
        moments = sums[v, first : first + 9]
        _move(moved[v, first : first + 9], moments, sums[v, count], cells[v], steps, way)
    return moved


@inlined
def _move(about: Integers, moments: Integers, n: int, cell: Cells, steps: int, way: int) -> None:
    """Take moments of n points from the middle of a voxel; its side is given in steps."""
    x = way * (np.int64(cell[0]) * steps + steps // 2)
    y = way * (np.int64(cell[1]) * steps + steps // 2)
    z = way * (np.int64(cell[2]) * steps + steps // 2)
    sx, sy, sz = moments[0], moments[1], moments[2]
    about[0], about[1], about[2] = sx - n * x, sy - n * y, sz - n * z
    about[3] = moments[3] - 2 * x * sx + n * x * x
    about[4] = moments[4] - x * sy - y * sx + n * x * y
    about[5] = moments[5] - x * sz - z * sx + n * x * z
    about[6] = moments[6] - 2 * y * sy + n * y * y
    about[7] = moments[7] - y * sz - z * sy + n * y * z
    about[8] = moments[8] - 2 * z * sz + n * z * z


@compiled
def shapes_of(
    cells: Cells, around: Integers, count: int, first: int, side: float
) -> npt.NDArray[np.float32]:
    """Return the shape of the box about each voxel, (V, SHAPE); NaN where there is too little.

    Parameters
    ----------
    cells : (V, 3) int32 array
    around : (V, C) int64 array
        Sums over the box: the number of points in column `count`, the moments from `first` on.
    side : float
        Of a voxel, metres.
    """
    shapes = np.full((len(cells), 4), np.nan, np.float32)
    steps = np.int64(np.rint(side / 0.001))
    about = np.empty(9, np.int64)
    for v in range(len(cells)):
        n = around[v, count]
        if n < FEWEST:
            continue
        _move(about, around[v, first : first + 9], n, cells[v], steps, 1)
        xx, xy, xz, yy, yz, zz = about[3], about[4], about[5], about[6], about[7], about[8]
        mx, my, mz = about[0] / n, about[1] / n, about[2] / n
        least, middle, most, normal = principal_axes(
            xx / n - mx * mx,
            xy / n - mx * my,
            xz / n - mx * mz,
            yy / n - my * my,
            yz / n - my * mz,
            zz / n - mz * mz,
        )
        # Half a step is what rounding the coordinates adds.
        thin = np.sqrt(least + 0.25)
        wide = np.sqrt(middle + 0.25)
        long = np.sqrt(most + 0.25)
        shapes[v, 0] = np.log2(thin / steps)
        shapes[v, 1] = np.log2(thin / wide)
        shapes[v, 2] = np.log2(wide / long)
        shapes[v, 3] = normal
    return shapes
