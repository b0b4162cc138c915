"""The ground by the method that was chosen."""

import numpy as np
import numpy.typing as npt

from dynahull.errors import MissingClassificationError
from dynahull.ground.cloth import cloth_ground
from dynahull.ground.lattice import Booleans, Floats
from dynahull.ground.parameters import GroundParameters
from dynahull.ground.slope import compile_once, height_above, slope_ground

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
