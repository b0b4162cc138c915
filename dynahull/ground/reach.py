"""How far around a point the ground step looks: what a tile must know beyond its border."""

import numpy as np

from dynahull.ground.parameters import GroundParameters, SlopeParameters

FLAT_RADIUS = 2.9
"""Cells; the neighbourhood in which a level must go on to be a floor."""


def ground_radius(parameters: GroundParameters) -> float | None:
    """Metres in the plane within which all points lie that decide a point's label.

    None if there is no such distance: `csf` looks at the map as a whole.
    """
    match parameters.method:
        case "none" | "las_class":
            return 0.0
        case "csf":
            return None
        case "slope":
            return _slope_radius(parameters.slope)


def height_radius(parameters: GroundParameters) -> float:
    """Metres in the plane within which the ground points lie that decide a point's height."""
    return _height_reach(parameters.slope)


def decision_radius(parameters: GroundParameters, heights: bool) -> float:
    """Metres within which all points lie that decide if a point is ground, and how high it is.

    Infinite where there is no such distance.

    Parameters
    ----------
    parameters : GroundParameters
    heights : bool
        Whether heights are asked for.
    """
    radius = ground_radius(parameters)
    if radius is None:
        return np.inf
    return radius + (height_radius(parameters) if heights else 0.0)


def _slope_radius(p: SlopeParameters) -> float:
    """Metres within which all points lie that decide a point's label: the windows, end to end."""
    candidate = FLAT_RADIUS * p.expert.cell
    if p.clearance is not None:
        candidate = max(candidate, p.expert.storey_radius)
    return p.expert.extension + 2 * p.window + candidate + np.sqrt(2.0) * p.expert.cell


def _height_reach(p: SlopeParameters) -> float:
    """Metres within which all ground points lie that decide a point's height above the ground."""
    return p.expert.extension + np.sqrt(2.0) * p.expert.cell
