"""A neighbourhood in its own frame, where even a sliver or a needle fills a cube.

Length points from the query to its farthest neighbour, width to the neighbour farthest from that
line, thickness across the plane of both. Divided by its three extents, the neighbourhood lies in
[-1, 1]^3 and is as thick as it is long, wherever it lies in the map and however it is turned. A
linear map takes hulls to hulls and scales volumes by its determinant, so nothing is lost.

There the coordinates are also set on a grid of integers, and shaken by a few steps of it, for the
*topology* of the hull only: integers make exact predicates cheap, and shaken points are in general
position, where a hull has triangles only and coplanar, collinear or duplicate points are no
special case. The volume is summed from the coordinates as they were: what shaking can change are
tetrahedra between points that are coplanar to one part in 2^32.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dynahull.hull import FLATNESS

GRID = 2.0**50
"""Grid steps in a unit of the frame."""

SHAKE = 2.0**18
"""Largest shake, in grid steps."""

SHAKES = 8
"""Different ways to shake, tried in turn."""

_SHAKE_STRIDE = 29


class Neighbourhood(NamedTuple):
    """The points whose hull is wanted, and their place in the frame and on the grid.

    Attributes
    ----------
    dx, dy, dz : (capacity,) float64 arrays
        Coordinates relative to the query, nearest first.
    length, width, thickness : (capacity,) float64 arrays
        Coordinates in the frame, in [-1, 1].
    x, y, z : (capacity,) float64 arrays
        Integers: the coordinates on the grid, shaken.
    shake : (3, capacity + SHAKES * stride) float64 array
        Pseudo-random steps of the grid, the same for ever.
    """

    dx: NDArray[np.float64]
    dy: NDArray[np.float64]
    dz: NDArray[np.float64]
    length: NDArray[np.float64]
    width: NDArray[np.float64]
    thickness: NDArray[np.float64]
    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    shake: NDArray[np.float64]


@njit(nogil=True)
def make_neighbourhood(capacity: int) -> Neighbourhood:
    """Allocate a neighbourhood of at most so many points."""
    shake = np.empty((3, capacity + SHAKES * _SHAKE_STRIDE))
    random = np.uint64(0x9E3779B97F4A7C15)
    for i in range(shake.shape[1]):
        for axis in range(3):
            random ^= random << np.uint64(13)
            random ^= random >> np.uint64(7)
            random ^= random << np.uint64(17)
            share = np.float64(random >> np.uint64(11)) * 2.0**-52 - 1.0
            shake[axis, i] = np.rint(share * SHAKE)
    return Neighbourhood(
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity),
        np.empty(capacity),
        shake,
    )


@njit(nogil=True)
def enter_frame(points: Neighbourhood, count: int) -> float:
    """Find the frame of a neighbourhood and its coordinates there.

    Parameters
    ----------
    points : Neighbourhood
        `dx`, `dy` and `dz` given, the farthest point last; `length`, `width` and `thickness` set.
    count : int
        Number of points.

    Returns
    -------
    float
        Volume of a unit cube of the frame; zero where the neighbourhood is flat: its width or its
        thickness is at most `FLATNESS` times its length.
    """
    size = np.uint64(count)
    dx, dy, dz = points.dx, points.dy, points.dz
    last = size - np.uint64(1)
    extent_1 = np.sqrt(dx[last] * dx[last] + dy[last] * dy[last] + dz[last] * dz[last])
    if extent_1 == 0.0:
        return 0.0
    ax, ay, az = dx[last] / extent_1, dy[last] / extent_1, dz[last] / extent_1
    for i in range(size):
        along = dx[i] * ax + dy[i] * ay + dz[i] * az
        points.length[i] = along
        rx, ry, rz = dx[i] - along * ax, dy[i] - along * ay, dz[i] - along * az
        points.width[i] = rx * rx + ry * ry + rz * rz
    side = _largest(points.width, size)
    rx = dx[side] - points.length[side] * ax
    ry = dy[side] - points.length[side] * ay
    rz = dz[side] - points.length[side] * az
    # What rounding left of the first axis would tilt the second.
    left = rx * ax + ry * ay + rz * az
    rx, ry, rz = rx - left * ax, ry - left * ay, rz - left * az
    extent_2 = np.sqrt(rx * rx + ry * ry + rz * rz)
    if extent_2 <= FLATNESS * extent_1:
        return 0.0
    bx, by, bz = rx / extent_2, ry / extent_2, rz / extent_2
    cx, cy, cz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    for i in range(size):
        points.width[i] = dx[i] * bx + dy[i] * by + dz[i] * bz
        points.thickness[i] = dx[i] * cx + dy[i] * cy + dz[i] * cz
    extent_3 = _largest_magnitude(points.thickness, size)
    if extent_3 <= FLATNESS * extent_1:
        return 0.0
    for i in range(size):
        points.length[i] /= extent_1
        points.width[i] /= extent_2
        points.thickness[i] /= extent_3
    return extent_1 * extent_2 * extent_3


@njit(nogil=True)
def _largest(values: NDArray[np.float64], size: np.uint64) -> np.uint64:
    """Return the index of the largest value, the first of equals."""
    best = np.uint64(0)
    for i in range(size):
        if values[i] > values[best]:
            best = np.uint64(i)
    return best


@njit(nogil=True)
def _largest_magnitude(values: NDArray[np.float64], size: np.uint64) -> float:
    # Non-negative doubles have the order of their bits, and integers reduce in vectors.
    bits = values.view(np.int64)
    largest = np.int64(0)
    for i in range(size):
        largest = max(largest, bits[i] & np.int64(0x7FFFFFFFFFFFFFFF))
    one = np.empty(1, np.int64)
    one[0] = largest
    return one.view(np.float64)[0]


@njit(nogil=True)
def set_on_grid(points: Neighbourhood, count: int, attempt: int) -> None:
    """Round the frame coordinates to the grid, and shake them."""
    shift = np.uint64(attempt * _SHAKE_STRIDE)
    for i in range(np.uint64(count)):
        points.x[i] = np.rint(points.length[i] * GRID) + points.shake[0, shift + i]
        points.y[i] = np.rint(points.width[i] * GRID) + points.shake[1, shift + i]
        points.z[i] = np.rint(points.thickness[i] * GRID) + points.shake[2, shift + i]
