"""How far around a point the ground step looks: what a tile must know beyond its border.

It holds points for a short way, and reads summaries of columns for the rest.
"""

import numpy as np

from dynahull.ground.parameters import GroundParameters

FLAT_RADIUS = 2.9
"""Cells; the neighbourhood in which a level must go on to be a floor."""

FOOT_PARTS = 4
"""Feet are looked for in so many times smaller cells: about as wide as a wall is thick."""


def ground_radius(parameters: GroundParameters) -> float | None:
    """Metres in the plane within which all columns lie that decide a point's label.

    None if there is no such distance: `csf` looks at the map as a whole.
    """
    match parameters.method:
        case "none" | "las_class":
            return 0.0
        case "csf":
            return None
        case "slope":
            p = parameters.slope
            candidate = FLAT_RADIUS * p.expert.cell
            if p.clearance is not None:
                candidate = max(candidate, p.expert.storey_radius)
            # the windows, end to end
            return p.expert.extension + 2 * p.window + candidate + np.sqrt(2.0) * p.expert.cell


def height_radius(parameters: GroundParameters) -> float:
    """Metres in the plane within which the ground points lie that decide a point's height."""
    expert = parameters.slope.expert
    return expert.extension + np.sqrt(2.0) * expert.cell


def points_around(parameters: GroundParameters, heights: bool, border: float) -> float:
    """Metres of points that a tile must hold around its core, so that its columns are whole.

    Parameters
    ----------
    heights : bool
        Whether heights are asked for.
    border : float
        Metres: borders of tiles are at multiples of it, which is a power of two.
    """
    cell = parameters.slope.expert.cell
    if (parameters.method == "slope" or heights) and not _divides(cell, border):
        return 2 * cell  # ground points of these columns must be known as well
    return 0.0


def decided_around(parameters: GroundParameters, halo: float, border: float) -> float:
    """Metres around its core in which a tile decides by its points, of which it holds a halo.

    A point may be a foot by all points within its part of a cell.
    """
    if parameters.method != "slope":
        return halo
    side = parameters.slope.expert.cell / FOOT_PARTS
    if _divides(side, border):
        return float(np.floor(halo / side) * side)
    return max(halo - _WIDER * side, 0.0)


_WIDER = 1.25
"""Of cells that borders of tiles are not borders of: coordinates are rounded."""


def _divides(side: float, border: float) -> bool:
    """Tell whether borders of tiles are borders of cells, exactly."""
    return bool(np.frexp(side)[0] == 0.5) and side <= border
