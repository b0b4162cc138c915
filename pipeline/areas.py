"""Areas from a file: polygons as GeoJSON or WKT, or boxes, a line each; metres. Or of voxels."""

import json
import re
from collections.abc import Iterator
from math import floor, inf, nextafter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from dynahull.protection import Area
from pipeline.errors import ConfigurationError

_POLYGON = re.compile(r"(?:MULTI)?POLYGON\s*Z?\s*(\([\d\s.,()eE+-]*\))", re.IGNORECASE)
_RING = re.compile(r"\(([^()]+)\)")


def read_areas(path: Path) -> list[Area]:
    """Read areas from GeoJSON, WKT or lines of numbers.

    GeoJSON and WKT hold polygons, in features or not, and multipolygons; a line is x0 y0 x1 y1, or
    with the heights x0 y0 z0 x1 y1 z1.

    Raises
    ------
    ConfigurationError
        When the file cannot be read, or holds anything else.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
        is_json = text.lstrip().startswith("{")
        areas = list(_of_json(json.loads(text)) if is_json else _of_text(text))
    except OSError as error:
        raise ConfigurationError(f"{path}: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise ConfigurationError(f"{path}: expected polygons or boxes, found no text") from None
    except ValidationError as error:
        reason = error.errors()[0]["msg"].removeprefix("Value error, ")
        raise ConfigurationError(f"{path}: expected polygons or boxes: {reason}") from None
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise ConfigurationError(f"{path}: expected polygons or boxes, found {error}") from None
    if not areas:
        raise ConfigurationError(f"{path}: expected polygons or boxes, found none")
    return areas


def areas_of_voxels(cells: NDArray[np.int32], side: float) -> list[Area]:
    """Return areas that hold just what lies in some voxels, (n, 3): one for each layer of them."""
    areas = []
    for layer in np.unique(cells[:, 2]).tolist():
        flat = cells[cells[:, 2] == layer, :2]
        boxes = _boxes(sorted(flat.tolist(), key=lambda cell: (cell[1], cell[0])))
        rings = [
            Area.box([_edge(n, side) for n in low], [_edge(n, side) for n in high]).rings[0]
            for low, high in boxes
        ]
        top = nextafter(_edge(layer + 1, side), -inf)
        areas.append(Area(rings=tuple(rings), low=_edge(layer, side), high=top))
    return areas


def _boxes(cells: list[list[int]]) -> Iterator[tuple[list[int], list[int]]]:
    """Put cells of a layer, row by row, together into boxes: corners, the second one outside."""
    runs: list[list[int]] = []  # row, first cell, one behind the last
    for i, j in cells:
        if runs and runs[-1][0] == j and runs[-1][2] == i:
            runs[-1][2] += 1
        else:
            runs.append([j, i, i + 1])
    growing: dict[tuple[int, int], list[int]] = {}
    for j, i, end in runs:
        rows = growing.setdefault((i, end), [j, j])
        if rows[1] != j:
            yield [i, rows[0]], [end, rows[1]]
            rows[0] = j
        rows[1] = j + 1
    yield from (([i, rows[0]], [end, rows[1]]) for (i, end), rows in growing.items())


def _edge(cell: int, side: float) -> float:
    """Return the least coordinate of a cell: what is divided by its side is rounded."""
    edge = cell * side
    while floor(nextafter(edge, -inf) / side) >= cell:
        edge = nextafter(edge, -inf)
    while floor(edge / side) < cell:
        edge = nextafter(edge, inf)
    return edge


def _of_json(found: dict[str, Any]) -> Iterator[Area]:
    match found["type"]:
        case "FeatureCollection":
            for feature in found["features"]:
                yield from _of_json(feature)
        case "Feature":
            if found["geometry"] is not None:  # RFC 7946: a feature that is nowhere
                yield from _of_json(found["geometry"])
        case "GeometryCollection":
            for geometry in found["geometries"]:
                yield from _of_json(geometry)
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
