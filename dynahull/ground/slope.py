"""Ground by the slope of the surface under a point, from nearby points only.

The steps: columns of a lattice anchored at the origin; levels in each column, layers with free
height above; floors among them, flat and no ceiling; what stands out of its storey by more than
a slope allows is an object (Vosselman 2000; Zhang et al. 2003; Pingel et al. 2013); planes through
the levels that are left. A point near such a plane is ground, unless it is the foot of something.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from dynahull.compilation import compiled, compiling, inlined
from dynahull.ground.candidates import FLAT_RADIUS, are_flat, are_floors
from dynahull.ground.feet import are_feet
from dynahull.ground.lattice import (
    Booleans,
    Floats,
    Integers,
    build_lattice,
    sort_heights,
    starts_of,
)
from dynahull.ground.levels import find_levels
from dynahull.ground.opening import stand_out
from dynahull.ground.parameters import SlopeParameters
from dynahull.ground.surface import HEIGHT, NOISE, SLOPE_X, SLOPE_Y, fit_surface

__all__ = ["compile_once", "height_above", "height_reach", "slope_ground", "slope_radius"]

_STOREY_TO_CLEARANCE = 1.2
"""Floors lie at least the clearance and a slab apart: nearer levels share a storey."""


@lru_cache(maxsize=1)
def compile_once() -> None:
    """Compile the ground step, unless its code is kept already."""
    with compiling("the ground step", Path(__file__).parent):
        corner = np.random.default_rng(0).uniform(0, 3, (64, 3))
        height_above(corner, slope_ground(corner, SlopeParameters()), SlopeParameters())


def slope_ground(points: Floats, p: SlopeParameters) -> Booleans:
    """Tell which points are ground.

    Parameters
    ----------
    points : (N, 3) float64 array
        Finite coordinates, metres.
    p : SlopeParameters
        See there.

    Returns
    -------
    (N,) bool array
        The same for any order of the points, and for any part of a map that holds all within
        `slope_radius` of a point, that point's.
    """
    clearance = np.inf if p.clearance is None else p.clearance
    storey = _STOREY_TO_CLEARANCE * clearance
    reach = max(p.window, p.storey_radius, p.extension, FLAT_RADIUS * p.cell)
    lattice = build_lattice(points, p.cell, reach)
    starts = starts_of(lattice.slots, lattice.slot_count)
    columns = sort_heights(points[:, 2], lattice.slots, starts)

    levels = find_levels(columns, starts, p.level, clearance, p.clutter)
    levels = levels.keep(are_flat(levels, lattice, p))
    if p.clearance is not None:
        levels = levels.keep(are_floors(levels, columns, starts, lattice, p, p.clearance))
    levels = levels.keep(~stand_out(levels, lattice, p, storey))

    occupied = np.flatnonzero(np.diff(starts))
    surface = fit_surface(levels, lattice, occupied, p.extension, storey / 2, p.level)
    surface_heights, tolerances = _nearest_surface(
        points,
        lattice.slots,
        surface.planes,
        surface.starts,
        p.cell,
        np.array([p.tolerance, p.slope_tolerance, p.noise_tolerance, p.tolerance_limit]),
        p.steepest,
    )
    near = np.abs(points[:, 2] - surface_heights) <= tolerances
    if p.clearance is None:
        return near
    return near & ~are_feet(points, near, surface_heights, tolerances, p)


def slope_radius(p: SlopeParameters) -> float:
    """Metres within which all points lie that decide a point's label: the windows, end to end."""
    candidate = FLAT_RADIUS * p.cell
    if p.clearance is not None:
        candidate = max(candidate, p.storey_radius)
    return p.extension + 2 * p.window + candidate + np.sqrt(2.0) * p.cell


def height_reach(p: SlopeParameters) -> float:
    """Metres within which all ground points lie that decide a point's height above the ground."""
    return p.extension + np.sqrt(2.0) * p.cell


def height_above(points: Floats, ground: Booleans, p: SlopeParameters) -> Floats:
    """Return the height above the nearest floor beneath each point, metres, (N,).

    The floor is the plane through the ground points of the cells within `extension`, of the
    highest storey not above the point. Under the lowest floor the height is negative; NaN
    where there is no ground near.
    """
    clearance = np.inf if p.clearance is None else p.clearance
    lattice = build_lattice(points, p.cell, p.extension)
    slots = lattice.slots[ground]
    starts = starts_of(slots, lattice.slot_count)
    columns = sort_heights(points[ground, 2], slots, starts)
    thickness = 2 * p.tolerance_limit
    levels = find_levels(columns, starts, thickness, clearance / 2, 1.0)
    occupied = np.flatnonzero(np.bincount(lattice.slots, minlength=lattice.slot_count))
    surface = fit_surface(levels, lattice, occupied, p.extension, clearance / 2, thickness)
    return _height_above(
        points, lattice.slots, surface.planes, surface.starts, p.cell, p.tolerance_limit
    )


@inlined
def _height_over(point: Floats, plane: Floats, cell: float) -> float:
    dx = point[0] - (np.floor(point[0] / cell) + 0.5) * cell
    dy = point[1] - (np.floor(point[1] / cell) + 0.5) * cell
    return point[2] - plane[HEIGHT] - plane[SLOPE_X] * dx - plane[SLOPE_Y] * dy


@compiled
def _nearest_surface(
    points: Floats,
    slots: Integers,
    planes: Floats,
    starts: Integers,
    cell: float,
    tolerances: Floats,
    steepest: float,
) -> tuple[Floats, Floats]:
    """Return the height of the surface nearest to each point (NaN: none), and its tolerance."""
    base, per_slope, per_noise, limit = tolerances
    heights = np.full(len(points), np.nan)
    widths = np.zeros(len(points), np.float64)
    for point in range(len(points)):
        nearest = np.inf
        for k in range(starts[slots[point]], starts[slots[point] + 1]):
            slope = np.hypot(planes[k, SLOPE_X], planes[k, SLOPE_Y])
            height = _height_over(points[point], planes[k], cell)
            if slope <= steepest and abs(height) < nearest:
                nearest = abs(height)
                heights[point] = points[point, 2] - height
                widths[point] = min(base + per_slope * slope + per_noise * planes[k, NOISE], limit)
    return heights, widths


@compiled
def _height_above(
    points: Floats,
    slots: Integers,
    planes: Floats,
    starts: Integers,
    cell: float,
    tolerance: float,
) -> Floats:
    heights = np.full(len(points), np.nan)
    for point in range(len(points)):
        for k in range(starts[slots[point]], starts[slots[point] + 1]):
            height = _height_over(points[point], planes[k], cell)
            if np.isnan(heights[point]) or height >= -tolerance:
                heights[point] = height
    return heights
