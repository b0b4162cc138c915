"""The coordinate reference system of a LAS file in a few characters, from its records alone.

LAS names it in OGC well-known text or in GeoTIFF keys. Both are looked into only as far as a
name needs: keys and text that make no sense give no name, and never stop a map from being read.
"""

import re
import struct
from collections.abc import Sequence

from tiling.formats.las_header import CRS_USER_ID, VariableLengthRecord

_WKT = 2112
_GEO_KEY_DIRECTORY = 34735
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
    found = {r.record_id: r.data for r in records if r.user_id == CRS_USER_ID and r.data}
    name = None
    if _WKT in found:
        name = _name_in_wkt(found[_WKT].split(b"\0")[0].decode("utf-8", "replace"))
    if name is None and _GEO_KEY_DIRECTORY in found:
        name = _name_in_geo_keys(found[_GEO_KEY_DIRECTORY], found.get(_GEO_ASCII_PARAMS, b""))
    return name


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
