"""Areas from a file: polygons as GeoJSON or WKT, or boxes, a line each; metres."""

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from dynahull.protection import Area
from pipeline.errors import ConfigurationError

_POLYGON = re.compile(r"(?:MULTI)?POLYGON\s*Z?\s*(\([\d\s.,()eE+-]*\))", re.IGNORECASE)
_RING = re.compile(r"\(([^()]+)\)")


def read_areas(path: Path) -> list[Area]:
    """Read areas.

    Parameters
    ----------
    path : Path
        GeoJSON (polygons, in features or not), WKT (POLYGON, MULTIPOLYGON), or lines of four
        numbers x0 y0 x1 y1, or of six with the heights, x0 y0 z0 x1 y1 z1.

    Raises
    ------
    ConfigurationError
        When it cannot be read, or holds anything else.
    """
    try:
        text = path.read_text(encoding="utf-8")
        is_json = text.lstrip().startswith("{")
        areas = list(_of_json(json.loads(text)) if is_json else _of_text(text))
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror or error}") from None
    except (ValueError, KeyError, TypeError, ValidationError, RecursionError) as error:
        raise ConfigurationError(f"{path}: expected polygons or boxes, found {error}") from None
    if not areas:
        raise ConfigurationError(f"{path}: expected polygons or boxes, found none")
    return areas


def _of_json(found: dict[str, Any]) -> Iterator[Area]:
    match found["type"]:
        case "FeatureCollection":
            for feature in found["features"]:
                yield from _of_json(feature)
        case "Feature":
            yield from _of_json(found["geometry"])
        case "Polygon":
            yield _area(found["coordinates"])
        case "MultiPolygon":
            yield _area([ring for polygon in found["coordinates"] for ring in polygon])
        case other:
            raise ValueError(f"the type {other}")


def _of_text(text: str) -> Iterator[Area]:
    for polygon in _POLYGON.findall(text):
        rings = [[corner.split() for corner in ring.split(",")] for ring in _RING.findall(polygon)]
        yield _area(rings)
    for line in _POLYGON.sub("", text).splitlines():
        numbers = [
            float(word) for word in re.split(r"[\s,;]+", line.partition("#")[0].strip(" ;")) if word
        ]
        if numbers:
            half = len(numbers) // 2
            if len(numbers) not in (4, 6):
                raise ValueError(f"a line of {len(numbers)} numbers")
            yield Area.box(numbers[:half], numbers[half:])


def _area(rings: list[list[list[Any]]]) -> Area:
    return Area(rings=tuple(tuple((float(x), float(y)) for x, y, *_ in ring) for ring in rings))
