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

from dynahull.kernels.compiled import compiled, inlined
from dynahull.kernels.frame import (
    SHAKES,
    Neighbourhood,
    enter_frame,
    place_of_largest,
    set_on_grid,
)
from dynahull.kernels.lanes import aligned, padded
from dynahull.kernels.predicates import (
    ROUGHLY_UNCERTAIN,
    SLIVER,
    UNCERTAIN,
    accurate_minor,
    is_above_all_others,
)
from dynahull.kernels.vectors import ROUGH_INDEX_BITS, depths_below, point_met, turns


class Surface(NamedTuple):
    """Facets found so far, and room to find them in.

    Attributes
    ----------
    a, b, c : (facets,) uint64 arrays
        Points of each facet, anticlockwise seen from outside.
    normal_x, normal_y, normal_z : (facets,) float64 arrays
        Outward normal of each facet on the grid, as long as twice its area.
    has_facet : (points, points) bool array
        Whether an edge, by its two points in order, has a facet on its left.
    depth, rough_depth : (points,) float64 and float32 arrays
        Depth of each point below the present facet, times the length of the normal.
    """

    a: NDArray[np.uint64]
    b: NDArray[np.uint64]
    c: NDArray[np.uint64]
    normal_x: NDArray[np.float64]
    normal_y: NDArray[np.float64]
    normal_z: NDArray[np.float64]
    has_facet: NDArray[np.bool_]
    depth: NDArray[np.float64]
    rough_depth: NDArray[np.float32]


def make_surface(most: int) -> Surface:
    """Make room for the hull of at most so many points."""
    facets = 2 * most
    return Surface(
        a=np.empty(facets, np.uint64),
        b=np.empty(facets, np.uint64),
        c=np.empty(facets, np.uint64),
        normal_x=np.empty(facets),
        normal_y=np.empty(facets),
        normal_z=np.empty(facets),
        has_facet=np.zeros((most, most), np.bool_),
        depth=aligned(padded(most)),
        rough_depth=aligned(padded(most), np.float32),
    )


@compiled
def hull_volume(
    points: Neighbourhood, count: int, surface: Surface, rough_first: bool
) -> tuple[float, bool]:
    """Measure the convex hull of a neighbourhood.

    Parameters
    ----------
    points : Neighbourhood
        `dx`, `dy` and `dz` given, no two the same, in an order that follows from the points: the
        last bits of the volume depend on it. The rest is overwritten.
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
        a, b = surface.a[first], surface.b[first]
        apex = _turn(points, count, surface, rough, first, a, b)
        _add_facet(points, surface, np.uint64(1), b, a, apex)
        facets = 2
    while done < facets and certain:
        facet = np.uint64(done)
        a, b, c = surface.a[facet], surface.b[facet], surface.c[facet]
        sixfold += _parallelepiped(points, a, b, c)
        certain, over_bc, over_ca = _turns(points, count, surface, rough, facet)
        if certain and not surface.has_facet[c, b]:
            if (
                facets == 2 * count - 4
                or surface.has_facet[b, over_bc]
                or surface.has_facet[over_bc, c]
            ):
                certain = False
                break
            _add_facet(points, surface, np.uint64(facets), c, b, over_bc)
            facets += 1
        if certain and not surface.has_facet[a, c]:
            if (
                facets == 2 * count - 4
                or surface.has_facet[c, over_ca]
                or surface.has_facet[over_ca, a]
            ):
                certain = False
                break
            _add_facet(points, surface, np.uint64(facets), a, c, over_ca)
            facets += 1
        done += 1
    _forget_edges(surface, facets)
    return sixfold / 6.0 if certain else -1.0


@inlined
def _turns(
    points: Neighbourhood, count: int, surface: Surface, rough: bool, facet: np.uint64
) -> tuple[bool, np.uint64, np.uint64]:
    """Turn a facet's plane over its second and its third edge until it meets a point.

    Returns
    -------
    certain : bool
        Whether all points are below the facet for sure.
    over_bc, over_ca : uint64
        The points met.
    """
    a, b, c = surface.a[facet], surface.b[facet], surface.c[facet]
    x, y, z = points.x, points.y, points.z
    normal_x, normal_y, normal_z = (
        surface.normal_x[facet],
        surface.normal_y[facet],
        surface.normal_z[facet],
    )
    height = normal_x * x[c] + normal_y * y[c] + normal_z * z[c]
    edge_x, edge_y, edge_z = x[c] - x[b], y[c] - y[b], z[c] - z[b]
    bc_x = normal_y * edge_z - normal_z * edge_y
    bc_y = normal_z * edge_x - normal_x * edge_z
    bc_z = normal_x * edge_y - normal_y * edge_x
    bc_margin = bc_x * x[c] + bc_y * y[c] + bc_z * z[c]
    edge_x, edge_y, edge_z = x[a] - x[c], y[a] - y[c], z[a] - z[c]
    ca_x = normal_y * edge_z - normal_z * edge_y
    ca_y = normal_z * edge_x - normal_x * edge_z
    ca_z = normal_x * edge_y - normal_y * edge_x
    ca_margin = ca_x * x[c] + ca_y * y[c] + ca_z * z[c]
    if rough:
        largest = max(abs(normal_x), abs(normal_y), abs(normal_z))
        below, over_bc, over_ca = turns(
            points.rough_x,
            points.rough_y,
            points.rough_z,
            count,
            (
                np.float32(normal_x),
                np.float32(normal_y),
                np.float32(normal_z),
                np.float32(height),
                np.float32(ROUGHLY_UNCERTAIN * largest),
            ),
            (np.float32(bc_x), np.float32(bc_y), np.float32(bc_z), np.float32(bc_margin)),
            (np.float32(ca_x), np.float32(ca_y), np.float32(ca_z), np.float32(ca_margin)),
        )
    else:
        below, over_bc, over_ca = turns(
            points.x,
            points.y,
            points.z,
            count,
            (normal_x, normal_y, normal_z, height, UNCERTAIN),
            (bc_x, bc_y, bc_z, bc_margin),
            (ca_x, ca_y, ca_z, ca_margin),
        )
    if below == count - 3:
        return True, over_bc, over_ca
    if not _measure_depths(points, count, surface, rough, facet):
        return False, a, a
    over_bc = _turn(points, count, surface, rough, facet, b, c)
    over_ca = _turn(points, count, surface, rough, facet, c, a)
    return True, over_bc, over_ca


@compiled
def _find_first_facet(points: Neighbourhood, count: int, surface: Surface) -> None:
    """Turn a plane through the outermost point about the y axis, then about the edge it meets.

    Always in double precision: the order of the facets, so of the sum over them, follows from
    the first one.
    """
    x, y, z = points.x, points.y, points.z
    a = place_of_largest(x, np.uint64(count))
    _depths(points, count, surface, False, a, 1.0, 0.0, 0.0)
    b = _point_met(points, count, surface, False, a, a, 0.0, 0.0, 1.0)
    dx, dy, dz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
    _depths(points, count, surface, False, a, -dz, 0.0, dx)
    c = _point_met(points, count, surface, False, a, b, -dx * dy, dz * dz + dx * dx, -dz * dy)
    _add_facet(points, surface, np.uint64(0), b, a, c)


@compiled
def _measure_depths(
    points: Neighbourhood, count: int, surface: Surface, rough: bool, facet: np.uint64
) -> bool:
    """Measure the depths of all points below a facet; tell whether they are below it for sure."""
    a, b, c = surface.a[facet], surface.b[facet], surface.c[facet]
    normal_x, normal_y, normal_z = (
        surface.normal_x[facet],
        surface.normal_y[facet],
        surface.normal_z[facet],
    )
    near = _depths(points, count, surface, rough, a, normal_x, normal_y, normal_z)
    # The three themselves are always near.
    return near == 3 or is_above_all_others(points, count, a, b, c, normal_x, normal_y, normal_z)


@compiled
def _depths(
    points: Neighbourhood,
    count: int,
    surface: Surface,
    rough: bool,
    a: np.uint64,
    normal_x: float,
    normal_y: float,
    normal_z: float,
) -> int:
    """Measure the depths below a plane through a point; count those that are not surely below."""
    height = normal_x * points.x[a] + normal_y * points.y[a] + normal_z * points.z[a]
    if rough:
        largest = max(abs(normal_x), abs(normal_y), abs(normal_z))
        rough_plane = (
            np.float32(normal_x),
            np.float32(normal_y),
            np.float32(normal_z),
            np.float32(height),
            np.float32(ROUGHLY_UNCERTAIN * largest),
        )
        x, y, z = points.rough_x, points.rough_y, points.rough_z
        return depths_below(x, y, z, count, rough_plane, surface.rough_depth)
    plane = (normal_x, normal_y, normal_z, height, UNCERTAIN)
    return depths_below(points.x, points.y, points.z, count, plane, surface.depth)


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
    normal_x, normal_y, normal_z = (
        surface.normal_x[facet],
        surface.normal_y[facet],
        surface.normal_z[facet],
    )
    edge_x = points.x[j] - points.x[i]
    edge_y = points.y[j] - points.y[i]
    edge_z = points.z[j] - points.z[i]
    inward_x = normal_y * edge_z - normal_z * edge_y
    inward_y = normal_z * edge_x - normal_x * edge_z
    inward_z = normal_x * edge_y - normal_y * edge_x
    return _point_met(points, count, surface, rough, i, j, inward_x, inward_y, inward_z)


@compiled
def _point_met(
    points: Neighbourhood,
    count: int,
    surface: Surface,
    rough: bool,
    i: np.uint64,
    j: np.uint64,
    inward_x: float,
    inward_y: float,
    inward_z: float,
) -> np.uint64:
    """Return the point met; `inward` is the direction in the plane away from the edge."""
    margin = inward_x * points.x[i] + inward_y * points.y[i] + inward_z * points.z[i]
    if rough:
        rough_inward = (
            np.float32(inward_x),
            np.float32(inward_y),
            np.float32(inward_z),
            np.float32(margin),
        )
        x, y, z = points.rough_x, points.rough_y, points.rough_z
        return point_met(x, y, z, surface.rough_depth, count, i, j, rough_inward)
    inward = (inward_x, inward_y, inward_z, margin)
    return point_met(points.x, points.y, points.z, surface.depth, count, i, j, inward)


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
    x, y, z = points.x, points.y, points.z
    bx, by, bz = x[b] - x[a], y[b] - y[a], z[b] - z[a]
    cx, cy, cz = x[c] - x[a], y[c] - y[a], z[c] - z[a]
    normal_x = by * cz - bz * cy
    normal_y = bz * cx - bx * cz
    normal_z = bx * cy - by * cx
    if max(abs(normal_x), abs(normal_y), abs(normal_z)) < SLIVER:
        normal_x = accurate_minor(by, bz, cy, cz)
        normal_y = accurate_minor(bz, bx, cz, cx)
        normal_z = accurate_minor(bx, by, cx, cy)
    surface.normal_x[facet], surface.normal_y[facet] = normal_x, normal_y
    surface.normal_z[facet] = normal_z
    surface.a[facet], surface.b[facet], surface.c[facet] = a, b, c
    surface.has_facet[a, b] = True
    surface.has_facet[b, c] = True
    surface.has_facet[c, a] = True


@compiled
def _forget_edges(surface: Surface, facets: int) -> None:
    """Make `has_facet` ready for the next neighbourhood."""
    for f in range(np.uint64(facets)):
        a, b, c = surface.a[f], surface.b[f], surface.c[f]
        surface.has_facet[a, b] = False
        surface.has_facet[b, c] = False
        surface.has_facet[c, a] = False


@inlined
def _parallelepiped(points: Neighbourhood, a: np.uint64, b: np.uint64, c: np.uint64) -> float:
    """Return the volume, in the frame and not shaken, of a facet's tetrahedron with the query."""
    u, v, w = points.length, points.width, points.thickness
    return (
        u[a] * (v[b] * w[c] - w[b] * v[c])
        + v[a] * (w[b] * u[c] - u[b] * w[c])
        + w[a] * (u[b] * v[c] - v[b] * u[c])
    )
