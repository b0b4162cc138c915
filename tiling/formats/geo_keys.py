"""Units in the GeoTIFF keys of a LAS file (GeoTIFF 1.0, section 6)."""

import struct
from collections.abc import Mapping
from importlib import import_module
from typing import Any

from tiling.formats.units import DEGREE, FOOT, METRE, US_SURVEY_FOOT, Unit, Units, length

_MODEL, _PROJECTED, _GEOGRAPHIC, _VERTICAL = 1024, 3072, 2048, 4096
_LINEAR_UNITS, _LINEAR_SIZE, _GEOCENTRIC_UNITS, _VERTICAL_UNITS = 3076, 3077, 2052, 4099
_MODEL_PROJECTED, _MODEL_GEOGRAPHIC, _MODEL_GEOCENTRIC = 1, 2, 3
_USER_DEFINED = 32767
_DOUBLE_PARAMS = 34736

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


def units_in_geo_keys(directory: bytes, doubles: bytes) -> Units | None:
    """Return the units that keys tell of, None where they tell nothing.

    Where they name the system by its code alone, pyproj knows its unit, if it is installed.
    """
    words = struct.unpack(f"<{len(directory) // 2}H", directory[: len(directory) // 2 * 2])
    keys = {words[at]: words[at + 1 : at + 4] for at in range(4, len(words) - 3, 4)}
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
