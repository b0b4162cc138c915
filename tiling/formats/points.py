"""Points on their way from a reader to whoever asks for them."""

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from tiling.errors import RowRangeError
from tiling.foreign_text import LONGEST_MESSAGE, printable
from tiling.formats.units import Units
from tiling.grid import Grid

if TYPE_CHECKING:
    from tiling.formats.text_rows import TextRows  # compiled: takes long to import

DEFAULT_BATCH = 500_000
"""Points in a batch when the caller does not say."""

COORDINATES = ("x", "y", "z")


@dataclass(frozen=True, slots=True)
class Field:
    """One field of every point."""

    name: str
    """As the file names it."""
    dtype: str
    """NumPy's name of the type, such as `"float32"`; for a field with no such type, the file's."""
    count: int = 1
    """Values per point."""


@dataclass(frozen=True, slots=True)
class MapDescription:
    """What a map file says of itself, before any point is read."""

    path: Path
    format: str
    """Kind and variant for people, such as `"PCD binary_compressed"` or
    `"LAZ 1.4, point format 6"`."""
    suffix: str
    """File name suffix of a map written like this one, with the dot (`".laz"` for COPC)."""
    point_count: int
    fields: tuple[Field, ...]
    """Every field, in the file's order."""
    crs: str | None = None
    """The coordinate reference system in a short form (`"EPSG:26915"`, or a name), if any."""
    units: Units | None = None
    """What the coordinates are measured in, where the file says it."""
    has_classification: bool = False
    """Whether the batches carry ASPRS classes."""
    largest_class: int = 255
    """The largest class that a point can have, where they have classes."""
    grid: Grid | None = None
    """The grid that all coordinates are on (LAS)."""
    notes: tuple[str, ...] = ()
    """What an output of this kind cannot carry over, one plain sentence each."""
    viewpoint: tuple[float, ...] | None = None
    """Where the sensor was, 3 numbers, and its quaternion, w first, where the file says it."""
    scans: tuple[tuple[int, tuple[float, ...]], ...] = ()
    """Points of each scan, and its pose in the map, 12 numbers row by row, where the file keeps
    scans apart (E57)."""

    def __post_init__(self) -> None:
        """Make what is shown to people, and comes from the file, fit for it."""
        notes = tuple(printable(note, LONGEST_MESSAGE) for note in self.notes)
        object.__setattr__(self, "format", printable(self.format))
        object.__setattr__(self, "notes", notes)
        if self.crs is not None:
            object.__setattr__(self, "crs", printable(self.crs))


@dataclass(frozen=True, slots=True)
class PointBatch:
    """Some consecutive points of a map."""

    first_row: int
    """Row number, in the file, of the first point."""
    xyz: NDArray[np.float64]
    """(n, 3): coordinates, in the map's units; NaN or infinite where the file has none."""
    records: Any
    """The points as the format stores them, usually an array: to be selected by `select` and given
    to a writer made by the same reader."""
    classification: NDArray[np.uint8] | None = None
    """(n,): ASPRS classes (LAS), where the format has them."""
    withheld: NDArray[np.bool_] | None = None
    """(n,): points that are marked as deleted (LAS), where the format has such a mark."""

    def select(self, chosen: NDArray[np.bool_]) -> Any:
        """Return the records of the points where `chosen` is true, in order."""
        if isinstance(self.records, np.ndarray):
            # Several times as fast as indexing where a record is a row of bytes.
            return self.records.compress(chosen, axis=0)
        is_table = hasattr(self.records, "filter")
        return self.records.filter(chosen) if is_table else self.records[chosen]

    def within(self, rows: range) -> Self | None:
        """Return the part of the batch whose row numbers lie in a range, None if there is none."""
        start = max(rows.start - self.first_row, 0)
        stop = min(rows.stop - self.first_row, len(self.xyz))
        if start >= stop:
            return None
        if (start, stop) == (0, len(self.xyz)):
            return self
        part = slice(start, stop)
        return type(self)(
            self.first_row + start,
            self.xyz[part],
            self.records[part],
            None if self.classification is None else self.classification[part],
            None if self.withheld is None else self.withheld[part],
        )


def only_finite(xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points, of (n, 3), whose coordinates are all finite: a view where all are."""
    if not len(xyz) or np.isfinite([xyz.min(), xyz.max()]).all():
        return xyz
    return xyz[np.isfinite(xyz).all(axis=1)]


def checked_rows(name: str, rows: range | None, point_count: int) -> range:
    """Return consecutive rows that a map has: those given, or all.

    Raises
    ------
    RowRangeError
        When the map has no such rows.
    """
    if rows is None:
        return range(point_count)
    if rows.step != 1 or not 0 <= rows.start <= rows.stop <= point_count:
        raise RowRangeError(name, rows, point_count)
    return rows


def numbered(parts: Iterable[tuple[Any, NDArray[np.float64]]]) -> Iterator[PointBatch]:
    """Yield batches of a file's points, which come as records and their coordinates."""
    first_row = 0
    for records, xyz in parts:
        yield PointBatch(first_row, xyz, records)
        first_row += len(xyz)


def only_rows(batches: Iterable[PointBatch], rows: range) -> Iterator[PointBatch]:
    """Take a range of rows out of consecutive batches, and ask for none after its end."""
    for batch in batches:
        part = batch.within(rows)
        if part is not None:
            yield part
        if batch.first_row + len(batch.xyz) >= rows.stop:
            return


def coordinate_names(names: Collection[str]) -> tuple[str, str, str] | None:
    """Return which of all fields hold the coordinates: x, y and z, else X, Y and Z, else None."""
    for x, y, z in (COORDINATES, ("X", "Y", "Z")):
        if x in names and y in names and z in names:
            return x, y, z
    return None


def longer_records(
    records: "NDArray[Any] | TextRows",
    fields: Sequence[Field],
    values: Sequence[NDArray[Any]],
    byte_order: str,
) -> "NDArray[Any] | TextRows":
    """Put values behind lines of text, or behind packed bytes in the file's byte order."""
    if not isinstance(records, np.ndarray):
        return longer_rows(records, fields, values)
    tail = packed(fields, values, byte_order)
    if records.dtype != object:
        return joined(records, tail)
    longer = np.empty(len(tail), dtype=object)  # records of no fixed size, as bytes
    longer[:] = [head + more.tobytes() for head, more in zip(records, tail, strict=True)]
    return longer


def longer_rows(
    rows: "TextRows",
    fields: Sequence[Field],
    values: Sequence[NDArray[Any]],
    separator: bytes = b" ",
) -> "TextRows":
    """Put values on the lines of text, in as many digits as tell them from others."""
    columns = [
        column.astype(field.dtype).tolist() for field, column in zip(fields, values, strict=True)
    ]
    words = [
        separator.join(repr(value).encode() for value in row) for row in zip(*columns, strict=True)
    ]
    return rows.with_words(words, separator)


def packed(
    fields: Sequence[Field], values: Sequence[NDArray[Any]], byte_order: str = "<"
) -> NDArray[Any]:
    """Pack values of some fields into records of their own, (n,)."""
    dtype = np.dtype([(field.name, byte_order + np.dtype(field.dtype).str[1:]) for field in fields])
    records = np.empty(len(values[0]), dtype=dtype)
    for field, column in zip(fields, values, strict=True):
        records[field.name] = column
    return records


def joined(head: NDArray[Any], tail: NDArray[Any]) -> NDArray[np.void]:
    """Put the bytes of each of some records before those of the record beside it, (n,)."""
    rows = np.hstack([bytes_of(head), bytes_of(tail)])
    return rows.view(f"V{rows.shape[1]}")[:, 0]


def bytes_of(records: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the bytes of records, (n, size)."""
    size = records.dtype.itemsize
    return np.ascontiguousarray(records).view(np.uint8).reshape(len(records), size)


def row_digests(records: Any) -> list[bytes]:
    """Return a digest of each record, so that points of two files can be told to be the same.

    Records, of any format, are compared as the files store them, all fields to the last bit; rows
    of text without their line ends, since the last row of a file may have none.
    """
    return [blake2b(row, digest_size=16).digest() for row in _rows(records)]


def _rows(records: Any) -> Iterable[bytes]:
    if isinstance(records, np.ndarray):
        return _of_array(records)
    if hasattr(records, "starts"):  # rows of text
        return (row.rstrip() for row in records)
    if hasattr(records, "scan"):
        return (b"%d " % records.scan + row for row in _of_array(records.rows))
    columns = [_exact(column).to_pylist() for column in records.columns]
    return (repr(row).encode("utf-8", "surrogatepass") for row in zip(*columns, strict=True))


def _of_array(records: NDArray[Any]) -> Iterable[bytes]:
    if records.dtype == object:
        return list(records)
    content, size = records.tobytes(), records.nbytes // max(len(records), 1)
    return (content[at : at + size] for at in range(0, len(content), size or 1))


def _exact(column: Any) -> Any:
    """Return a column whose values Python has in full: its times have no nanoseconds."""
    import pyarrow as pa  # noqa: PLC0415 - heavy, and here for tables only

    if pa.types.is_temporal(column.type) and not pa.types.is_interval(column.type):
        wide = column.type.bit_width == 64
        return column.cast(pa.int64() if wide else pa.int32())
    return column
