"""NumPy maps in one file: an (N, 3 or more) array, or one with fields x, y and z, or bare records.

Organised ones, (H, W, 3 or more) or (H, W), are read row by row.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import MapReader
from tiling.formats.checks import SIGNATURE_LENGTH, check_leftover, kind_of
from tiling.formats.numpy.arrays import (
    ArrayHeader,
    RowReader,
    organised_note,
    put_rows,
    read_array_header,
)
from tiling.formats.parts import PartWriter, Surroundings
from tiling.formats.points import Field, MapDescription, PointBatch


class NpyReader(MapReader):
    """Reads an array as points: its first three columns, or its fields x, y and z.

    Type, byte order, the order of the elements, and further columns or fields are kept. Arrays of
    Python objects are refused: nothing is ever unpickled.
    """

    seekable = sets_values = writes_parts = True

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb") as file:
            stored = read_array_header(file, path)
        if stored.dtype.hasobject:
            found = "Python objects, which only unpickling could read"
            raise MapFormatError(path, "an array of plain values", found, at="the header")
        header = stored.unorganised
        if not header.is_coordinates:
            expected = (
                "an (N, 3 or more) array of real numbers, a point a row, or one with fields "
                "x, y and z"
            )
            raise MapFormatError(path, expected, str(header), at="the header")
        size = path.stat().st_size
        end = header.size + header.data_bytes
        if size < end:
            expected = f"{header.data_bytes} bytes of values ({header})"
            found = f"{size - header.size} bytes"
            raise MapFormatError(path, expected, found, at=f"byte {header.size}")
        with path.open("rb") as file:
            counted = f"{header.row_count} points"
            notes = check_leftover(file, end, size, header.row_bytes, path, counted)
        if header is not stored:
            notes = (organised_note(stored), *notes)
        self._header = header
        self.bytes_per_point = header.row_bytes
        order = "Fortran order" if header.column_count > 1 else "C order"
        self.description = MapDescription(
            path=path,
            format=f"NumPy npy {header.version}.0, {order}",
            suffix=".npy",
            point_count=header.row_count,
            fields=header.fields(),
            notes=notes,
        )

    def _batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        header = self._header
        with self._path.open("rb") as file:
            streams = [file] * header.column_count
            reader = RowReader(streams, header, self._path, "array", rows.start)
            for first in range(rows.start, rows.stop, max_points):
                records = reader.read(min(max_points, rows.stop - first))
                yield PointBatch(first, header.coordinates(records), records)

    def values(self, records: Any, name: str) -> NDArray[Any]:
        """Return one field or column of some rows; see `MapReader.values`."""
        rows = records.view(self._header.dtype)
        if self._header.dtype.names:
            return np.asarray(rows[name])
        names = [field.name for field in self.description.fields]
        return np.asarray(rows.reshape(-1, len(names))[:, names.index(name)])

    def merged(self) -> MapReader:
        """Return what writes several such arrays into one; see `MapReader.merged`."""
        return self if self._header.has_float_coordinates else super().merged()

    def _take_further(self) -> None:
        header = self._header.extended(self.further)
        if header is None:
            expected = "fields with names, or columns of floating point numbers, to add others to"
            raise MapFormatError(self._path, expected, str(self._header), at="the header")
        self._header = header
        if not header.dtype.names:
            # A column has the type of the others.
            self._byte_order = header.dtype.str[0]
            self.further = tuple(replace(each, dtype=header.dtype.name) for each in self.further)

    def _part_writer(self, path: Path, point_count: int) -> PartWriter:
        return _NpyParts(path, point_count, self._header)


class _NpyParts(PartWriter):
    """Writes each row, or each element of it in Fortran order, to its place."""

    def __init__(self, path: Path, point_count: int, header: ArrayHeader) -> None:
        super().__init__(
            path, point_count, Surroundings(header.encode(point_count)), header.row_bytes
        )
        self._header = header

    def put(self, file: BinaryIO, first: int, records: NDArray[np.void]) -> None:
        put_rows(file, self._header, self.point_count, first, records)


_NAMES = ("x", "y", "z", "intensity", "ring")
_NUSCENES = ".pcd.bin"
_UNKNOWN = "a file that begins"


class RawReader(NpyReader):
    """Reads bare records of float32, as KITTI and nuScenes store scans: the size tells the points.

    `.bin` has x, y, z and intensity (16 bytes), `.pcd.bin` the ring as well (20 bytes).
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        is_nuscenes = path.name.lower().endswith(_NUSCENES)
        names = _NAMES if is_nuscenes else _NAMES[:4]
        size, record = path.stat().st_size, 4 * len(names)
        with path.open("rb") as file:
            start = file.read(SIGNATURE_LENGTH)
        kind = kind_of(start)
        if size and not kind.startswith(_UNKNOWN) and start.strip(b"\0"):
            raise MapFormatError(path, f"records of float32 {', '.join(names)}", kind, at="byte 0")
        if size % record:
            expected = f"records of {record} bytes, float32 {', '.join(names)}"
            raise MapFormatError(path, expected, f"{size} bytes, {size % record} too many")
        shape = size // record, len(names)
        self._header = ArrayHeader(np.dtype("<f4"), False, shape, version=0)
        self.bytes_per_point = record
        self.description = MapDescription(
            path=path,
            format=f"bare float32 records, as {'nuScenes' if is_nuscenes else 'KITTI'} has them",
            suffix=_NUSCENES if is_nuscenes else ".bin",
            point_count=size // record,
            fields=tuple(Field(name, "float32") for name in names),
            notes=() if size else ("The file has no points.",),
        )

    def _take_further(self) -> NoReturn:
        # Without a header nobody would find further fields.
        expected = "a format with names for further fields; --labels writes them beside the map"
        raise self._refused(expected)
