"""The volume of the convex hull of a neighbourhood, by gift wrapping with a certificate.

From one facet the hull is wrapped (Chand and Kapur 1970): over every edge that has a facet on one
side only, the plane of that facet is turned until it meets a point, which gives the facet on the
other side. For k = 75 a turn is a single pass of vector arithmetic over all points, and a hull of
50 facets takes 50 turns, where inserting points one by one would make 128 facets for the 50 that
stay.

The turns are done in floating point and may be misled. So nothing is taken from them on trust:
each facet found must have all other points strictly below it, by the exact predicate. Such
triangles are facets of the hull beyond doubt, and once every edge has its two sides there are no
others. So it does not matter to any bit of the result whether turns are made in single precision,
which is right but for points nearly coplanar, or in double. A wrapping that contradicts itself in
both is repeated with the points shaken otherwise.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.decorators import compiled, inlined
from dynahull.kernels.frame import SHAKES, Neighbourhood, enter_frame, place_of_largest, set_on_grid
from dynahull.kernels.lanes import aligned, padded
from dynahull.kernels.predicates import (
    ROUGHLY_UNCERTAIN,
    SLIVER,
    UNCERTAIN,
    accurate_minor,
    cross,
    dot,
    is_above_all_others,
    minus,
    place_of,
)
from dynahull.kernels.tree import Place
from dynahull.kernels.vectors import ROUGH_INDEX_BITS, depths_below, point_met, turns

_Corners = tuple[np.uint64, np.uint64, np.uint64]


class Surface(NamedTuple):
    """Facets found so far, and room to find them in.

    Attributes
    ----------
    corners : (facets, 3) uint64 array
        Points of each facet, anticlockwise seen from outside.
    normals : (facets, 3) float64 array
        Outward normal of each facet on the grid, as long as twice its area.
    has_facet : (points, points) bool array
        Whether an edge, by its two points in order, has a facet on its left.
    depth, rough_depth : (points,) float64 and float32 arrays
        Depth of each point below the present facet, times the length of the normal.
    """

    corners: NDArray[np.uint64]
    normals: NDArray[np.float64]
    has_facet: NDArray[np.bool_]
    depth: NDArray[np.float64]
    rough_depth: NDArray[np.float32]


def make_surface(most: int) -> Surface:
    """Make room for the hull of at most so many points."""
    return Surface(
        corners=np.empty((2 * most, 3), np.uint64),
        normals=np.empty((2 * most, 3)),
        has_facet=np.zeros((most, most), np.bool_),
        depth=aligned(padded(most)),
        rough_depth=aligned(padded(most), np.float32),
    )


@inlined
def _corners(surface: Surface, facet: np.uint64) -> _Corners:
    corners = surface.corners
    return corners[facet, 0], corners[facet, 1], corners[facet, 2]


@inlined
def _normal(surface: Surface, facet: np.uint64) -> Place:
    normals = surface.normals
    return normals[facet, 0], normals[facet, 1], normals[facet, 2]


@compiled
def hull_volume(
    points: Neighbourhood, count: int, surface: Surface, rough_first: bool
) -> tuple[float, bool]:
    """Measure the convex hull of a neighbourhood.

    Parameters
    ----------
    points : Neighbourhood
        `offset` given, no two the same, in an order that follows from the points: the
        last bits of the volume depend on it. The rest is overwritten.
    rough_first : bool
        Whether single precision is worth trying; it does not change the result.

    Returns
    -------
    volume : float
        In cubic units of `offset`; zero where the points are flat; NaN where no wrapping could be
        certified.
    rough : bool
        Whether single precision was enough.
    """
    if count < 4:
        return 0.0, rough_first
    unit = enter_frame(points, count)
    if unit == 0.0:
        return 0.0, rough_first
    can_be_rough = count <= 2**ROUGH_INDEX_BITS
    for attempt in range(SHAKES):
        set_on_grid(points, count, attempt)
        # Both before the next shake, and the facets in one order: the result is the same.
        for rough in (rough_first, not rough_first):
            if rough and not can_be_rough:
                continue
            # Literals: each precision is compiled apart.
            if rough:
                volume = _wrap(points, count, surface, True)
            else:
                volume = _wrap(points, count, surface, False)
            if volume >= 0.0:
                return unit * volume, rough
    return np.nan, False


@compiled
def _wrap(points: Neighbourhood, count: int, surface: Surface, rough: bool) -> float:
    """Find the facets of the hull; return the volume inside, or -1 where they contradict."""
    _find_first_facet(points, count, surface)
    facets, done = 1, 0
    sixfold = 0.0
    first = np.uint64(0)
    certain = _measure_depths(points, count, surface, rough, first)
    if certain:
        a, b, _ = _corners(surface, first)
        apex = _turn(points, count, surface, rough, first, a, b)
        _add_facet(points, surface, np.uint64(1), b, a, apex)
        facets = 2
    has_facet = surface.has_facet
    while done < facets and certain:
        facet = np.uint64(done)
        a, b, c = _corners(surface, facet)
        sixfold += _parallelepiped(points, a, b, c)
        certain, over_bc, over_ca = _turns(points, count, surface, rough, facet)
        for i, j, met in ((c, b, over_bc), (a, c, over_ca)):
            if not certain or has_facet[i, j]:
                continue
            certain = not (facets == 2 * count - 4 or has_facet[j, met] or has_facet[met, i])
            if certain:
                _add_facet(points, surface, np.uint64(facets), i, j, met)
                facets += 1
        done += 1
    for known in range(np.uint64(facets)):
        _mark_edges(surface, known, False)  # ready for the next neighbourhood
    return sixfold / 6.0 if certain else -1.0


@inlined
def _turns(
    points: Neighbourhood, count: int, surface: Surface, rough: bool, facet: np.uint64
) -> tuple[bool, np.uint64, np.uint64]:
    """Turn a facet's plane over its second and its third edge until it meets a point.

    Returns whether all points are below the facet for sure, and the points met.
    """
    a, b, c = _corners(surface, facet)
    at_c, normal = place_of(points, c), _normal(surface, facet)
    height = dot(normal, at_c)
    bc = cross(normal, minus(at_c, place_of(points, b)))
    ca = cross(normal, minus(place_of(points, a), at_c))
    bc_plane, ca_plane = bc + (dot(bc, at_c),), ca + (dot(ca, at_c),)
    if rough:
        plane = normal + (height, _roughly_uncertain(normal))
        below, over_bc, over_ca = turns(points.rough, count, plane, bc_plane, ca_plane)
    else:
        plane = normal + (height, UNCERTAIN)
        below, over_bc, over_ca = turns(points.grid, count, plane, bc_plane, ca_plane)
    if below == count - 3:
        return True, over_bc, over_ca
    if not _measure_depths(points, count, surface, rough, facet):
        return False, a, a
    over_bc = _turn(points, count, surface, rough, facet, b, c)
    over_ca = _turn(points, count, surface, rough, facet, c, a)
    return True, over_bc, over_ca


@inlined
def _roughly_uncertain(normal: Place) -> float:
    """Return the depth beyond which a point is surely below a plane, in single precision."""
    return ROUGHLY_UNCERTAIN * max(abs(normal[0]), abs(normal[1]), abs(normal[2]))


@compiled
def _find_first_facet(points: Neighbourhood, count: int, surface: Surface) -> None:
    """Turn a plane through the outermost point about the y axis, then about the edge it meets.

    Always in double precision: the order of the facets, so of the sum over them, follows from
    the first one.
    """
    a = place_of_largest(points.grid[0], np.uint64(count))
    _depths(points, count, surface, False, a, (1.0, 0.0, 0.0))
    b = _point_met(points, count, surface, False, a, a, (0.0, 0.0, 1.0))
    dx, dy, dz = minus(place_of(points, b), place_of(points, a))
    _depths(points, count, surface, False, a, (-dz, 0.0, dx))
    inward = (-dx * dy, dz * dz + dx * dx, -dz * dy)
    c = _point_met(points, count, surface, False, a, b, inward)
    _add_facet(points, surface, np.uint64(0), b, a, c)


@compiled
def _measure_depths(
    points: Neighbourhood, count: int, surface: Surface, rough: bool, facet: np.uint64
) -> bool:
    """Measure the depths of all points below a facet; tell whether they are below it for sure."""
    a, b, c = _corners(surface, facet)
    normal = _normal(surface, facet)
    near = _depths(points, count, surface, rough, a, normal)
    # The three themselves are always near.
    return near == 3 or is_above_all_others(points, count, a, b, c, normal)


@compiled
def _depths(
    points: Neighbourhood, count: int, surface: Surface, rough: bool, a: np.uint64, normal: Place
) -> int:
    """Measure the depths below a plane through a point; count those that are not surely below."""
    height = dot(normal, place_of(points, a))
    if rough:
        plane = normal + (height, _roughly_uncertain(normal))
        return depths_below(points.rough, count, plane, surface.rough_depth)
    plane = normal + (height, UNCERTAIN)
    return depths_below(points.grid, count, plane, surface.depth)


@compiled
def _turn(
    points: Neighbourhood,
    count: int,
    surface: Surface,
    rough: bool,
    facet: np.uint64,
    i: np.uint64,
    j: np.uint64,
) -> np.uint64:
    """Turn a facet's plane over its edge from `i` to `j` until it meets a point; return that."""
    edge = minus(place_of(points, j), place_of(points, i))
    return _point_met(points, count, surface, rough, i, j, cross(_normal(surface, facet), edge))


@compiled
def _point_met(
    points: Neighbourhood,
    count: int,
    surface: Surface,
    rough: bool,
    i: np.uint64,
    j: np.uint64,
    inward: Place,
) -> np.uint64:
    """Return the point met; `inward` is the direction in the plane away from the edge."""
    inward_plane = inward + (dot(inward, place_of(points, i)),)
    if rough:
        return point_met(points.rough, surface.rough_depth, count, i, j, inward_plane)
    return point_met(points.grid, surface.depth, count, i, j, inward_plane)


@inlined
def _add_facet(
    points: Neighbourhood,
    surface: Surface,
    facet: np.uint64,
    a: np.uint64,
    b: np.uint64,
    c: np.uint64,
) -> None:
    """Write a facet down, and that its edges have one."""
    origin = place_of(points, a)
    to_b, to_c = minus(place_of(points, b), origin), minus(place_of(points, c), origin)
    x, y, z = cross(to_b, to_c)
    if max(abs(x), abs(y), abs(z)) < SLIVER:
        x = accurate_minor(to_b[1], to_b[2], to_c[1], to_c[2])
        y = accurate_minor(to_b[2], to_b[0], to_c[2], to_c[0])
        z = accurate_minor(to_b[0], to_b[1], to_c[0], to_c[1])
    normals, corners = surface.normals, surface.corners
    normals[facet, 0], normals[facet, 1], normals[facet, 2] = x, y, z
    corners[facet, 0], corners[facet, 1], corners[facet, 2] = a, b, c
    _mark_edges(surface, facet, True)


@inlined
def _mark_edges(surface: Surface, facet: np.uint64, has_facet: bool) -> None:
    """Note whether the edges of a facet have one on their left."""
    a, b, c = _corners(surface, facet)
    surface.has_facet[a, b] = has_facet
    surface.has_facet[b, c] = has_facet
    surface.has_facet[c, a] = has_facet


@inlined
def _parallelepiped(points: Neighbourhood, a: np.uint64, b: np.uint64, c: np.uint64) -> float:
    """Return the volume, in the frame and not shaken, of a facet's tetrahedron with the query."""
    u, v, w = points.frame
    return dot((u[a], v[a], w[a]), cross((u[b], v[b], w[b]), (u[c], v[c], w[c])))
