"""Parquet maps: tables of points and whatever else, read and written through pyarrow."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import accumulate
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import MapReader, MapWriter
from tiling.formats.checks import check_signature
from tiling.formats.parquet_pages import check_pages, find_chunks
from tiling.formats.parquet_tables import find_points, geometry_column, open_parquet
from tiling.formats.points import Field, MapDescription, PointBatch, only_rows
from tiling.output_file import create_file

_ARROW_SCHEMA = b"ARROW:schema"
_GEO = b"geo"
_READ_BUFFER = 1 << 20
_LONGEST_ROW_GROUP = 1 << 20
"""Rows of a row group that the writer gathers in memory, at most."""
_LARGEST_ROW_GROUP = 1 << 28
"""Their bytes, at most."""
_VALUE_BYTES = 8
"""Of a value in memory, at least, where repetitions are stored as such."""


@dataclass(frozen=True, slots=True)
class _Layout:
    """How the rows of a file lie in it."""

    codecs: dict[str, str]
    """Compression of each column, by its path, as pyarrow names it."""
    group_rows: int
    """Rows of the largest row group; 0 where there are none."""
    bytes_per_row: int
    """Bytes that a row takes in memory, on average; a text that is stored once counts once."""
    options: dict[str, bool]
    """Of `pyarrow.parquet.ParquetWriter`."""

    @classmethod
    def of(cls, file: pq.ParquetFile, path: Path) -> "_Layout":
        metadata = file.metadata
        columns = [metadata.schema.column(number) for number in range(metadata.num_columns)]
        groups = range(metadata.num_row_groups)
        # A corrupt column chunk makes pyarrow end the process when it is asked about, and raise
        # an error when it is read: so a row is read first.
        next(file.iter_batches(batch_size=1, row_groups=list(groups[:1]), use_threads=False), None)
        rows = [metadata.row_group(number).num_rows for number in groups]
        if sum(rows) != metadata.num_rows or min(rows, default=0) < 0:
            expected = f"{metadata.num_rows} rows in the row groups, as the footer says"
            raise MapFormatError(path, expected, f"{sum(rows)}", at="the footer")
        codecs, values = {}, 0
        for group in groups[:1]:
            for number in range(metadata.num_columns):
                chunk = metadata.row_group(group).column(number)
                codecs[chunk.path_in_schema] = chunk.compression
                values += chunk.num_values
        stored = sum(metadata.row_group(number).total_byte_size for number in groups)
        return cls(
            codecs=codecs,
            group_rows=max(rows, default=0),
            bytes_per_row=max(
                stored // max(metadata.num_rows, 1), _VALUE_BYTES * values // max([1, *rows[:1]])
            ),
            options={
                # Time stamps in the form of 96 bits that Spark and Impala used to write.
                "use_deprecated_int96_timestamps": any(c.physical_type == "INT96" for c in columns),
                "store_schema": _ARROW_SCHEMA in (metadata.metadata or {}),
                # What is in a list is called `element`; older writers said `item`.
                "use_compliant_nested_type": not any(".list.item" in c.path for c in columns),
            },
        )


class ParquetReader(MapReader):
    """Reads the rows of a Parquet file as points.

    All columns of any type, the schema with its metadata (pandas, GeoParquet), the compression
    of each column and the size of the row groups are those of the output too. A null coordinate
    counts as NaN and stays null.
    """

    sets_values = True

    def __init__(self, path: Path) -> None:
        self._path = path
        _check_signature(path)
        with _opened(path) as file:
            stored = file.metadata.metadata or {}
            kept = {key: value for key, value in stored.items() if key != _ARROW_SCHEMA}
            self._schema = file.schema_arrow.with_metadata(kept or None)
            self._chunks = find_chunks(path)
            check_pages(path, self._chunks[0] if self._chunks else [])
            self._layout = _Layout.of(file, path)
            version, point_count = file.metadata.format_version, file.metadata.num_rows
        take_points = find_points(self._schema, stored.get(_GEO), path)
        if take_points is None:
            found = ", ".join(self._schema.names[:12]) or "none"
            found = f"{point_count} rows of {len(self._schema)} columns: {found}"
            raise MapFormatError(path, "columns x, y and z", found, at="the schema")
        self._take_points = take_points
        self.bytes_per_point = self._layout.bytes_per_row
        # A range is read by row groups.
        self.seekable = self._layout.group_rows <= _LONGEST_ROW_GROUP
        codecs = sorted({codec.lower() for codec in self._layout.codecs.values()})
        self.description = MapDescription(
            path=path,
            format=f"Parquet {version}, {', '.join(codecs) or 'no row groups'}",
            suffix=".parquet",
            point_count=point_count,
            fields=tuple(Field(each.name, _type_name(each.type)) for each in self._schema),
            crs=_crs(stored.get(_GEO)),
        )

    def _batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        with _opened(self._path) as file:
            metadata = file.metadata
            sizes = [metadata.row_group(n).num_rows for n in range(metadata.num_row_groups)]
            starts = list(accumulate(sizes, initial=0))
            groups = [
                n
                for n, size in enumerate(sizes)
                if starts[n] < rows.stop and starts[n] + size > rows.start
            ]
            if groups:
                for group in self._chunks[groups[0] : groups[-1] + 1]:
                    check_pages(self._path, group)
                batches = self._group_batches(file, groups, starts[groups[0]], max_points)
                yield from only_rows(batches, rows)

    def _group_batches(
        self, file: pq.ParquetFile, groups: list[int], row: int, max_points: int
    ) -> Iterator[PointBatch]:
        """Yield the points of consecutive row groups, the first of which is in `row`."""
        last = row + sum(file.metadata.row_group(group).num_rows for group in groups)
        for batch in file.iter_batches(batch_size=max_points, row_groups=groups, use_threads=False):
            table = pa.Table.from_batches([batch])
            yield PointBatch(row, self._take_points(table), table)
            row += table.num_rows
        if row != last:
            expected = f"{last} rows, as the footer says"
            raise MapFormatError(self._path, expected, f"{row}", at="the end")

    def values(self, records: Any, name: str) -> NDArray[Any]:
        """Return one column of some rows, nulls as NaN; see `MapReader.values`."""
        return np.asarray(records.column(name).to_numpy())

    def with_values(self, records: pa.Table, values: Mapping[str, NDArray[Any]]) -> pa.Table:
        """Return rows with other values, null where a null has none; see `MapReader`."""
        for name, column in values.items():
            at = records.schema.get_field_index(name)
            none = np.asarray(records.column(name).is_null()) & np.isnan(column)
            array = pa.array(column, records.schema.field(at).type, mask=none)
            records = records.set_column(at, records.schema.field(at), array)
        return records

    def _stream_writer(self, path: Path, point_count: int) -> MapWriter:
        return _ParquetWriter(path, point_count, self._schema, self._layout)

    def _take_further(self) -> None:
        for field in self.further:
            kind = pa.from_numpy_dtype(np.dtype(field.dtype))
            self._schema = self._schema.append(pa.field(field.name, kind))
        codec = next(iter(self._layout.codecs.values()), "SNAPPY")
        further = dict.fromkeys((field.name for field in self.further), codec)
        self._layout = replace(self._layout, codecs=self._layout.codecs | further)

    def extend(self, batch: PointBatch, values: Sequence[NDArray[Any]]) -> pa.Table:
        """Return the rows with further columns; see `MapReader.extend`."""
        table = batch.records
        for field, column in zip(self.further, values, strict=True):
            table = table.append_column(field.name, pa.array(column.astype(field.dtype)))
        return table


class _ParquetWriter(MapWriter):
    """Gathers points into row groups of the size the source has."""

    def __init__(self, path: Path, point_count: int, schema: pa.Schema, layout: _Layout) -> None:
        super().__init__(path, point_count)
        self._group_rows = min(layout.group_rows or _LONGEST_ROW_GROUP, _LONGEST_ROW_GROUP)
        self._schema = schema
        self._gathered: list[pa.Table] = []
        self._rows = self._bytes = 0
        self._file: BinaryIO = create_file(path)
        codecs = {
            column: "NONE" if codec == "UNCOMPRESSED" else codec
            for column, codec in layout.codecs.items()
        }
        self._writer = pq.ParquetWriter(
            self._file,
            schema,
            # Older versions cannot hold nanoseconds or unsigned 32-bit integers as such.
            version="2.6",
            compression=codecs or "snappy",
            **layout.options,
        )

    def _append(self, records: Any) -> None:
        self._gathered.append(records)
        self._rows += records.num_rows
        self._bytes += records.nbytes
        if self._bytes > _LARGEST_ROW_GROUP:
            self._write_groups(self._rows)
        elif self._rows >= self._group_rows:
            self._write_groups(self._rows - self._rows % self._group_rows)

    def _finish(self) -> None:
        with self._file:
            self._write_groups(self._rows)
            self._writer.close()

    def _abandon(self) -> None:
        self._gathered = []
        with self._file:
            self._writer.close()

    def _write_groups(self, rows: int) -> None:
        if not rows:
            return
        table = pa.concat_tables(self._gathered).unify_dictionaries()
        try:
            self._writer.write_table(table.slice(0, rows), row_group_size=self._group_rows)
        except pa.ArrowNotImplementedError as error:  # such as null among lists of one length
            expected = f"columns that pyarrow {pa.__version__} can write"
            raise MapFormatError(self.path, expected, str(error)) from error
        rest = table.slice(rows)
        self._gathered = [rest] if rest.num_rows else []
        self._rows, self._bytes = rest.num_rows, rest.nbytes


@contextmanager
def _opened(path: Path) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file, and turn what is wrong with it into a `MapFormatError`."""
    options = {"buffer_size": _READ_BUFFER, "pre_buffer": False, "page_checksum_verification": True}
    try:
        with open_parquet(path, **options) as file:
            yield file
    # pyarrow reports a corrupt file as any of these; one that cannot be read at all was met before.
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:
        if isinstance(error, OSError) and error.errno:
            raise  # from the operating system, not about what the file holds
        found = " ".join(str(error).split())[:200] or type(error).__name__
        raise MapFormatError(path, "a whole Parquet file", found) from error


def _check_signature(path: Path) -> None:
    """Check how the file begins and ends."""
    check_signature(path, b"PAR1", "a Parquet file")
    with path.open("rb") as raw:
        size = raw.seek(0, 2)
        raw.seek(max(size - 4, 0))
        if size < 12 or raw.read(4) != b"PAR1":
            expected = "PAR1 at the end of a whole Parquet file"
            raise MapFormatError(path, expected, "other bytes", at=f"byte {max(size - 4, 0)}")


def _type_name(kind: pa.DataType) -> str:
    """Return NumPy's name of a type of numbers, and Arrow's of any other."""
    name = " ".join(str(kind).split())
    return {"halffloat": "float16", "float": "float32", "double": "float64"}.get(name, name)


def _crs(geo: bytes | None) -> str | None:
    """Return the coordinate reference system of GeoParquet metadata in a short form."""
    name, column = geometry_column(geo)
    if name is None:
        return None
    try:
        crs = column.get("crs", {"id": {"authority": "OGC", "code": "CRS84"}})
        if "id" in crs:
            return f"{crs['id']['authority']}:{crs['id']['code']}"
        return str(crs["name"])
    except (LookupError, TypeError):
        return None
