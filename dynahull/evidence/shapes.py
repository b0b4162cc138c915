"""The shape of what lies in a box of voxels: thin as a wall, or filled as the trail of a walker."""

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled
from dynahull.evidence.lattice import Cells, Floats, Integers
from dynahull.kernels.spread import principal_axes

STEP = 0.001
"""Metres: coordinates are summed in whole steps."""

MOMENTS = 9
"""Columns: the sums of x, y, z, xx, xy, xz, yy, yz, zz, in steps from the origin.

They wrap around at 64 bits, and so do the differences taken of them; what is left, about the middle
of a box, is small and exact.
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
    for v in range(len(cells)):
        n = around[v, count]
        if n < FEWEST:
            continue
        x = np.int64(cells[v, 0]) * steps + steps // 2
        y = np.int64(cells[v, 1]) * steps + steps // 2
        z = np.int64(cells[v, 2]) * steps + steps // 2
        sx, sy, sz = around[v, first], around[v, first + 1], around[v, first + 2]
        xx = around[v, first + 3] - 2 * x * sx + n * x * x
        xy = around[v, first + 4] - x * sy - y * sx + n * x * y
        xz = around[v, first + 5] - x * sz - z * sx + n * x * z
        yy = around[v, first + 6] - 2 * y * sy + n * y * y
        yz = around[v, first + 7] - y * sz - z * sy + n * y * z
        zz = around[v, first + 8] - 2 * z * sz + n * z * z
        mx, my, mz = (sx - n * x) / n, (sy - n * y) / n, (sz - n * z) / n
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
