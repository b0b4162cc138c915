"""What every format offers: a description, a stream of batches, and a writer of its own kind.

A reader never turns a point into anything but its coordinates. The rest of the point travels in
`PointBatch.records`, exactly as the file stores it (a structured array, raw records, lines of
text), and goes back to a writer of the same kind untouched. That is how every field reaches the
output bit for bit.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from tiling.errors import PartsError, PointCountError, RowRangeError
from tiling.foreign_text import LONGEST_MESSAGE, printable
from tiling.formats.units import Units
from tiling.grid import Grid

if TYPE_CHECKING:
    from tiling.formats.extension import ExtendedFormat
    from tiling.formats.parts import PartWriter

DEFAULT_BATCH = 500_000
"""Points in a batch when the caller does not say."""

LARGEST_BATCH = 1 << 26
"""Bytes of records in a batch, however many points the caller allows."""


@dataclass(frozen=True, slots=True)
class Field:
    """One field of every point.

    Attributes
    ----------
    name : str
        As the file names it.
    dtype : str
        NumPy's name of the type, such as `"float32"`; for a field with no such type, the file's.
    count : int
        Values per point.
    """

    name: str
    dtype: str
    count: int = 1


@dataclass(frozen=True, slots=True)
class MapDescription:
    """What a map file says of itself, before any point is read.

    Attributes
    ----------
    path : Path
        The file.
    format : str
        Kind and variant for people, such as `"PCD binary_compressed"` or
        `"LAZ 1.4, point format 6"`.
    suffix : str
        File name suffix of a map written like this one, with the dot (`".laz"` for COPC).
    point_count : int
        Points in the file.
    fields : tuple of Field
        Every field, in the file's order.
    crs : str or None
        The coordinate reference system in a short form (`"EPSG:26915"`, or a name), if any.
    units : Units or None
        What the coordinates are measured in, where the file says it.
    has_classification : bool
        Whether the batches carry ASPRS classes.
    largest_class : int
        The largest class that a point can have, where they have classes.
    grid : Grid or None
        The grid that all coordinates are on (LAS).
    notes : tuple of str
        What an output of this kind cannot carry over, one plain sentence each.
    """

    path: Path
    format: str
    suffix: str
    point_count: int
    fields: tuple[Field, ...]
    crs: str | None = None
    units: Units | None = None
    has_classification: bool = False
    largest_class: int = 255
    grid: Grid | None = None
    notes: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Make what is shown to people, and comes from the file, fit for it."""
        object.__setattr__(self, "format", printable(self.format))
        object.__setattr__(
            self, "notes", tuple(printable(note, LONGEST_MESSAGE) for note in self.notes)
        )
        if self.crs is not None:
            object.__setattr__(self, "crs", printable(self.crs))


@dataclass(frozen=True, slots=True)
class PointBatch:
    """Some consecutive points of a map.

    Attributes
    ----------
    first_row : int
        Row number, in the file, of the first point.
    xyz : (n, 3) float64 array
        Coordinates, in the map's units; NaN or infinite where the file has none.
    records : opaque
        The points as the format stores them, usually an array: to be selected by `select` and
        given to a writer made by the same reader.
    classification : (n,) uint8 array or None
        ASPRS classes (LAS), where the format has them.
    withheld : (n,) bool array or None
        Points that are marked as deleted (LAS), where the format has such a mark.
    """

    first_row: int
    xyz: NDArray[np.float64]
    records: Any
    classification: NDArray[np.uint8] | None = None
    withheld: NDArray[np.bool_] | None = None

    def select(self, chosen: NDArray[np.bool_]) -> Any:
        """Return the records of the points where `chosen` is true, in order."""
        if isinstance(self.records, np.ndarray):
            # Several times as fast as indexing where a record is a row of bytes.
            return self.records.compress(chosen, axis=0)
        return self.records[chosen]

    def within(self, rows: range) -> Self | None:
        """Return the part of the batch whose row numbers lie in a range, None if there is none."""
        start = max(rows.start - self.first_row, 0)
        stop = min(rows.stop - self.first_row, len(self.xyz))
        if start >= stop:
            return None
        if (start, stop) == (0, len(self.xyz)):
            return self
        part = slice(start, stop)
        return replace(
            self,
            first_row=self.first_row + start,
            xyz=self.xyz[part],
            records=self.records[part],
            classification=None if self.classification is None else self.classification[part],
            withheld=None if self.withheld is None else self.withheld[part],
        )


class MapWriter(ABC):
    """Writes a map of a known number of points, as a stream.

    A context manager: leaving it without an error finishes the file, and refuses one that holds
    another number of points than promised.
    """

    def __init__(self, path: Path, point_count: int) -> None:
        self.path = path
        self.point_count = point_count
        self.written = 0

    def write(self, records: Any) -> None:
        """Append points, as the reader's batches hold them."""
        self.written += len(records)
        if self.written > self.point_count:
            raise PointCountError(
                f"{self.path}: opened for {self.point_count} points, given {self.written}"
            )
        if len(records):
            self._append(records)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        if kind is not None:
            self._abandon()
            return
        if self.written != self.point_count:
            self._abandon()
            raise PointCountError(
                f"{self.path}: opened for {self.point_count} points, given {self.written}"
            )
        self._finish()

    @abstractmethod
    def _append(self, records: Any) -> None:
        """Write at least one point."""

    @abstractmethod
    def _finish(self) -> None:
        """Write what follows the points, and close the file."""

    @abstractmethod
    def _abandon(self) -> None:
        """Close what is open, and leave the half-written file to the caller."""


class MapReader(ABC):
    """Reads one map file as a stream, and makes writers of maps like it.

    Making one reads and checks the header only; it holds no file open.

    Attributes
    ----------
    description : MapDescription
    threads : int
        Cores that reading, and writing by `writer`, may use at once where the format can (LAZ).
        What is read and written does not depend on it.

    Raises
    ------
    MapFormatError
        When the file is not what its format demands.
    """

    description: MapDescription
    threads: int = 1

    @property
    @abstractmethod
    def seekable(self) -> bool:
        """Whether some of the rows can be read without all rows before them.

        Then a range costs in proportion to its length.
        """

    def batches(
        self, max_points: int = DEFAULT_BATCH, rows: range | None = None
    ) -> Iterator[PointBatch]:
        """Yield points, in the file's order, at most `max_points` at a time.

        Parameters
        ----------
        max_points : int
            Points in a batch; fewer come where they take more than `LARGEST_BATCH` bytes.
        rows : range, optional
            Consecutive row numbers of the points wanted; otherwise all. What follows the last
            of them in the file is not checked, but where that is the last of all.

        Raises
        ------
        RowRangeError
            When the file has no such rows.
        MapFormatError
            When the points are not what the header announced.
        """
        description = self.description
        rows = checked_rows(str(description.path), rows, description.point_count)
        most = LARGEST_BATCH // max(self.bytes_per_point, 1)
        return self._batches(max(min(max_points, most), 1), rows)

    @abstractmethod
    def _batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        """Yield the points of a range of rows that the file has."""

    @property
    def bytes_per_point(self) -> int:
        """Bytes of a record, as far as that is known before it is read; else 0."""
        return 0

    @property
    def record_dtype(self) -> np.dtype[Any] | None:
        """The type of a row of `PointBatch.records`, where they are an array; None elsewhere."""
        return None

    def batch_of(self, first_row: int, records: NDArray[Any]) -> PointBatch:
        """Make the batch again that had these records, an array of `record_dtype`."""
        raise NotImplementedError(f"{self.description.format}: records of no fixed size")

    @abstractmethod
    def writer(self, path: Path, point_count: int) -> MapWriter:
        """Open a writer of a map of `point_count` points in this map's format, header and all."""

    @abstractmethod
    def extended(self, fields: Sequence[Field]) -> "ExtendedFormat":
        """Return what writes maps like this one whose points have further fields.

        Parameters
        ----------
        fields : sequence of Field
            Of one value each, by names that the map does not have.

        Raises
        ------
        MapFormatError
            When the map has no place for them.
        """

    @property
    def writes_parts(self) -> bool:
        """Whether several processes can write one output at once, see `part_writer`."""
        return False

    def part_writer(self, path: Path, point_count: int) -> "PartWriter":
        """Return what writes, in parts, the very file that `writer` writes as a stream.

        Raises
        ------
        PartsError
            When the format has no place for a point before those before it are written.
        """
        raise PartsError(self.description.path, self.description.format)


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


def only_rows(batches: Iterable[PointBatch], rows: range) -> Iterator[PointBatch]:
    """Take a range of rows out of consecutive batches, and ask for none after its end."""
    for batch in batches:
        part = batch.within(rows)
        if part is not None:
            yield part
        if batch.first_row + len(batch.xyz) >= rows.stop:
            return
