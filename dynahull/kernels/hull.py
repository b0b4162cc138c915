"""The volume of the convex hull of a neighbourhood, by gift wrapping with a certificate.

From one facet the hull is wrapped (Chand and Kapur 1970): over every edge that has a facet on one
side only, the plane of that facet is turned until it meets a point, which gives the facet on the
other side. For k = 75 a turn is a single pass of vector arithmetic over all points, and a hull of
50 facets takes 50 turns, where inserting points one by one would make 128 facets for the 50 that
stay.

The turns are done in doubles and may be misled. So nothing is taken from them on trust: each
facet found must have all other points strictly below it, by the exact predicate. Such triangles
are facets of the hull beyond doubt, and once every edge has its two sides there are no others. A
wrapping that does not close, or is not certified, is repeated with the points shaken otherwise.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dynahull.kernels.bits import ordered_bits
from dynahull.kernels.frame import SHAKES, Neighbourhood, enter_frame, set_on_grid
from dynahull.kernels.predicates import SLIVER, accurate_minor, is_strictly_above_all

_FAR = 1e300  # takes a point out of a turn


class Surface(NamedTuple):
    """Facets found so far, and room to find them in.

    Attributes
    ----------
    corners : (3, capacity) uint64 array
        Points of each facet, anticlockwise seen from outside.
    normals : (3, capacity) float64 array
        Outward normal of each facet on the grid, as long as twice its area.
    open_edges : (3, capacity) uint64 array
        A stack: from which point to which, and the facet on its left.
    has_facet : (points, points) bool array
        Whether an edge, by its two points in order, has a facet on its left.
    penalty : (points,) float64 array
        Takes the points of the edge out of a turn.
    """

    corners: NDArray[np.uint64]
    normals: NDArray[np.float64]
    open_edges: NDArray[np.uint64]
    has_facet: NDArray[np.bool_]
    penalty: NDArray[np.float64]


@njit(nogil=True)
def make_surface(capacity: int) -> Surface:
    """Allocate the surface of a hull of at most so many points."""
    facets = 2 * capacity
    return Surface(
        np.empty((3, facets), np.uint64),
        np.empty((3, facets)),
        np.empty((3, 3 * facets), np.uint64),
        np.zeros((capacity, capacity), np.bool_),
        np.zeros(capacity),
    )


@njit(nogil=True)
def hull_volume(points: Neighbourhood, count: int, surface: Surface) -> float:
    """Measure the convex hull of a neighbourhood.

    Parameters
    ----------
    points : Neighbourhood
        `dx`, `dy` and `dz` given, nearest first; the rest is overwritten.
    count : int
        Number of points, at least four.
    surface : Surface
        Overwritten.

    Returns
    -------
    float
        Volume in cubic units of `dx`; zero where the points are flat; NaN where no wrapping could
        be certified.
    """
    unit = enter_frame(points, count)
    if unit == 0.0:
        return 0.0
    for attempt in range(SHAKES):
        set_on_grid(points, count, attempt)
        facets = _wrap(points, count, surface)
        if facets > 0 and _is_certified(points, count, surface, facets):
            return unit * _enclosed(points, surface, facets)
    return np.nan


@njit(nogil=True)
def _wrap(points: Neighbourhood, count: int, surface: Surface) -> int:
    """Find the facets of the hull; return their number, or -1 where the turns contradict."""
    surface.has_facet[:count, :count] = False
    _find_first_facet(points, count, surface)
    facets = 1
    depth = _open_edges(surface, np.uint64(0), 0)
    while depth > 0:
        depth -= 1
        slot = np.uint64(depth)
        i, j = surface.open_edges[0, slot], surface.open_edges[1, slot]
        facet = surface.open_edges[2, slot]
        if surface.has_facet[j, i]:
            continue
        apex = _turn(
            points,
            count,
            surface,
            i,
            j,
            points.x[j] - points.x[i],
            points.y[j] - points.y[i],
            points.z[j] - points.z[i],
            surface.normals[0, facet],
            surface.normals[1, facet],
            surface.normals[2, facet],
        )
        if facets == 2 * count - 4 or surface.has_facet[i, apex] or surface.has_facet[apex, j]:
            return -1
        _add_facet(points, surface, np.uint64(facets), j, i, apex)
        depth = _open_edges(surface, np.uint64(facets), depth)
        facets += 1
    return facets


@njit(nogil=True)
def _find_first_facet(points: Neighbourhood, count: int, surface: Surface) -> None:
    """Make facet 0, by turning a plane about the y axis, then about the edge that it meets."""
    a = np.uint64(0)
    for i in range(np.uint64(count)):
        if points.x[i] > points.x[a]:
            a = np.uint64(i)
    b = _turn(points, count, surface, a, a, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0)
    dx, dy, dz = points.x[b] - points.x[a], points.y[b] - points.y[a], points.z[b] - points.z[a]
    c = _turn(points, count, surface, a, b, dx, dy, dz, -dz, 0.0, dx)
    _add_facet(points, surface, np.uint64(0), b, a, c)


@njit(nogil=True)
def _turn(
    points: Neighbourhood,
    count: int,
    surface: Surface,
    i: np.uint64,
    j: np.uint64,
    edge_x: float,
    edge_y: float,
    edge_z: float,
    normal_x: float,
    normal_y: float,
    normal_z: float,
) -> np.uint64:
    """Turn a facet's plane over its edge from `i` to `j` until it meets a point, and return that.

    Of each point, `below` is its depth under the plane and `inward` its distance from the edge
    along it, to one scale; the point met has the largest angle, so the smallest cotangent.
    """
    x, y, z, penalty = points.x, points.y, points.z, surface.penalty
    inward_x = normal_y * edge_z - normal_z * edge_y
    inward_y = normal_z * edge_x - normal_x * edge_z
    inward_z = normal_x * edge_y - normal_y * edge_x
    height = normal_x * x[i] + normal_y * y[i] + normal_z * z[i]
    margin = inward_x * x[i] + inward_y * y[i] + inward_z * z[i]
    penalty[i] = penalty[j] = _FAR
    index_bits = np.int64(1)
    while index_bits < count:
        index_bits *= 2
    index_bits -= 1
    best = np.int64(0x7FFFFFFFFFFFFFFF)
    for q in range(np.uint64(count)):
        below = height - (normal_x * x[q] + normal_y * y[q] + normal_z * z[q])
        inward = (inward_x * x[q] + inward_y * y[q] + inward_z * z[q]) - margin + penalty[q]
        cotangent = inward / (below if below > 1.0 else 1.0)
        best = min(best, (ordered_bits(cotangent) & ~index_bits) | np.int64(q))
    penalty[i] = penalty[j] = 0.0
    return np.uint64(best & index_bits)


@njit(nogil=True)
def _add_facet(
    points: Neighbourhood,
    surface: Surface,
    facet: np.uint64,
    a: np.uint64,
    b: np.uint64,
    c: np.uint64,
) -> None:
    """Write a facet down, and that its edges have one."""
    x, y, z = points.x, points.y, points.z
    bx, by, bz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
    cx, cy, cz = x[c] - x[a], y[c] - y[a], z[c] - z[a]
    normal_x = by * cz - bz * cy
    normal_y = bz * cx - bx * cz
    normal_z = bx * cy - by * cx
    largest = max(abs(normal_x), abs(normal_y), abs(normal_z))
    if largest < SLIVER:
        normal_x = accurate_minor(by, bz, cy, cz)
        normal_y = accurate_minor(bz, bx, cz, cx)
        normal_z = accurate_minor(bx, by, cx, cy)
    surface.normals[0, facet] = normal_x
    surface.normals[1, facet] = normal_y
    surface.normals[2, facet] = normal_z
    surface.corners[0, facet], surface.corners[1, facet], surface.corners[2, facet] = a, b, c
    surface.has_facet[a, b] = True
    surface.has_facet[b, c] = True
    surface.has_facet[c, a] = True


@njit(nogil=True)
def _open_edges(surface: Surface, facet: np.uint64, depth: int) -> int:
    """Push the edges of a facet that have none on their other side; return the stack's depth."""
    corners = surface.corners
    for side in range(3):
        i, j = corners[side, facet], corners[(side + 1) % 3, facet]
        if not surface.has_facet[j, i]:
            slot = np.uint64(depth)
            surface.open_edges[0, slot] = i
            surface.open_edges[1, slot] = j
            surface.open_edges[2, slot] = facet
            depth += 1
    return depth


@njit(nogil=True)
def _is_certified(points: Neighbourhood, count: int, surface: Surface, facets: int) -> bool:
    for f in range(np.uint64(facets)):
        if not is_strictly_above_all(
            points,
            count,
            surface.corners[0, f],
            surface.corners[1, f],
            surface.corners[2, f],
            surface.normals[0, f],
            surface.normals[1, f],
            surface.normals[2, f],
        ):
            return False
    return True


@njit(nogil=True)
def _enclosed(points: Neighbourhood, surface: Surface, facets: int) -> float:
    """Sum the tetrahedra of all facets with the query, in the frame."""
    u, v, w = points.length, points.width, points.thickness
    total = 0.0
    for f in range(np.uint64(facets)):
        a, b, c = surface.corners[0, f], surface.corners[1, f], surface.corners[2, f]
        total += (
            u[a] * (v[b] * w[c] - w[b] * v[c])
            + v[a] * (w[b] * u[c] - u[b] * w[c])
            + w[a] * (u[b] * v[c] - v[b] * u[c])
        )
    return total / 6.0
