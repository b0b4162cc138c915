"""The coordinate reference system of a LAS file, its name and its units, from its records alone.

LAS names it in OGC well-known text or in GeoTIFF keys. Both are looked into only as far as a
name and units need: keys and text that make no sense give none, and never stop a map from being
read.
"""

import re
import struct
from collections.abc import Sequence

from tiling.formats.geo_keys import units_in_geo_keys
from tiling.formats.las.header import CRS_USER_ID, VariableLengthRecord
from tiling.formats.units import Units
from tiling.formats.wkt import units_in_wkt

_WKT = 2112
_GEO_KEY_DIRECTORY = 34735
_GEO_DOUBLE_PARAMS = 34736
_GEO_ASCII_PARAMS = 34737

_PROJECTED_TYPE, _GEOGRAPHIC_TYPE = 3072, 2048
_CITATIONS = (3073, 2049, 1026)
_USER_DEFINED = 32767

_WKT_TOKEN = re.compile(r'"(?:[^"]|"")*"|[\[\]()]')
_WKT_AUTHORITY = re.compile(r'\b(?:AUTHORITY|ID)\s*[\[(]\s*"(\w+)"\s*,\s*"?(\w+)"?', re.IGNORECASE)
_WKT_NAME = re.compile(r'^\s*\w+\s*[\[(]\s*"((?:[^"]|"")*)"')


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
        name = _name_in_wkt(_text(found[_WKT]))
    if name is None and _GEO_KEY_DIRECTORY in found:
        name = _name_in_geo_keys(found[_GEO_KEY_DIRECTORY], found.get(_GEO_ASCII_PARAMS, b""))
    return name


def crs_units(records: Sequence[VariableLengthRecord]) -> Units | None:
    """Tell what the coordinates of a LAS file are measured in, None where nothing says it."""
    found = _crs_records(records)
    units = units_in_wkt(_text(found[_WKT])) if _WKT in found else None
    if (units is None or units.horizontal is None) and _GEO_KEY_DIRECTORY in found:
        doubles = found.get(_GEO_DOUBLE_PARAMS, b"")
        units = units_in_geo_keys(found[_GEO_KEY_DIRECTORY], doubles) or units
    return units


def _crs_records(records: Sequence[VariableLengthRecord]) -> dict[int, bytes]:
    return {r.record_id: r.data for r in records if r.user_id == CRS_USER_ID and r.data}


def _text(data: bytes) -> str:
    return data.split(b"\0", maxsplit=1)[0].decode("utf-8", "replace")


def _name_in_wkt(text: str) -> str | None:
    """Return the code of the outermost authority, or the name of the outermost system."""
    depth = 0
    outer = []
    for token in _WKT_TOKEN.finditer(text):
        if token.group() in "[(":
            depth += 1
            if depth == 2:
                start = token.start()
        elif token.group() in "])":
            if depth == 2:
                word_start = re.search(r"\w*\s*$", text[:start])
                outer.append(text[word_start.start() if word_start else start : token.end()])
            depth -= 1
    for part in reversed(outer):
        if authority := _WKT_AUTHORITY.match(part):
            return f"{authority[1]}:{authority[2]}"
    named = _WKT_NAME.match(text)
    return _tidy(named[1]) if named else None


def _name_in_geo_keys(directory: bytes, ascii_params: bytes) -> str | None:
    """Return the EPSG code of the projected or else the geographic system, or a citation."""
    words = struct.unpack(f"<{len(directory) // 2}H", directory[: len(directory) // 2 * 2])
    keys = {words[i]: words[i + 1 : i + 4] for i in range(4, len(words) - 3, 4)}
    for key in (_PROJECTED_TYPE, _GEOGRAPHIC_TYPE):
        location, _, code = keys.get(key, (0, 0, 0))
        if location == 0 and 0 < code < _USER_DEFINED:
            return f"EPSG:{code}"
    for key in _CITATIONS:
        location, length, start = keys.get(key, (0, 0, 0))
        if location == _GEO_ASCII_PARAMS:
            citation = _tidy(ascii_params[start : start + length].decode("latin-1"))
            if citation:
                return citation
    return None


def _tidy(name: str) -> str | None:
    return name.split("\0", maxsplit=1)[0].rstrip("|").strip() or None
