"""The coordinate reference system of a LAS file, its name and its units, from its records alone.

LAS names it in well-known text (OGC 1 and 2, and Esri's) or in GeoTIFF keys (GeoTIFF 1.0, section
6). Both are looked into only as far as a name and units need: keys and text that make no sense give
none, and never stop a map from being read.
"""

import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Any

from tiling.formats.las.header import CRS_USER_ID, VariableLengthRecord
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
    """Name the coordinate reference system of a LAS file by its VLRs and EVLRs.

    The name is such as `"EPSG:26915"` where an authority's code is given, else the system's own;
    None where there is neither. Well-known text is preferred to GeoTIFF keys.
    """
    found = _crs_records(records)
    name = _tidy(name_in_wkt(_text(found.get(_WKT, b""))) or "")
    keys = _geo_keys(found.get(_GEO_KEY_DIRECTORY, b""))
    return name or _name_in_geo_keys(keys, found.get(_ASCII_PARAMS, b""))


def crs_units(records: Sequence[VariableLengthRecord]) -> Units | None:
    """Tell what the coordinates of a LAS file are measured in, None where nothing says it."""
    found = _crs_records(records)
    units = units_in_wkt(_text(found.get(_WKT, b"")))
    if (units is None or units.horizontal is None) and _GEO_KEY_DIRECTORY in found:
        doubles = found.get(_DOUBLE_PARAMS, b"")
        units = units_in_geo_keys(found[_GEO_KEY_DIRECTORY], doubles) or units
    return units


def _crs_records(records: Sequence[VariableLengthRecord]) -> dict[int, bytes]:
    return {r.record_id: r.data for r in records if r.user_id == CRS_USER_ID and r.data}


def _text(data: bytes) -> str:
    return data.split(b"\0", maxsplit=1)[0].decode("utf-8", "replace")


def _name_in_geo_keys(keys: _Keys, ascii_params: bytes) -> str | None:
    """Return the EPSG code of the projected or else the geographic system, or a citation."""
    for key in (_PROJECTED, _GEOGRAPHIC):
        code = _short(keys, key)
        if 0 < code < _USER_DEFINED:
            return f"EPSG:{code}"
    for key in _CITATIONS:
        location, size, start = keys.get(key, (0, 0, 0))
        citation = _tidy(ascii_params[start : start + size].decode("latin-1"))
        if location == _ASCII_PARAMS and citation:
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


_TOKEN = re.compile(r'"(?:[^"]|"")*"|[\[\](),]|[^\s,\[\]()"]+')
_DEEPEST = 32

_COMPOUND = {"COMPD_CS", "COMPOUNDCRS"}
_BOUND = {"BOUNDCRS", "SOURCECRS"}
_VERTICALS = {"VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS"}
_LINEAR = {"PROJCS", "PROJCRS", "PROJECTEDCRS", "GEOCCS", "LOCAL_CS", "ENGCRS", "ENGINEERINGCRS"}
_GEODETIC = {"GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS"}
_ANGLES = ("degree", "radian", "grad", "gon", "minute", "second")


@dataclass(slots=True)
class _Node:
    """A keyword with what is in its brackets."""

    keyword: str
    values: list[str] = field(default_factory=list)
    nodes: list["_Node"] = field(default_factory=list)

    def of(self, keywords: set[str]) -> list["_Node"]:
        return [node for node in self.nodes if node.keyword in keywords]


def name_in_wkt(text: str) -> str | None:
    """Return the code of the outermost authority, or the name of the outermost system."""
    for node in _parsed(text)[:1]:
        codes = [each.values for each in node.of({"AUTHORITY", "ID"}) if len(each.values) > 1]
        return ":".join(codes[-1][:2]) if codes else next(iter(node.values), None)
    return None


def units_in_wkt(text: str) -> Units | None:
    """Return the units of the outermost system, None where there are none to be found."""
    horizontal, vertical = None, None
    for node in _systems(_parsed(text)):
        if node.keyword in _VERTICALS:
            vertical = vertical or _unit_of(node, 0)
        elif horizontal is None:
            horizontal, height = _horizontal(node)
            vertical = vertical or height
    return Units(horizontal, vertical) if horizontal or vertical else None


def _systems(nodes: list[_Node]) -> Iterator[_Node]:
    """Yield the single systems of which one is made, each before those within it."""
    for node in nodes:
        if node.keyword in _COMPOUND | _BOUND:
            yield from _systems(node.nodes)
        elif node.keyword in _LINEAR | _GEODETIC | _VERTICALS:
            yield node
            yield from node.of(_VERTICALS)  # Esri's, within the projected one


def _horizontal(node: _Node) -> tuple[Unit | None, Unit | None]:
    """Return the units of the first and of the third axis of a system."""
    kinds = [value.lower() for cs in node.of({"CS"}) for value in cs.values[:1]]
    if node.keyword in _GEODETIC and "cartesian" not in kinds:
        return DEGREE, None
    return _unit_of(node, 0), _unit_of(node, 2)


def _unit_of(node: _Node, axis: int) -> Unit | None:
    """Return the unit of an axis: its own, or that of all."""
    places = [*node.of({"AXIS"})[axis : axis + 1], *[node] * (axis == 0)]
    return next((unit for place in places for unit in _units(place)), None)


def _units(node: _Node) -> Iterator[Unit]:
    for unit in node.of({"UNIT", "LENGTHUNIT", "ANGLEUNIT"}):
        name, factor, *_ = (*unit.values, "", "")
        try:
            known = length(name, float(factor))
        except ValueError:
            known = length(name, 0.0)
        if unit.keyword == "ANGLEUNIT" or any(word in name.lower() for word in _ANGLES):
            known = DEGREE
        if known:
            yield known


def _parsed(text: str) -> list[_Node]:
    """Return the outermost nodes; those that are not closed are left out."""
    outside = _Node("")
    open_nodes, word = [outside], ""
    for match in _TOKEN.finditer(text):
        token = match.group()
        if token in "[(":
            if len(open_nodes) > _DEEPEST:
                return []
            open_nodes.append(_Node(word.upper()))
            word = ""
        elif token in "]),":
            if word:
                open_nodes[-1].values.append(word)
                word = ""
            if token != "," and len(open_nodes) > 1:
                closed = open_nodes.pop()
                open_nodes[-1].nodes.append(closed)
        else:
            word = token[1:-1].replace('""', '"') if token.startswith('"') else token
    return outside.nodes
