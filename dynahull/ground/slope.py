"""Ground by the slope of the surface under a point, from nearby points only.

The steps: columns of a lattice anchored at the origin; levels in each column, layers with free
height above; floors among them, flat and no ceiling; what stands out of its storey by more than
a slope allows is an object (Vosselman 2000; Zhang et al. 2003; Pingel et al. 2013); planes through
the levels that are left. A point near such a plane is ground, unless it is the foot of something.
"""

from functools import lru_cache, partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from dynahull.compilation import compiled, compiling
from dynahull.ground.candidates import are_flat, are_floors, outlines, stand_out
from dynahull.ground.columns import Columns, find_levels, levels_of, sort_columns
from dynahull.ground.decision import decide
from dynahull.ground.lattice import (
    Booleans,
    Floats,
    Integers,
    lattice_of_cells,
    number_columns,
    starts_of,
)
from dynahull.ground.parameters import SlopeParameters
from dynahull.ground.reach import FLAT_RADIUS
from dynahull.ground.surface import Surface, fit_surface, height_over
from dynahull.summary import Summary
from dynahull.threads import over_items

_STOREY_TO_CLEARANCE = 1.2
"""Floors lie at least the clearance and a slab apart: nearer levels share a storey."""

_SMALLEST_RANGE = 20_000
"""Points."""


class GroundSummary(NamedTuple):
    """What columns say of the ground around them."""

    levels: Summary
    """See `find_levels`."""
    outlines: Summary
    """See `candidates.outlines`; empty where there are no storeys."""


@lru_cache(maxsize=1)
def compile_once() -> None:
    """Compile the ground step, unless its code is kept already."""
    with compiling("the ground step", Path(__file__).parent):
        corner, p = np.random.default_rng(0).uniform(0, 3, (64, 3)), SlopeParameters()
        ground = corner[slope_ground(corner, p)]
        height_above(corner, floors_of(sort_columns(ground, p.expert.cell), p), p)


def slope_ground(
    points: Floats, p: SlopeParameters, threads: int = 1, around: GroundSummary | None = None
) -> Booleans:
    """Tell which points are ground, (N,).

    The answer is the same for any order of the points, for any number of threads, and for any part
    of a map that holds, with a point, all those of its column within a quarter of a cell.

    Parameters
    ----------
    points : (N, 3) float64 array
        Finite coordinates, metres.
    around : GroundSummary, optional
        Of all columns within `ground_radius` of the points; by default these are all.
    """
    columns = sort_columns(points, p.expert.cell, threads)
    around = summarise(columns, p, threads) if around is None else around
    return decide(points, columns, _surface(around, columns.cells, p, threads), p, threads)


def summarise(columns: Columns, p: SlopeParameters, threads: int = 1) -> GroundSummary:
    """Return what some columns say of the ground around them."""
    clearance = np.inf if p.clearance is None else p.clearance
    levels = find_levels(columns, p.expert.level, clearance, p.expert.clutter, threads)
    if p.clearance is None:
        return GroundSummary(levels, Summary(columns.cells[:0], np.empty((0, 1))))
    return GroundSummary(levels, outlines(columns, clearance, threads))


def _surface(around: GroundSummary, cells: Integers, p: SlopeParameters, threads: int) -> Surface:
    clearance = np.inf if p.clearance is None else p.clearance
    storey = _STOREY_TO_CLEARANCE * clearance
    reach = max(p.window, p.expert.storey_radius, p.expert.extension, FLAT_RADIUS * p.expert.cell)
    known = (around.levels.cells, around.outlines.cells, cells)
    lattice = lattice_of_cells(np.concatenate(known), p.expert.cell, reach)
    of_levels, of_outlines, wanted = np.split(
        lattice.slots, np.cumsum([len(each) for each in known[:-1]])
    )
    levels = levels_of(around.levels, lattice._replace(slots=of_levels))
    levels = levels.keep(are_flat(levels, lattice, p, threads))
    if p.clearance is not None:
        heights = around.outlines.values[np.argsort(of_outlines, kind="stable"), 0]
        starts = starts_of(of_outlines, lattice.slot_count)
        levels = levels.keep(are_floors(levels, heights, starts, lattice, p, clearance, threads))
    levels = levels.keep(~stand_out(levels, lattice, p, storey, threads))
    return fit_surface(
        levels, lattice, wanted, p.expert.extension, storey / 2, p.expert.level, threads
    )


def floors_of(columns: Columns, p: SlopeParameters, threads: int = 1) -> Summary:
    """Return what columns of ground points say of heights around them."""
    clearance = np.inf if p.clearance is None else p.clearance
    return find_levels(columns, 2 * p.expert.tolerance_limit, clearance / 2, 1.0, threads)


def height_above(points: Floats, floors: Summary, p: SlopeParameters, threads: int = 1) -> Floats:
    """Return the height above the nearest floor beneath each point, metres, (N,).

    The floor is the plane through the ground points of the cells within `extension`, of the
    highest storey not above the point. Under the lowest floor the height is negative; NaN
    where there is no ground near. `floors` are those within `height_radius` of the points.
    """
    clearance = np.inf if p.clearance is None else p.clearance
    numbers, cells = number_columns(points, p.expert.cell)
    known = np.concatenate([floors.cells, cells])
    lattice = lattice_of_cells(known, p.expert.cell, p.expert.extension)
    of_floors, wanted = np.split(lattice.slots, [len(floors)])
    levels = levels_of(floors, lattice._replace(slots=of_floors))
    thickness = 2 * p.expert.tolerance_limit
    surface = fit_surface(
        levels, lattice, wanted, p.expert.extension, clearance / 2, thickness, threads
    )
    heights = np.full(len(points), np.nan)
    cell, tolerance = p.expert.cell, p.expert.tolerance_limit
    work = partial(_height_above, points, numbers, surface, cell, tolerance, heights)
    over_items(work, len(points), threads, _SMALLEST_RANGE)
    return heights


@compiled
def _height_above(
    points: Floats,
    numbers: Integers,
    surface: Surface,
    cell: float,
    tolerance: float,
    heights: Floats,
    first_point: int,
    end_point: int,
) -> None:
    planes, starts = surface.planes, surface.starts
    for point in range(first_point, end_point):
        for k in range(starts[numbers[point]], starts[numbers[point] + 1]):
            height = height_over(points[point], planes[k], cell)
            if np.isnan(heights[point]) or height >= -tolerance:
                heights[point] = height
