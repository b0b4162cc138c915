"""Parquet files of any name, and where the coordinates are in a table.

They are in columns x, y and z, or in one column of points. Such a column is a list of three
numbers or more, as PDAL writes it (`xyz`); or the geometry of GeoParquet: a structure with x, y
and z, or points in the form of well-known binary (WKB, ISO or with PostGIS's flag).
"""

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.points import COORDINATES, coordinate_names


@contextmanager
def open_parquet(path: Path, **options: Any) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file of any name: Arrow itself takes names that are UTF-8, and no others.

    The options are those of `pyarrow.parquet.ParquetFile`.
    """
    with pa.OSFile(os.fsencode(path), "rb") as source, pq.ParquetFile(source, **options) as file:
        yield file


def row_count(path: Path) -> int:
    """Return the number of rows of a file."""
    with open_parquet(path) as file:
        return int(file.metadata.num_rows)


_POINTS = "xyz"
_WKB_POINT = np.dtype([("order", "u1"), ("kind", "<u4"), ("xyz", "<f8", 3)])
_LITTLE_ENDIAN = 1
_POINT_Z = (1001, 0x80000001)

Points = NDArray[np.float64]
TakePoints = Callable[[pa.Table], Points]
"""Returns the (n, 3) coordinates of a table; what is null is NaN."""


def find_points(schema: pa.Schema, geo: bytes | None, path: Path) -> TakePoints | None:
    """Tell how to take coordinates out of a table; None where no columns could hold them.

    GeoParquet's description of the table is `geo`, if there is one. Columns that should hold them
    and hold anything else are refused.
    """
    names = coordinate_names(schema.names)
    if names is not None:
        for name in names:
            kind = _only_column(schema, name, path).type
            if not _is_number(kind):
                expected = f"numbers in column {name}"
                raise MapFormatError(path, expected, f"type {kind}", at="the schema")
        return partial(xyz_of, names=names)
    geometry = str(geometry_column(geo)[0])
    for name in (_POINTS, geometry):
        if name not in schema.names:
            continue
        kind = _only_column(schema, name, path).type
        if _is_list(kind) and _is_number(kind.value_type):
            return partial(xyz_of, names=[name] * 3, parts=range(3))
        if pa.types.is_struct(kind):
            parts = {field.name: field.type for field in kind}
            if all(part in parts and _is_number(parts[part]) for part in COORDINATES):
                return partial(xyz_of, names=[name] * 3, parts=COORDINATES)
        if name == geometry and (pa.types.is_binary(kind) or pa.types.is_large_binary(kind)):
            return partial(_of_wkb, name=name, path=path)
    return None


def geometry_column(geo: bytes | None) -> tuple[str | None, dict[str, Any]]:
    """Return name and description of GeoParquet's first column; None where there is none."""
    try:
        described = json.loads(geo or b"{}")
        name = described["primary_column"]
        return str(name), dict(described["columns"][name])
    except (ValueError, LookupError, TypeError, RecursionError):
        return None, {}


def _only_column(schema: pa.Schema, name: str, path: Path) -> pa.Field:
    if schema.names.count(name) != 1:
        raise MapFormatError(path, f"one column {name}", "several", at="the schema")
    return schema.field(name)


def _is_number(kind: pa.DataType) -> bool:
    types = pa.types
    return bool(types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind))


def _is_list(kind: pa.DataType) -> bool:
    types = pa.types
    return bool(
        types.is_list(kind)
        or types.is_large_list(kind)
        or (types.is_fixed_size_list(kind) and kind.list_size >= 3)
    )


def xyz_of(
    table: pa.Table,
    names: Sequence[str] = COORDINATES,
    parts: Sequence[int | str | None] = (None, None, None),
) -> Points:
    """Take each coordinate, (n, 3), from a column, or from an item or a member of its values."""
    xyz = np.empty((table.num_rows, 3))
    for axis, (name, part) in enumerate(zip(names, parts, strict=True)):
        column = table.column(name)
        if isinstance(part, int):
            column = pc.list_element(column, part)
        elif isinstance(part, str):
            column = pc.struct_field(column, part)
        if pa.types.is_decimal(column.type):
            column = column.cast(pa.float64(), safe=False)
        xyz[:, axis] = column.to_numpy()
    return xyz


def _of_wkb(table: pa.Table, name: str, path: Path) -> Points:
    """Take the coordinates from points in well-known binary."""
    column = table.column(name)
    present = np.asarray(pc.is_valid(column).to_numpy())
    xyz = np.full((table.num_rows, 3), np.nan)
    values = column.drop_null().to_pylist()
    size = next((len(each) for each in values if len(each) != _WKB_POINT.itemsize), None)
    if size is not None:
        expected = f"points of {_WKB_POINT.itemsize} bytes (WKB, Point Z) in column {name}"
        raise MapFormatError(path, expected, f"one of {size} bytes")
    points = np.frombuffer(b"".join(values), _WKB_POINT)
    for order, dtype in ((_LITTLE_ENDIAN, _WKB_POINT), (0, _WKB_POINT.newbyteorder(">"))):
        own = points["order"] == order
        swapped = points.view(dtype)[own]
        kinds = swapped["kind"][~np.isin(swapped["kind"], _POINT_Z)]
        if len(kinds):
            expected = f"points with x, y and z (WKB type 1001) in column {name}"
            raise MapFormatError(path, expected, f"one of type {kinds[0]}")
        xyz[np.flatnonzero(present)[own]] = swapped["xyz"]
    if (points["order"] > _LITTLE_ENDIAN).any():
        found = f"{points['order'].max()}"
        raise MapFormatError(path, f"a byte order of 0 or 1 in column {name}", found)
    return xyz
