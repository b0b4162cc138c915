"""Which points are ground: those near its surface, but for the feet of what stands on it.

A wall or a walker reaches down to the floor, and its lowest points lie as near to the floor's
surface as the floor's own. Within a quarter of a cell it is decided by the majority: where more
than `foot` times as many points follow above as there are near the surface, they are a foot.
"""

from functools import partial

import numpy as np

from dynahull.compilation import compiled, helper
from dynahull.ground.columns import Columns, first_above, first_from
from dynahull.ground.lattice import FARTHEST_CELL, Booleans, Floats, Integers
from dynahull.ground.parameters import SlopeParameters
from dynahull.ground.reach import FOOT_PARTS
from dynahull.ground.surface import NOISE, SLOPE_X, SLOPE_Y, Surface, height_over
from dynahull.threads import over_ranges

_FOOT_HEIGHT = 0.3
"""Metres; what stands on the ground is looked for so high above it."""

_Tolerances = tuple[float, float, float, float, float]
"""Metres, a unit of slope, a metre of noise, and at most; and the steepest slope."""


def decide(
    points: Floats, columns: Columns, surface: Surface, p: SlopeParameters, threads: int = 1
) -> Booleans:
    """Tell which points are ground, (N,): those near the surface over their columns."""
    ground, e = np.zeros(len(points), np.bool_), p.expert
    widths = (e.tolerance, e.slope_tolerance, e.noise_tolerance, e.tolerance_limit, p.steepest)
    foot = np.inf if p.clearance is None else e.foot
    work = partial(_decide, points, columns, surface, widths, e.cell, foot, ground)
    over_ranges(work, columns.bounds(threads), threads)
    return ground


@compiled
def _decide(
    points: Floats,
    columns: Columns,
    surface: Surface,
    tolerances: _Tolerances,
    cell: float,
    foot: float,
    ground: Booleans,
    first_column: int,
    end_column: int,
) -> None:
    rows, starts = columns.rows, columns.starts
    planes, plane_starts = surface.planes, surface.starts
    longest, most = 0, 0
    for column in range(first_column, end_column):
        longest = max(longest, starts[column + 1] - starts[column])
        most = max(most, plane_starts[column + 1] - plane_starts[column])
    widths = np.empty(most, np.float64)
    bottoms, tops = np.empty(longest, np.float64), np.empty(longest, np.float64)
    parts = np.empty(longest, np.int64)
    part_heights = np.empty(longest, np.float64)
    part_starts = np.empty(FOOT_PARTS * FOOT_PARTS + 1, np.int64)
    for column in range(first_column, end_column):
        first, end = starts[column], starts[column + 1]
        lowest, highest = plane_starts[column], plane_starts[column + 1]
        if lowest == highest:
            continue
        for k in range(lowest, highest):
            widths[k - lowest] = _width_about(planes[k], tolerances)
        near = 0
        for place in range(first, end):
            row = rows[place]
            bottom, top = _layer_about(points[row], planes, lowest, highest, widths, cell)
            bottoms[place - first], tops[place - first] = bottom, top
            ground[row] = top >= bottom
            near += ground[row]
            i, j = _part_of(points[row, 0] / cell), _part_of(points[row, 1] / cell)
            parts[place - first] = i * FOOT_PARTS + j
        if near == 0 or foot == np.inf:
            continue
        _sort_parts(columns.heights, first, end, parts, part_heights, part_starts)
        for place in range(end - first):
            row = rows[first + place]
            part = parts[place]
            lower, upper = part_starts[part], part_starts[part + 1]
            if ground[row] and _is_foot(
                part_heights, lower, upper, bottoms[place], tops[place], foot
            ):
                ground[row] = False


@helper
def _width_about(plane: Floats, tolerances: _Tolerances) -> float:
    """Return how far from a plane points are ground, or -1 if it is too steep."""
    base, per_slope, per_noise, limit, steepest = tolerances
    slope = np.hypot(plane[SLOPE_X], plane[SLOPE_Y])
    if slope > steepest:
        return -1.0
    return min(base + per_slope * slope + per_noise * plane[NOISE], limit)


@helper
def _layer_about(
    point: Floats, planes: Floats, first: int, end: int, widths: Floats, cell: float
) -> tuple[float, float]:
    """Return bottom and top of the surface's layer at a point, or (0, -1) if it is not in one."""
    nearest, surface, width = np.inf, 0.0, -1.0
    for k in range(first, end):
        height = height_over(point, planes[k], cell)
        if widths[k - first] >= 0 and abs(height) < nearest:
            nearest = abs(height)
            surface, width = point[2] - height, widths[k - first]
    if abs(point[2] - surface) <= width:
        return surface - width, surface + width
    return 0.0, -1.0


@helper
def _part_of(coordinate: float) -> int:
    """Return the part of its cell along one axis, of a coordinate in cells."""
    part = int(np.floor(FOOT_PARTS * min(max(coordinate, -FARTHEST_CELL), FARTHEST_CELL)))
    return part & (FOOT_PARTS - 1)


@helper
def _sort_parts(
    heights: Floats,
    first: int,
    end: int,
    parts: Integers,
    part_heights: Floats,
    part_starts: Integers,
) -> None:
    """Sort a column's heights by part; those of a part stay sorted."""
    for part in range(len(part_starts)):
        part_starts[part] = 0
    for place in range(end - first):
        part_starts[parts[place]] += 1
    total = 0
    for part in range(len(part_starts)):
        total += part_starts[part]
        part_starts[part] = total
    for place in range(end - first - 1, -1, -1):
        part_starts[parts[place]] -= 1
        part_heights[part_starts[parts[place]]] = heights[first + place]


@helper
def _is_foot(heights: Floats, first: int, end: int, bottom: float, top: float, foot: float) -> bool:
    """Whether more points follow above the layer than `foot` times those within it."""
    lower = first_from(heights, first, end, bottom)
    upper = first_above(heights, lower, end, top)
    above = first_above(heights, upper, end, top + _FOOT_HEIGHT) - upper
    return above > foot * (upper - lower)
