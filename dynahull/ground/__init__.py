"""Step 1: the ground, which is set aside before the scoring.

The paper removes the ground first: it is dense and says nothing about what moved. `slope` is
this package's own method, local and free of any origin; `csf`, `las_class` and `none` are the
others.
"""

import numpy as np
import numpy.typing as npt

from dynahull.errors import MissingClassificationError
from dynahull.ground.cloth import cloth_ground
from dynahull.ground.lattice import Booleans, Floats
from dynahull.ground.parameters import ClothParameters, GroundParameters, SlopeParameters
from dynahull.ground.slope import (
    compile_once,
    height_above,
    height_reach,
    slope_ground,
    slope_radius,
)

__all__ = [
    "ClothParameters",
    "GroundParameters",
    "SlopeParameters",
    "ground_mask",
    "ground_radius",
    "height_above_ground",
    "height_radius",
]

_GROUND_CLASS = 2


def ground_mask(
    points: Floats,
    parameters: GroundParameters,
    classification: npt.NDArray[np.uint8] | None = None,
    *,
    threads: int = 1,
) -> Booleans:
    """Tell which points are ground.

    Parameters
    ----------
    points : (N, 3) float64 array
        Finite coordinates, metres.
    parameters : GroundParameters
        The method and its settings.
    classification : (N,) uint8 array, optional
        ASPRS classes, for `method: las_class`.
    threads : int
        Threads of `method: slope`. The result does not depend on it.

    Raises
    ------
    MissingClassificationError
        If the classes are to be trusted and there are none.
    MissingDependencyError
        If `csf` is chosen and its package is not installed.
    """
    match parameters.method:
        case "none":
            return np.zeros(len(points), np.bool_)
        case "las_class":
            if classification is None:
                raise MissingClassificationError(
                    "ground.method: las_class needs points with a classification; these have none"
                )
            return np.asarray(classification == _GROUND_CLASS)
        case "csf":
            return cloth_ground(points, parameters.csf)
        case "slope":
            compile_once()
            return slope_ground(points, parameters.slope, threads)


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
            return slope_radius(parameters.slope)


def height_radius(parameters: GroundParameters) -> float:
    """Metres in the plane within which the ground points lie that decide a point's height."""
    return height_reach(parameters.slope)


def height_above_ground(
    points: Floats, ground: Booleans, parameters: GroundParameters, *, threads: int = 1
) -> Floats:
    """Return each point's height above the floor beneath it, metres.

    Parameters
    ----------
    points : (N, 3) float64 array
        Finite coordinates, metres.
    ground : (N,) bool array
        Which of them are ground.
    parameters : GroundParameters
        The lattice of its `slope` section is used, whatever the method.
    threads : int
        The result does not depend on it.

    Returns
    -------
    (N,) float64 array
        NaN where no ground is near; negative beneath the lowest floor. With several storeys, the
        height above the nearest floor beneath the point.
    """
    compile_once()
    return height_above(points, ground, parameters.slope, threads)
