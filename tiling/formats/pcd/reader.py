"""PCD, the format of the Point Cloud Library: ascii, binary and binary_compressed.

A point's record is never taken apart: in the binary encodings it is a run of bytes, in ascii a
line of text. Only x, y and z are read from it. Ascii coordinates are the float64 nearest to the
text, also where the header says float32, so that what is computed is what the file says; integers
beyond 2**53 are the only coordinates that float64 does not hold exactly.

Less than a point behind the last one, and padding, which some writers leave in the binary
encodings, are passed over.

All encodings are streamed. A binary_compressed file, one LZF stream over whole columns, is
decompressed to, and compressed from, a temporary file of the size of its points.
"""

import struct
from collections.abc import Iterator
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import MapReader, MapWriter, StreamWriter, TextWriter
from tiling.formats.checks import check_leftover
from tiling.formats.parts import PartWriter, Surroundings
from tiling.formats.pcd.compressed import EXPANSION, ColumnSpool, compress, decompress
from tiling.formats.pcd.header import PcdField, read_header
from tiling.formats.points import (
    Field,
    MapDescription,
    PointBatch,
    numbered,
    only_rows,
)
from tiling.formats.text_rows import RowLayout, TextRows, read_rows

_SIZES = struct.Struct("<II")
"""What precedes compressed data: their size, and that of the columns."""

_PCL_TYPES = {"label": "uint32"}
"""Types that fields must have for the Point Cloud Library to find them (`PointXYZL`)."""


class PcdReader(MapReader):
    """Reads a PCD file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with self._path.open("rb") as stream:
            self._header = read_header(stream, self._path)
            size = self._path.stat().st_size - self._header.data_offset
            self._stored = self._header.fields
            if self._header.encoding == "binary_compressed":
                self._packed_size, self._stored = self._check_compressed(stream, size)
            else:
                self._check_size(size)
            notes = self._check_leftover(stream, self._header.data_offset + size)
        if self._header.height > 1:
            shape = f"{self._header.width} x {self._header.height}"
            organised = f"The organised cloud ({shape}) becomes an unorganised one, of HEIGHT 1."
            notes = (organised, *notes)
        self.bytes_per_point = self._header.record_size
        # Compressed points are columns.
        self.seekable = self.writes_parts = self._header.encoding == "binary"
        self.sets_values = self._header.encoding != "ascii"
        if self.sets_values:
            self.record_dtype = np.dtype(f"V{sum(self._widths)}")
        self.description = MapDescription(
            path=self._path,
            format=f"PCD {self._header.encoding}",
            suffix=".pcd",
            point_count=self._header.point_count,
            fields=tuple(Field(each.name, each.dtype, each.count) for each in self._header.fields),
            notes=notes,
            viewpoint=self._header.viewpoint,
        )

    def _batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        if self._header.encoding == "ascii":
            batches = self._ascii_batches(max_points)
            # All of them are read to the end, to find what is behind the last.
            everything = rows == range(self._header.point_count)
            return batches if everything else only_rows(batches, rows)
        if self._header.encoding == "binary":
            return self._binary_batches(max_points, rows)
        return self._compressed_batches(max_points, rows)

    def _stream_writer(self, path: Path, point_count: int) -> MapWriter:
        around = Surroundings(self._header.for_points(point_count))
        if self._header.encoding == "ascii":
            return TextWriter(path, point_count, around)
        return _CompressedWriter(path, point_count, around, self._widths)

    def _part_writer(self, path: Path, point_count: int) -> PartWriter:
        around = Surroundings(self._header.for_points(point_count))
        return PartWriter(path, point_count, around, self._header.record_size)

    def _take_further(self) -> None:
        self.further = tuple(
            replace(field, dtype=_PCL_TYPES.get(field.name, field.dtype)) for field in self.further
        )
        self._header = self._header.extended(self.further)
        self._stored = (*self._stored, *self._header.fields[-len(self.further) :])

    @property
    def _widths(self) -> tuple[int, ...]:
        """Bytes of each column of compressed data in a record."""
        return tuple(field.width for field in self._stored)

    def _check_size(self, size: int) -> None:
        """Compare the points announced with the bytes that follow the header."""
        header = self._header
        least = header.point_count * header.record_size
        if header.encoding == "ascii" and header.point_count:
            # Every value has a digit and something after it, save the last one.
            least = header.point_count * header.value_count * 2 - 1
        if least > size:
            expected = f"at least {least} bytes for {header.point_count} points"
            raise MapFormatError(self._path, expected, str(size), f"byte {header.data_offset}")

    def _check_leftover(self, stream: BinaryIO, stop: int) -> tuple[str, ...]:
        """Refuse points that the header does not count; return notes on other bytes."""
        header = self._header
        start, record_size = header.data_offset, header.record_size
        if header.encoding == "ascii":
            if header.point_count:  # rows of text are counted when they are read
                return ()
            record_size = 2 * header.value_count - 1
        elif header.encoding == "binary":
            start += header.point_count * record_size
        else:
            start += _SIZES.size + self._packed_size
        counted = f"{header.point_count} points"
        notes = check_leftover(stream, start, stop, record_size, self._path, counted)
        return () if header.encoding == "ascii" else notes

    def _check_compressed(self, stream: BinaryIO, size: int) -> tuple[int, tuple[PcdField, ...]]:
        """Return the size of the compressed data, and the fields that are in them."""
        header = self._header
        at = f"byte {header.data_offset}"
        if header.point_count == 0:
            return 0, header.fields
        sizes = stream.read(_SIZES.size)
        if len(sizes) < _SIZES.size:
            raise MapFormatError(self._path, "the sizes of compressed data", "the file's end", at)
        packed_size, column_size = _SIZES.unpack(sizes)
        if packed_size > size - _SIZES.size:
            expected = f"{packed_size} compressed bytes"
            raise MapFormatError(self._path, expected, str(size - _SIZES.size), at)
        # PCL leaves padding fields out of the data, and others do not: the size tells.
        named = tuple(field for field in header.fields if field.name != "_")
        for fields in (header.fields, named):
            if column_size == header.point_count * sum(field.width for field in fields):
                break
        else:
            expected = f"{header.point_count * header.record_size} uncompressed bytes"
            raise MapFormatError(self._path, expected, str(column_size), at)
        if column_size > packed_size * EXPANSION:
            expected = f"compressed data for {column_size} bytes"
            raise MapFormatError(self._path, expected, f"only {packed_size} bytes", at)
        return packed_size, fields

    def _ascii_batches(self, max_points: int) -> Iterator[PointBatch]:
        header = self._header
        x, y, z = (header.first_value(field) for field in header.coordinates)
        layout = RowLayout(header.value_count, (x, y, z))
        count, first_line = header.point_count, len(header.lines) + 1
        with self._path.open("rb") as stream:
            stream.seek(header.data_offset)
            yield from numbered(
                read_rows(stream, layout, count, max_points, self._path, first_line)
            )

    def _binary_batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        header = self._header
        with self._path.open("rb") as stream:
            stream.seek(header.data_offset + rows.start * header.record_size)
            for first_row in range(rows.start, rows.stop, max_points):
                count = min(max_points, rows.stop - first_row)
                data = stream.read(count * header.record_size)
                if len(data) < count * header.record_size:
                    expected, at = f"{header.point_count} points", f"byte {stream.tell()}"
                    raise MapFormatError(self._path, expected, "the end of the file", at)
                records = np.frombuffer(data, dtype=f"V{header.record_size}")
                yield self.batch_of(first_row, records)

    def _compressed_batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        count, size = self._header.point_count, self._header.point_count * sum(self._widths)
        if count == 0:
            return
        with self._path.open("rb") as stream, ColumnSpool(self._widths, count) as spool:
            stream.seek(self._header.data_offset + _SIZES.size)
            for block in decompress(stream, self._packed_size, size, self._path):
                spool.append(block.tobytes())
            for first_row in range(rows.start, rows.stop, max_points):
                records = spool.read_points(first_row, min(max_points, rows.stop - first_row))
                yield self.batch_of(first_row, records)

    def values(self, records: Any, name: str) -> NDArray[Any]:
        """Return one field of some points; see `MapReader.values`."""
        field = next(each for each in self._header.fields if each.name == name)
        if self._header.encoding == "ascii":
            rows = cast(TextRows, records)
            return rows.column(self._header.first_value(field), np.dtype(field.dtype))
        return self._field_of(records, field)

    def merged(self) -> MapReader:
        """Return what writes several such files into one; see `MapReader.merged`."""
        floats = all(field.dtype.startswith("float") for field in self._header.coordinates)
        if self._header.encoding == "ascii" or not floats:
            return super().merged()
        model = copy(self)
        model._header = self._header.without_viewpoint()
        return model

    def _field_of(self, records: NDArray[Any], field: PcdField) -> NDArray[Any]:
        """Return the first value of a field of binary records."""
        offset = sum(self._widths[: self._stored.index(field)])
        kind = np.dtype(field.dtype).newbyteorder("<")
        return np.asarray(records.getfield(kind, offset))

    def batch_of(self, first_row: int, records: NDArray[Any]) -> PointBatch:
        """Make a batch of binary records; see `MapReader.batch_of`."""
        xyz = np.empty((len(records), 3), dtype=np.float64)
        for axis, field in enumerate(self._header.coordinates):
            # A signalling NaN is no reason to warn.
            with np.errstate(invalid="ignore"):
                xyz[:, axis] = self._field_of(records, field)
        return PointBatch(first_row, xyz, records)


class _CompressedWriter(StreamWriter):
    """Collects columns of some widths in a temporary file, and compresses them in the end."""

    def __init__(
        self, path: Path, point_count: int, around: Surroundings, widths: tuple[int, ...]
    ) -> None:
        super().__init__(path, point_count, around)
        self._column_size = point_count * sum(widths)
        self._spool = ColumnSpool(widths, point_count)

    def _append(self, records: Any) -> None:
        self._spool.write_points(self.written - len(records), records)

    def _finish(self) -> None:
        with self._file, self._spool:
            sizes_at = self._file.tell()
            self._file.write(_SIZES.pack(0, 0))
            packed_size = 0
            for block in self._spool.blocks():
                packed_size += self._file.write(compress(block))
            if max(packed_size, self._column_size) >= 1 << 32:
                found = f"{packed_size} of {self._column_size}"
                raise MapFormatError(self.path, "compressed data below 4 GiB", found)
            self._file.seek(sizes_at)
            self._file.write(_SIZES.pack(packed_size, self._column_size))

    def _abandon(self) -> None:
        with self._file, self._spool:
            pass
