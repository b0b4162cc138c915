"""Formats as plug-ins: each module reads and writes one family of files.

`open_map` picks the one that knows the file's suffix.
"""

import os
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError, UnknownFormatError
from tiling.formats.base import MapReader, MapWriter
from tiling.formats.points import Field, MapDescription, PointBatch

__all__ = [
    "MAP_SUFFIXES",
    "OTHERS_TOO",
    "Field",
    "MapDescription",
    "MapReader",
    "MapWriter",
    "PointBatch",
    "field_values",
    "open_map",
]

# Modules are imported when a file of theirs is opened: each brings a library that others need not.
_READERS = {
    ".pcd": ("tiling.formats.pcd.reader", "PcdReader"),
    ".las": ("tiling.formats.las.reader", "LasReader"),
    ".laz": ("tiling.formats.las.reader", "LasReader"),
    ".ply": ("tiling.formats.ply.reader", "PlyReader"),
    ".parquet": ("tiling.formats.parquet", "ParquetReader"),
    ".npy": ("tiling.formats.numpy.npy", "NpyReader"),
    ".npz": ("tiling.formats.numpy.npz", "NpzReader"),
    ".e57": ("tiling.formats.e57.reader", "E57Reader"),
    **dict.fromkeys(
        (".xyz", ".pts", ".asc", ".txt", ".csv"), ("tiling.formats.text", "TextReader")
    ),
    ".bin": ("tiling.formats.numpy.npy", "RawReader"),
}

MAP_SUFFIXES = tuple(_READERS)
"""File name suffixes of the maps that can be read, in lower case."""

OTHERS_TOO = (".txt", ".csv", ".bin")
"""Those that files have which are no maps: beside maps with another they are not taken for any."""


def open_map(path: Path, threads: int = 1) -> MapReader:
    """Open a map for reading: its header is read and checked, no point is.

    Parameters
    ----------
    path : Path
        A file with one of the suffixes in `MAP_SUFFIXES`, in upper or lower case.
    threads : int
        Cores that reading and writing may use at once, see `MapReader.threads`.

    Raises
    ------
    UnknownFormatError
        When the suffix is not known.
    MapFormatError
        When there is no such file, or it is not what its suffix says.
    """
    path = Path(path)
    if path.suffix.lower() not in _READERS:
        known = ", ".join(MAP_SUFFIXES)
        raise UnknownFormatError(path, f"a map ({known})", f"suffix {path.suffix or 'none'!r}")
    if not os.path.lexists(path):
        raise MapFormatError(path, "a map file", "no such file")
    if not path.exists():
        raise MapFormatError(path, "a map file", "a link to nothing")
    if not path.is_file():
        raise MapFormatError(path, "a map file", "something that is not a file")
    module, name = _READERS[path.suffix.lower()]
    kind: type[MapReader] = getattr(import_module(module), name)
    try:
        reader = kind(path)  # type: ignore[call-arg]
    except OSError as error:
        raise MapFormatError(path, "a file that can be read", error.strerror or "none") from error
    reader.threads = threads
    return reader


def field_values(path: Path, name: str) -> Iterator[NDArray[np.generic]]:
    """Yield the values of one field, in the order of the points, as arrays that follow each other.

    They are (n,) arrays of numbers or booleans, of a field that has one of these a point.

    Raises
    ------
    MapFormatError
        When the map has no such field, when it is not of numbers, or when the map's fields cannot
        be read apart.
    """
    reader = open_map(path)
    fields = {field.name: field for field in reader.description.fields}
    if name not in fields:
        found = f"only {', '.join(fields) or 'none'}"
        raise MapFormatError(path, f"a field {name!r}", found)
    if fields[name].count != 1:
        raise MapFormatError(path, f"one {name} a point", f"{fields[name].count}")
    for batch in reader.batches():
        values = reader.values(batch.records, name)
        if values.dtype.kind not in "biuf":
            raise MapFormatError(path, f"numbers in the field {name}", str(values.dtype))
        yield values
