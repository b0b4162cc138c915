"""Parquet maps: columns x, y and z and whatever else, read and written through pyarrow."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import (
    DEFAULT_BATCH,
    Field,
    MapDescription,
    MapReader,
    MapWriter,
    PointBatch,
)
from tiling.formats.coordinates import coordinate_names
from tiling.formats.signature import SIGNATURE_LENGTH, kind_of

_ARROW_SCHEMA = b"ARROW:schema"
_GEO = b"geo"
_READ_BUFFER = 1 << 20
_LONGEST_ROW_GROUP = 1 << 20
"""Rows of a row group that the writer gathers in memory, at most."""


@dataclass(slots=True)
class TableBatch(PointBatch):
    """Points whose records are a `pyarrow.Table`."""

    def select(self, chosen: NDArray[np.bool_]) -> Any:
        """Return the rows of the table where `chosen` is true, in order."""
        return self.records.filter(pa.array(chosen))


class ParquetReader(MapReader):
    """Reads the rows of a Parquet file as points.

    All columns of any type, the schema with its metadata (pandas, GeoParquet), the compression
    of each column and the size of the row groups are those of the output too. A null coordinate
    counts as NaN and stays null.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    MapFormatError
        When it is not a Parquet file, or has no columns x, y and z of numbers.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        with _opened(path) as file:
            self._metadata = file.metadata
            stored = self._metadata.metadata or {}
            kept = {key: value for key, value in stored.items() if key != _ARROW_SCHEMA}
            self._schema = file.schema_arrow.with_metadata(kept or None)
            _check_row_groups(self._metadata, path)
        names = coordinate_names(self._schema.names)
        if names is None:
            found = ", ".join(self._schema.names[:12]) or "none"
            raise MapFormatError(path, "columns x, y and z", found, at="the schema")
        self._names = names
        for name in names:
            self._check_column(name)
        self.description = MapDescription(
            path=path,
            format=f"Parquet {self._metadata.format_version}, {self._codecs_in_words()}",
            suffix=".parquet",
            point_count=self._metadata.num_rows,
            fields=tuple(Field(field.name, str(field.type)) for field in self._schema),
            crs=_crs(stored.get(_GEO)),
        )

    def batches(self, max_points: int = DEFAULT_BATCH) -> Iterator[PointBatch]:
        """Yield every point; see `MapReader.batches`."""
        row = 0
        with _opened(self._path) as file:
            for batch in file.iter_batches(batch_size=max_points, use_threads=False):
                table = pa.Table.from_batches([batch]).cast(self._schema)
                xyz = np.empty((table.num_rows, 3))
                for column, name in enumerate(self._names):
                    xyz[:, column] = _numbers(table.column(name))
                if table.num_rows:
                    yield TableBatch(row, xyz, table)
                row += table.num_rows
        if row != self.description.point_count:
            expected = f"{self.description.point_count} rows, as the footer says"
            raise MapFormatError(self._path, expected, f"{row}", at="the end")

    def writer(self, path: Path, point_count: int) -> MapWriter:
        """Open a writer of a table like this one; see `MapReader.writer`."""
        return _ParquetWriter(path, point_count, self._schema, self._metadata)

    def _check_column(self, name: str) -> None:
        if self._schema.names.count(name) != 1:
            raise MapFormatError(self._path, f"one column {name}", "several", at="the schema")
        kind = self._schema.field(name).type
        if not (pa.types.is_integer(kind) or pa.types.is_floating(kind)):
            raise MapFormatError(
                self._path, f"numbers in column {name}", f"type {kind}", at="the schema"
            )

    def _codecs_in_words(self) -> str:
        codecs = sorted(set(_codecs(self._metadata).values()))
        return ", ".join(codec.lower() for codec in codecs) or "no row groups"


class _ParquetWriter(MapWriter):
    """Gathers points into row groups of the size the source has."""

    def __init__(
        self, path: Path, point_count: int, schema: pa.Schema, metadata: pq.FileMetaData
    ) -> None:
        super().__init__(path, point_count)
        groups = [metadata.row_group(n).num_rows for n in range(metadata.num_row_groups)]
        self._group_rows = min(max(groups, default=0) or _LONGEST_ROW_GROUP, _LONGEST_ROW_GROUP)
        self._schema = schema
        self._gathered: list[pa.Table] = []
        self._rows = 0
        columns = [metadata.schema.column(n) for n in range(metadata.num_columns)]
        self._writer = pq.ParquetWriter(
            path,
            schema,
            # Older versions cannot hold nanoseconds or unsigned 32-bit integers as such.
            version="2.6",
            compression=_writable_codecs(metadata) or "snappy",
            use_deprecated_int96_timestamps=any(c.physical_type == "INT96" for c in columns),
            store_schema=_ARROW_SCHEMA in (metadata.metadata or {}),
        )

    def _append(self, records: Any) -> None:
        self._gathered.append(records)
        self._rows += records.num_rows
        if self._rows >= self._group_rows:
            self._write_groups(self._rows - self._rows % self._group_rows)

    def _finish(self) -> None:
        self._write_groups(self._rows)
        self._writer.close()

    def _abandon(self) -> None:
        self._gathered = []
        self._writer.close()

    def _write_groups(self, rows: int) -> None:
        """Write that many of the rows gathered."""
        if not rows:
            return
        table = pa.concat_tables(self._gathered).unify_dictionaries()
        self._writer.write_table(table.slice(0, rows), row_group_size=self._group_rows)
        rest = table.slice(rows)
        self._gathered = [rest] if rest.num_rows else []
        self._rows = rest.num_rows


@contextmanager
def _opened(path: Path) -> Iterator[pq.ParquetFile]:
    """Open a Parquet file, and turn what is wrong with it into a `MapFormatError`."""
    with path.open("rb") as raw:
        start = raw.read(SIGNATURE_LENGTH)
        if not start.startswith(b"PAR1"):
            raise MapFormatError(path, "a Parquet file", kind_of(start), at="byte 0")
        size = raw.seek(0, 2)
        raw.seek(max(size - 4, 0))
        if size < 12 or raw.read(4) != b"PAR1":
            expected = "PAR1 at the end of a whole Parquet file"
            raise MapFormatError(path, expected, "other bytes", at=f"byte {max(size - 4, 0)}")
    try:
        with pq.ParquetFile(
            path,
            buffer_size=_READ_BUFFER,
            pre_buffer=False,
            page_checksum_verification=True,
        ) as file:
            yield file
    # pyarrow reports a corrupt file as any of these; one that cannot be read at all was met above.
    except (pa.ArrowException, OSError, ValueError, KeyError, TypeError, MemoryError) as error:
        found = " ".join(str(error).split())[:200] or type(error).__name__
        raise MapFormatError(path, "a whole Parquet file", found) from error


def _check_row_groups(metadata: pq.FileMetaData, path: Path) -> None:
    """Compare what the footer says of the row groups with the file."""
    size = path.stat().st_size
    rows = 0
    for number in range(metadata.num_row_groups):
        group = metadata.row_group(number)
        rows += group.num_rows
        for column in range(group.num_columns):
            chunk = group.column(column)
            start = chunk.data_page_offset
            if chunk.has_dictionary_page and chunk.dictionary_page_offset:
                start = min(start, chunk.dictionary_page_offset)
            end = start + chunk.total_compressed_size
            if not 0 <= start <= end <= size:
                expected = f"column {chunk.path_in_schema} of row group {number} within the file"
                raise MapFormatError(path, expected, f"bytes {start} to {end} of {size}")
    if rows != metadata.num_rows or rows < 0:
        expected = f"{metadata.num_rows} rows in the row groups, as the footer says"
        raise MapFormatError(path, expected, f"{rows}", at="the footer")


def _codecs(metadata: pq.FileMetaData) -> dict[str, str]:
    """Return the compression of each column, by its path, from the first row group."""
    if not metadata.num_row_groups:
        return {}
    group = metadata.row_group(0)
    chunks = [group.column(number) for number in range(group.num_columns)]
    return {chunk.path_in_schema: chunk.compression for chunk in chunks}


def _writable_codecs(metadata: pq.FileMetaData) -> dict[str, str]:
    """Return the same, with Snappy in place of a codec that cannot be written."""
    codecs = {}
    for path, codec in _codecs(metadata).items():
        known = codec == "UNCOMPRESSED" or pa.Codec.is_available(codec.lower())
        codecs[path] = codec.replace("UNCOMPRESSED", "NONE") if known else "SNAPPY"
    return codecs


def _numbers(column: pa.ChunkedArray) -> NDArray[np.float64]:
    """Return a column as float64, null as NaN."""
    values: NDArray[np.float64] = column.cast(pa.float64(), safe=False).to_numpy()
    return values


def _crs(geo: bytes | None) -> str | None:
    """Return the coordinate reference system of GeoParquet metadata in a short form."""
    try:
        described = json.loads(geo or b"{}")
        column = described["columns"][described["primary_column"]]
        crs = column.get("crs", {"id": {"authority": "OGC", "code": "CRS84"}})
        if "id" in crs:
            return f"{crs['id']['authority']}:{crs['id']['code']}"
        return str(crs["name"])
    except (ValueError, LookupError, TypeError, RecursionError):
        return None
