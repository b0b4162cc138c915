"""A neighbourhood in its own frame, where even a sliver or a needle fills a cube.

Length points from the query to its farthest neighbour, width to the neighbour farthest from that
line, thickness across the plane of both. Divided by its three extents, the neighbourhood lies in
[-1, 1]^3 and is as thick as it is long, wherever it lies in the map and however it is turned. A
linear map takes hulls to hulls and scales volumes by its determinant, so nothing is lost.

There the coordinates are also set on a grid of integers, and shaken by a few steps of it, for the
*topology* of the hull only: integers make exact predicates cheap, and shaken points are in general
position, where a hull has triangles only and coplanar, collinear or duplicate points are no
special case. The volume is summed from the coordinates as they were: what shaking can change are
tetrahedra between points that are coplanar to one part in 2^34.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.decorators import inlined
from dynahull.kernels.lanes import aligned, padded
from dynahull.kernels.vectors import extremes, largest
from dynahull.reference import FLATNESS

STEP = 2.0**-50
"""The grid's step, in units of the frame."""

SHAKE = 2.0**-34
"""The largest shake."""

SHAKES = 8
"""Different ways to shake, tried in turn."""

_SHAKE_STRIDE = 29

_Axes = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]


class Neighbourhood(NamedTuple):
    """The points whose hull is wanted, and their place in the frame and on the grid.

    Attributes
    ----------
    offset : three (capacity,) float64 arrays
        x, y and z relative to the query.
    frame : three (capacity,) float64 arrays
        Along length, width and thickness of the frame, in [-1, 1].
    grid : three (capacity,) float64 arrays
        The same on the grid, shaken: multiples of `STEP`. After the last point the first holds NaN.
    rough : three (capacity,) float32 arrays
        Those on the grid, rounded.
    shake : (3, capacity + SHAKES * stride) float64 array
        Pseudo-random multiples of `STEP`, the same for ever.
    """

    offset: _Axes
    frame: _Axes
    grid: _Axes
    rough: tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
    shake: NDArray[np.float64]


def make_neighbourhood(most: int) -> Neighbourhood:
    """Make room for at most so many points."""
    size = padded(most)
    single = np.float32
    return Neighbourhood(
        offset=(aligned(size), aligned(size), aligned(size)),
        frame=(aligned(size), aligned(size), aligned(size)),
        grid=(aligned(size), aligned(size), aligned(size)),
        rough=(aligned(size, single), aligned(size, single), aligned(size, single)),
        shake=_shakes(size),
    )


@lru_cache(maxsize=4)
def _shakes(size: int) -> NDArray[np.float64]:
    """Return pseudo-random multiples of `STEP`; the first are the same for any size."""
    mask, state = 2**64 - 1, 0x9E3779B97F4A7C15
    shake = np.empty((size + SHAKES * _SHAKE_STRIDE, 3))
    for place in np.ndindex(shake.shape):
        state ^= state << 13 & mask
        state ^= state >> 7
        state ^= state << 17 & mask
        shake[place] = round((state / 2**63 - 1) * (SHAKE / STEP)) * STEP
    return np.ascontiguousarray(shake.T)


@inlined
def enter_frame(points: Neighbourhood, count: int) -> float:
    """Find the frame of a neighbourhood and its coordinates there.

    Parameters
    ----------
    points : Neighbourhood
        `offset` given; `frame` set.

    Returns
    -------
    float
        Volume of a unit cube of the frame; zero where the neighbourhood is flat: its width or its
        thickness is at most `FLATNESS` times its length.
    """
    size = np.uint64(count)
    dx, dy, dz = points.offset
    length, width, thickness = points.frame
    for i in range(size):
        length[i] = (dx[i] * dx[i] + dy[i] * dy[i]) + dz[i] * dz[i]
    last = place_of_largest(length, size)
    extent_1 = np.sqrt(dx[last] * dx[last] + dy[last] * dy[last] + dz[last] * dz[last])
    if extent_1 == 0.0:
        return 0.0
    ax, ay, az = dx[last] / extent_1, dy[last] / extent_1, dz[last] / extent_1
    for i in range(size):
        along = dx[i] * ax + dy[i] * ay + dz[i] * az
        length[i] = along
        rx, ry, rz = dx[i] - along * ax, dy[i] - along * ay, dz[i] - along * az
        width[i] = rx * rx + ry * ry + rz * rz
    side = place_of_largest(width, size)
    along = length[side]
    rx, ry, rz = dx[side] - along * ax, dy[side] - along * ay, dz[side] - along * az
    # What rounding left of the first axis would tilt the second.
    left = rx * ax + ry * ay + rz * az
    rx, ry, rz = rx - left * ax, ry - left * ay, rz - left * az
    extent_2 = np.sqrt(rx * rx + ry * ry + rz * rz)
    if extent_2 <= FLATNESS * extent_1:
        return 0.0
    bx, by, bz = rx / extent_2, ry / extent_2, rz / extent_2
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    for i in range(size):
        width[i] = dx[i] * bx + dy[i] * by + dz[i] * bz
        thickness[i] = dx[i] * cx + dy[i] * cy + dz[i] * cz
    lowest, highest = extremes(thickness, np.uint64(0), size)
    extent_3 = max(highest, -lowest)
    if extent_3 <= FLATNESS * extent_1:
        return 0.0
    for i in range(size):
        length[i] /= extent_1
        width[i] /= extent_2
        thickness[i] /= extent_3
    return extent_1 * extent_2 * extent_3


@inlined
def place_of_largest(values: NDArray[np.float64], size: np.uint64) -> np.uint64:
    """Return the index of the largest value, the first of equals."""
    most = largest(values, size)
    i = np.uint64(0)
    while values[i] != most:
        i += np.uint64(1)
    return i


@inlined
def set_on_grid(points: Neighbourhood, count: int, attempt: int) -> None:
    """Round the frame coordinates to the grid, and shake them."""
    shift = np.uint64(attempt * _SHAKE_STRIDE)
    length, width, thickness = points.frame
    x, y, z = points.grid
    rough_x, rough_y, rough_z = points.rough
    for i in range(np.uint64(count)):
        x[i] = np.rint(length[i] / STEP) * STEP + points.shake[0, shift + i]
        y[i] = np.rint(width[i] / STEP) * STEP + points.shake[1, shift + i]
        z[i] = np.rint(thickness[i] / STEP) * STEP + points.shake[2, shift + i]
    for i in range(np.uint64(count)):
        rough_x[i], rough_y[i], rough_z[i] = np.float32(x[i]), np.float32(y[i]), np.float32(z[i])
    for i in range(np.uint64(count), np.uint64(x.size)):
        x[i] = np.nan
        rough_x[i] = np.nan
