"""A map is opened so that its coordinates are metres, whatever its files are in.

The method's parameters are metres. So are the coordinates that it is given: they are multiplied in
one place, on their way out of the files, and records, which the outputs are made of, never are.
"""

from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.configuration.run import InputParameters
from tiling.collection import MapCollection
from tiling.errors import CoordinateSystemError
from tiling.formats.points import MapDescription
from tiling.formats.units import FOOT, METRE, US_SURVEY_FOOT

_FACTORS = {"metre": METRE, "foot": FOOT, "us_survey_foot": US_SURVEY_FOOT}


def open_collection(
    paths: Sequence[Path], parameters: InputParameters, threads: int = 1
) -> MapCollection:
    """Open the files of a map, whose points come in metres.

    `parameters` say the unit, the poses of its scans and the frame; see `MapCollection` for the
    rest.

    Raises
    ------
    CoordinateSystemError
        When coordinates are degrees, or the files' coordinate reference systems are not one.
    TilingError
        When a file is not a map that can be read.
    """
    poses = None if parameters.poses is None else Path(parameters.poses)
    collection = MapCollection(paths, threads, poses, parameters.frame)
    said = system_of(collection)
    if parameters.unit != "auto":
        factors = np.full(3, _FACTORS[parameters.unit])
    elif said is None or said.units is None:
        return collection
    else:
        across, up = said.units.horizontal, said.units.vertical
        if across is not None and across.metres is None:
            raise CoordinateSystemError(
                said.path,
                "coordinates in metres or feet",
                f"a geographic system, in degrees ({said.crs}): project the map first, or set "
                "input.unit if the system is wrong",
            )
        horizontal = (across and across.metres) or METRE
        factors = np.array([horizontal, horizontal, (up and up.metres) or horizontal])
    if (factors != METRE).any():
        collection.metres = factors
    return collection


def system_of(collection: MapCollection) -> MapDescription | None:
    """Return the description of a file that tells the map's system; None where none does.

    Raises
    ------
    CoordinateSystemError
        When files tell of different ones.
    """
    telling = [
        reader.description
        for reader in collection.readers
        if reader.description.crs is not None or reader.description.units is not None
    ]
    for other in telling[1:]:
        if not _is_same(telling[0], other):
            raise CoordinateSystemError(
                other.path,
                f"the coordinate reference system of {telling[0].path} ({in_words(telling[0])})",
                in_words(other),
            )
    return telling[0] if telling else None


def in_words(said: MapDescription | None) -> str:
    """Return name and unit of a map's system."""
    if said is None or (said.crs is None and said.units is None):
        return "none, metres assumed"
    if said.units is None or said.units.horizontal is None:
        unit = f"{said.units or 'unit not told'}, metres assumed"
    else:
        unit = str(said.units)
    return f"{said.crs or 'unnamed'}, {unit}"


def of_map(collection: MapCollection, parameters: InputParameters) -> str:
    """Return name and unit of a map's system, as a run takes them."""
    said = system_of(collection)
    if parameters.unit == "auto":
        return in_words(said)
    name = said.crs if said is not None and said.crs is not None else "none"
    return f"{name}, {parameters.unit.replace('_', ' ')} as configured (input.unit)"


def _is_same(one: MapDescription, other: MapDescription) -> bool:
    if one.units != other.units:
        return False
    if one.crs == other.crs or one.crs is None or other.crs is None:
        return True
    try:  # names may differ where systems do not
        pyproj: Any = import_module("pyproj")
        return bool(pyproj.CRS(one.crs).equals(pyproj.CRS(other.crs), ignore_axis_order=True))
    except Exception:  # not installed, or no such system: PROJ has errors of its own
        return False
