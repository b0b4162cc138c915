"""The coordinate reference system of a LAS file, its name and its units, from its records alone.

LAS names it in OGC well-known text or in GeoTIFF keys (GeoTIFF 1.0, section 6). Both are looked
into only as far as a name and units need: keys and text that make no sense give none, and never
stop a map from being read.
"""

import struct
from collections.abc import Mapping, Sequence
from importlib import import_module
from typing import Any

from tiling.formats.las.header import CRS_USER_ID, VariableLengthRecord
from tiling.formats.las.wkt import name_in_wkt, units_in_wkt
from tiling.formats.units import DEGREE, FOOT, METRE, US_SURVEY_FOOT, Unit, Units, length

_WKT = 2112
_GEO_KEY_DIRECTORY = 34735
_DOUBLE_PARAMS = 34736
_ASCII_PARAMS = 34737

_MODEL, _PROJECTED, _GEOGRAPHIC, _VERTICAL = 1024, 3072, 2048, 4096
_CITATIONS = (3073, 2049, 1026)
_LINEAR_UNITS, _LINEAR_SIZE, _GEOCENTRIC_UNITS, _VERTICAL_UNITS = 3076, 3077, 2052, 4099
_MODEL_PROJECTED, _MODEL_GEOGRAPHIC, _MODEL_GEOCENTRIC = 1, 2, 3
_USER_DEFINED = 32767

_CODES = {
    9001: ("metre", METRE),
    9002: ("foot", FOOT),
    9003: ("US survey foot", US_SURVEY_FOOT),
    9005: ("Clarke's foot", 0.3047972654),
    9014: ("fathom", 1.8288),
    9030: ("nautical mile", 1852.0),
    9035: ("US survey mile", 5280 * US_SURVEY_FOOT),
    9036: ("kilometre", 1000.0),
    9093: ("mile", 1609.344),
    1025: ("millimetre", 0.001),
    1033: ("centimetre", 0.01),
}
"""Units by their EPSG code."""

_Keys = Mapping[int, tuple[int, ...]]


def crs_name(records: Sequence[VariableLengthRecord]) -> str | None:
    """Name the coordinate reference system of a LAS file.

    Parameters
    ----------
    records : sequence of VariableLengthRecord
        The file's VLRs and EVLRs.

    Returns
    -------
    str or None
        `"EPSG:26915"` where an authority's code is given, else the system's own name; None where
        there is neither. Well-known text is preferred to GeoTIFF keys.
    """
    found = _crs_records(records)
    name = None
    if _WKT in found:
        name = _tidy(name_in_wkt(_text(found[_WKT])) or "")
    if name is None and _GEO_KEY_DIRECTORY in found:
        name = _name_in_geo_keys(found[_GEO_KEY_DIRECTORY], found.get(_ASCII_PARAMS, b""))
    return name


def crs_units(records: Sequence[VariableLengthRecord]) -> Units | None:
    """Tell what the coordinates of a LAS file are measured in, None where nothing says it."""
    found = _crs_records(records)
    units = units_in_wkt(_text(found[_WKT])) if _WKT in found else None
    if (units is None or units.horizontal is None) and _GEO_KEY_DIRECTORY in found:
        doubles = found.get(_DOUBLE_PARAMS, b"")
        units = units_in_geo_keys(found[_GEO_KEY_DIRECTORY], doubles) or units
    return units


def _crs_records(records: Sequence[VariableLengthRecord]) -> dict[int, bytes]:
    return {r.record_id: r.data for r in records if r.user_id == CRS_USER_ID and r.data}


def _text(data: bytes) -> str:
    return data.split(b"\0", maxsplit=1)[0].decode("utf-8", "replace")


def _name_in_geo_keys(directory: bytes, ascii_params: bytes) -> str | None:
    """Return the EPSG code of the projected or else the geographic system, or a citation."""
    keys = _geo_keys(directory)
    for key in (_PROJECTED, _GEOGRAPHIC):
        code = _short(keys, key)
        if 0 < code < _USER_DEFINED:
            return f"EPSG:{code}"
    for key in _CITATIONS:
        location, size, start = keys.get(key, (0, 0, 0))
        if location == _ASCII_PARAMS:
            citation = _tidy(ascii_params[start : start + size].decode("latin-1"))
            if citation:
                return citation
    return None


def _geo_keys(directory: bytes) -> _Keys:
    """Return location, length and value of each key."""
    words = struct.unpack(f"<{len(directory) // 2}H", directory[: len(directory) // 2 * 2])
    return {words[at]: words[at + 1 : at + 4] for at in range(4, len(words) - 3, 4)}


def units_in_geo_keys(directory: bytes, doubles: bytes) -> Units | None:
    """Return the units that keys tell of, None where they tell nothing.

    Where they name the system by its code alone, pyproj knows its unit, if it is installed.
    """
    keys = _geo_keys(directory)
    model = _short(keys, _MODEL)
    if model not in (_MODEL_PROJECTED, _MODEL_GEOGRAPHIC, _MODEL_GEOCENTRIC):
        projected = _PROJECTED in keys or _LINEAR_UNITS in keys or _GEOGRAPHIC not in keys
        model = _MODEL_PROJECTED if projected else _MODEL_GEOGRAPHIC
    vertical = _unit(_short(keys, _VERTICAL_UNITS)) or _looked_up(_short(keys, _VERTICAL))
    if model == _MODEL_GEOGRAPHIC:
        return Units(DEGREE, vertical)
    if model == _MODEL_GEOCENTRIC:
        return Units(_unit(_short(keys, _GEOCENTRIC_UNITS)) or length("metre", METRE))
    code = _short(keys, _LINEAR_UNITS)
    horizontal = _unit(code)
    if code == _USER_DEFINED:
        horizontal = length("", _double(keys, _LINEAR_SIZE, doubles))
    horizontal = horizontal or _looked_up(_short(keys, _PROJECTED))
    return Units(horizontal, vertical) if horizontal or vertical else None


def _short(keys: _Keys, key: int) -> int:
    """Return the value of a key that is a number in the directory itself; 0 where it is none."""
    location, _, value = keys.get(key, (0, 0, 0))
    return value if location == 0 else 0


def _double(keys: _Keys, key: int, doubles: bytes) -> float:
    location, _, place = keys.get(key, (0, 0, 0))
    if location != _DOUBLE_PARAMS or 8 * place + 8 > len(doubles):
        return 0.0
    return float(struct.unpack_from("<d", doubles, 8 * place)[0])


def _unit(code: int) -> Unit | None:
    return length(*_CODES[code]) if code in _CODES else None


def _looked_up(code: int) -> Unit | None:
    """Return the unit of the first axis of a system of EPSG."""
    if not 0 < code < _USER_DEFINED:
        return None
    try:
        pyproj: Any = import_module("pyproj")
        axis = pyproj.CRS.from_epsg(code).axis_info[0]
    except Exception:  # not installed, or no such system: PROJ has errors of its own
        return None
    if axis.unit_name in ("degree", "radian", "grad"):
        return DEGREE
    return length(axis.unit_name, axis.unit_conversion_factor)


def _tidy(name: str) -> str | None:
    return name.split("\0", maxsplit=1)[0].rstrip("|").strip() or None
