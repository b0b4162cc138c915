"""The ground by the method that was chosen."""

import numpy as np
import numpy.typing as npt

from dynahull.errors import MissingClassificationError
from dynahull.ground.cloth import cloth_ground
from dynahull.ground.columns import sort_columns
from dynahull.ground.lattice import Booleans, Floats
from dynahull.ground.parameters import GroundParameters
from dynahull.ground.slope import (
    GroundSummary,
    compile_once,
    floors_of,
    height_above,
    slope_ground,
    summarise,
)
from dynahull.summary import Summary

_GROUND_CLASS = 2


def ground_mask(
    points: Floats,
    parameters: GroundParameters,
    classification: npt.NDArray[np.uint8] | None = None,
    *,
    threads: int = 1,
    around: GroundSummary | None = None,
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
    around : GroundSummary, optional
        For `method: slope` of a part of a map: what `ground_summary` says of the columns around.

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
            return slope_ground(points, parameters.slope, threads, around)


def ground_summary(points: Floats, core: Booleans, parameters: GroundParameters) -> GroundSummary:
    """Return what a part of a map tells those around it, so that they find their ground.

    Parameters
    ----------
    points : (N, 3) float64 array
        In the order of their rows.
    core : (N,) bool array
        Points that are in no other part. With one of them, its whole column is there.
    parameters : GroundParameters
        Of `method: slope`.
    """
    compile_once()
    columns = sort_columns(points, parameters.slope.expert.cell)
    return summarise(columns.begun_in(core), parameters.slope)


def height_summary(points: Floats, core: Booleans, parameters: GroundParameters) -> Summary:
    """Return what the ground points of a part tell those around it: see `ground_summary`."""
    compile_once()
    columns = sort_columns(points, parameters.slope.expert.cell)
    return floors_of(columns.begun_in(core), parameters.slope)


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

    Returns
    -------
    (N,) float64 array
        NaN where no ground is near; negative beneath the lowest floor. With several storeys, the
        height above the nearest floor beneath the point.
    """
    compile_once()
    floors = floors_of(sort_columns(points[ground], parameters.slope.expert.cell, threads),
                       parameters.slope, threads)  # fmt: skip
    return height_above(points, floors, parameters.slope, threads)


def height_above_floors(points: Floats, floors: Summary, parameters: GroundParameters) -> Floats:
    """Return the same where the ground is known by what `height_summary` says of it."""
    compile_once()
    return height_above(points, floors, parameters.slope)
