"""Ground by the slope of the surface under a point, from nearby points only.

The steps: columns of a lattice anchored at the origin; levels in each column, layers with free
height above; floors among them, flat and no ceiling; what stands out of its storey by more than
a slope allows is an object (Vosselman 2000; Zhang et al. 2003; Pingel et al. 2013); planes through
the levels that are left. A point near such a plane is ground, unless it is the foot of something.
"""

from functools import lru_cache
from pathlib import Path

import numpy as np

from dynahull.compilation import compiled, compiling
from dynahull.ground.candidates import are_flat, are_floors
from dynahull.ground.columns import sort_columns
from dynahull.ground.decision import decide
from dynahull.ground.lattice import Booleans, Floats, Integers, build_lattice
from dynahull.ground.levels import find_levels
from dynahull.ground.opening import stand_out
from dynahull.ground.parameters import SlopeParameters
from dynahull.ground.reach import FLAT_RADIUS
from dynahull.ground.surface import fit_surface, height_over
from dynahull.threads import over_ranges, range_bounds

__all__ = ["compile_once", "height_above", "slope_ground"]

_STOREY_TO_CLEARANCE = 1.2
"""Floors lie at least the clearance and a slab apart: nearer levels share a storey."""

_SMALLEST_RANGE = 20_000
"""Points."""


@lru_cache(maxsize=1)
def compile_once() -> None:
    """Compile the ground step, unless its code is kept already."""
    with compiling("the ground step", Path(__file__).parent):
        corner = np.random.default_rng(0).uniform(0, 3, (64, 3))
        height_above(corner, slope_ground(corner, SlopeParameters()), SlopeParameters())


def slope_ground(points: Floats, p: SlopeParameters, threads: int = 1) -> Booleans:
    """Tell which points are ground.

    Parameters
    ----------
    points : (N, 3) float64 array
        Finite coordinates, metres.
    p : SlopeParameters
        See there.
    threads : int
        They change nothing about the result.

    Returns
    -------
    (N,) bool array
        The same for any order of the points, and for any part of a map that holds all within
        `ground_radius` of a point, that point's.
    """
    clearance = np.inf if p.clearance is None else p.clearance
    storey = _STOREY_TO_CLEARANCE * clearance
    reach = max(p.window, p.expert.storey_radius, p.expert.extension, FLAT_RADIUS * p.expert.cell)
    lattice = build_lattice(points, p.expert.cell, reach, threads)
    columns = sort_columns(points, lattice, threads)

    levels = find_levels(columns, p.expert.level, clearance, p.expert.clutter, threads)
    levels = levels.keep(are_flat(levels, lattice, p, threads))
    if p.clearance is not None:
        levels = levels.keep(are_floors(levels, columns, lattice, p, p.clearance, threads))
    levels = levels.keep(~stand_out(levels, lattice, p, storey, threads))

    occupied = np.diff(columns.starts) > 0
    surface = fit_surface(
        levels, lattice, occupied, p.expert.extension, storey / 2, p.expert.level, threads
    )
    return decide(points, columns, surface, p, threads)


def height_above(points: Floats, ground: Booleans, p: SlopeParameters, threads: int = 1) -> Floats:
    """Return the height above the nearest floor beneath each point, metres, (N,).

    The floor is the plane through the ground points of the cells within `extension`, of the
    highest storey not above the point. Under the lowest floor the height is negative; NaN
    where there is no ground near.
    """
    clearance = np.inf if p.clearance is None else p.clearance
    lattice = build_lattice(points, p.expert.cell, p.expert.extension, threads)
    columns = sort_columns(points[ground], lattice._replace(slots=lattice.slots[ground]), threads)
    thickness = 2 * p.expert.tolerance_limit
    levels = find_levels(columns, thickness, clearance / 2, 1.0, threads)
    occupied = np.zeros(lattice.slot_count, np.bool_)
    occupied[lattice.slots] = True
    surface = fit_surface(
        levels, lattice, occupied, p.expert.extension, clearance / 2, thickness, threads
    )
    heights = np.full(len(points), np.nan)
    over_ranges(
        lambda first, end: _height_above(
            points,
            lattice.slots,
            *surface,
            p.expert.cell,
            p.expert.tolerance_limit,
            first,
            end,
            heights,
        ),
        range_bounds(len(points), threads, _SMALLEST_RANGE),
        threads,
    )
    return heights


@compiled
def _height_above(
    points: Floats,
    slots: Integers,
    planes: Floats,
    starts: Integers,
    cell: float,
    tolerance: float,
    first_point: int,
    end_point: int,
    heights: Floats,
) -> None:
    for point in range(first_point, end_point):
        for k in range(starts[slots[point]], starts[slots[point] + 1]):
            height = height_over(points[point], planes[k], cell)
            if np.isnan(heights[point]) or height >= -tolerance:
                heights[point] = height
