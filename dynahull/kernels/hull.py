"""The volume of the convex hull of a neighbourhood, by gift wrapping with a certificate.

From one facet the hull is wrapped (Chand and Kapur 1970): over every edge that has a facet on one
side only, the plane of that facet is turned until it meets a point, which gives the facet on the
other side. For k = 75 a turn is a single pass of vector arithmetic over all points, and a hull of
50 facets takes 50 turns, where inserting points one by one would make 128 facets for the 50 that
stay.

The turns are done in floating point and may be misled. So nothing is taken from them on trust:
each facet found must have all other points strictly below it, by the exact predicate. Such
triangles are facets of the hull beyond doubt, and once every edge has its two sides there are no
others. So it does not matter to any bit of the result that turns are first tried in single
precision, which is right but for points nearly coplanar, and only then in double. A wrapping that
still does not close, or is not certified, is repeated with the points shaken otherwise.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.compiled import compiled
from dynahull.kernels.frame import SHAKES, Neighbourhood, enter_frame, place_of_largest, set_on_grid
from dynahull.kernels.predicates import SLIVER, accurate_minor, is_strictly_above_all
from dynahull.kernels.vectors import ROUGH_INDEX_BITS, point_met


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
    """

    corners: NDArray[np.uint64]
    normals: NDArray[np.float64]
    open_edges: NDArray[np.uint64]
    has_facet: NDArray[np.bool_]


def make_surface(most: int) -> Surface:
    """Make room for the hull of at most so many points."""
    facets = 2 * most
    return Surface(
        np.empty((3, facets), np.uint64),
        np.empty((3, facets)),
        np.empty((3, 3 * facets), np.uint64),
        np.zeros((most, most), np.bool_),
    )


@compiled
def hull_volume(
    points: Neighbourhood, count: int, surface: Surface, rough_first: bool
) -> tuple[float, bool]:
    """Measure the convex hull of a neighbourhood.

    Parameters
    ----------
    points : Neighbourhood
        `dx`, `dy` and `dz` given, nearest first, no two the same; the rest is overwritten.
    count : int
        Number of points.
    surface : Surface
        Overwritten.
    rough_first : bool
        Whether single precision is worth trying; it does not change the result.

    Returns
    -------
    volume : float
        In cubic units of `dx`; zero where the points are flat; NaN where no wrapping could be
        certified.
    rough : bool
        Whether single precision was enough.
    """
    if count < 4:
        return 0.0, rough_first
    unit = enter_frame(points, count)
    if unit == 0.0:
        return 0.0, rough_first
    set_on_grid(points, count, 0)
    if rough_first and count <= 2**ROUGH_INDEX_BITS:
        facets = _wrap(points, count, surface, True)
        if facets > 0 and _is_certified(points, count, surface, facets):
            return unit * _enclosed(points, surface, facets), True
    for attempt in range(SHAKES):
        if attempt > 0:
            set_on_grid(points, count, attempt)
        facets = _wrap(points, count, surface, False)
        if facets > 0 and _is_certified(points, count, surface, facets):
            return unit * _enclosed(points, surface, facets), False
    return np.nan, False


@compiled
def _wrap(points: Neighbourhood, count: int, surface: Surface, rough: bool) -> int:
    """Find the facets of the hull; return their number, or -1 where the turns contradict."""
    x, y, z = points.x, points.y, points.z
    # A plane through the outermost point, turned about the y axis, then about the edge it meets.
    a = place_of_largest(points.x, np.uint64(count))
    b = _turn(points, count, surface, rough, a, a, 0.0, 1.0, 0.0, 1.0, 0.0, 0.0)
    dx, dy, dz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
    c = _turn(points, count, surface, rough, a, b, dx, dy, dz, -dz, 0.0, dx)
    _add_facet(points, surface, np.uint64(0), b, a, c)
    depth = _open_edges(surface, np.uint64(0), 0)
    facets = 1
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
            rough,
            i,
            j,
            x[j] - x[i],
            y[j] - y[i],
            z[j] - z[i],
            surface.normals[0, facet],
            surface.normals[1, facet],
            surface.normals[2, facet],
        )
        if facets == 2 * count - 4 or surface.has_facet[i, apex] or surface.has_facet[apex, j]:
            _forget_edges(surface, facets)
            return -1
        _add_facet(points, surface, np.uint64(facets), j, i, apex)
        depth = _open_edges(surface, np.uint64(facets), depth)
        facets += 1
    _forget_edges(surface, facets)
    return facets


@compiled
def _turn(
    points: Neighbourhood,
    count: int,
    surface: Surface,
    rough: bool,
    i: np.uint64,
    j: np.uint64,
    edge_x: float,
    edge_y: float,
    edge_z: float,
    normal_x: float,
    normal_y: float,
    normal_z: float,
) -> np.uint64:
    """Turn a facet's plane over its edge from `i` to `j` until it meets a point; return that."""
    inward_x = normal_y * edge_z - normal_z * edge_y
    inward_y = normal_z * edge_x - normal_x * edge_z
    inward_z = normal_x * edge_y - normal_y * edge_x
    height = normal_x * points.x[i] + normal_y * points.y[i] + normal_z * points.z[i]
    margin = inward_x * points.x[i] + inward_y * points.y[i] + inward_z * points.z[i]
    if rough:
        rough_plane = (
            np.float32(inward_x),
            np.float32(inward_y),
            np.float32(inward_z),
            np.float32(margin),
            np.float32(normal_x),
            np.float32(normal_y),
            np.float32(normal_z),
            np.float32(height),
        )
        return point_met(points.rough_x, points.rough_y, points.rough_z, count, i, j, rough_plane)
    plane = (inward_x, inward_y, inward_z, margin, normal_x, normal_y, normal_z, height)
    return point_met(points.x, points.y, points.z, count, i, j, plane)


@compiled
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


@compiled
def _forget_edges(surface: Surface, facets: int) -> None:
    """Make `has_facet` ready for the next neighbourhood."""
    for f in range(np.uint64(facets)):
        a, b, c = surface.corners[0, f], surface.corners[1, f], surface.corners[2, f]
        surface.has_facet[a, b] = False
        surface.has_facet[b, c] = False
        surface.has_facet[c, a] = False


@compiled
def _open_edges(surface: Surface, facet: np.uint64, depth: int) -> int:
    """Push the edges of a facet that have none on their other side; return the stack's depth."""
    corners = surface.corners
    a, b, c = corners[0, facet], corners[1, facet], corners[2, facet]
    for i, j in ((a, b), (b, c), (c, a)):
        if not surface.has_facet[j, i]:
            slot = np.uint64(depth)
            surface.open_edges[0, slot] = i
            surface.open_edges[1, slot] = j
            surface.open_edges[2, slot] = facet
            depth += 1
    return depth


@compiled
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


@compiled
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
