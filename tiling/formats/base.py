"""What every format offers: a description, a stream of batches, and a writer of its own kind.

A reader never turns a point into anything but its coordinates. The rest of the point travels in
`PointBatch.records`, exactly as the file stores it (a structured array, raw records, lines of
text), and goes back to a writer of the same kind untouched. That is how every field reaches the
output bit for bit.
"""

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from copy import copy
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError, PartsError, PointCountError
from tiling.formats.parts import MapPart, PartWriter, Surroundings
from tiling.formats.points import (
    DEFAULT_BATCH,
    Field,
    MapDescription,
    PointBatch,
    checked_rows,
    coordinate_names,
    longer_records,
)
from tiling.output_file import create_file

LARGEST_BATCH = 1 << 26
"""Bytes of records in a batch, however many points the caller allows."""


class MapWriter(ABC):
    """Writes a map of a known number of points, as a stream.

    A context manager: leaving it without an error finishes the file, and refuses one that holds
    another number of points than promised.
    """

    _file: BinaryIO | MapPart

    def __init__(self, path: Path, point_count: int) -> None:
        self.path = path
        self.point_count = point_count
        self.written = 0

    def write(self, records: Any) -> None:
        """Append points, as the reader's batches hold them."""
        self.written += len(records)
        if self.written > self.point_count:
            raise self._wrong_count()
        if len(records):
            self._append(records)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is not None:
            self._abandon()
            return
        if self.written != self.point_count:
            self._abandon()
            raise self._wrong_count()
        self._finish()

    def _wrong_count(self) -> PointCountError:
        return PointCountError(
            f"{self.path}: opened for {self.point_count} points, given {self.written}"
        )

    @abstractmethod
    def _append(self, records: Any) -> None:
        """Write at least one point."""

    @abstractmethod
    def _finish(self) -> None:
        """Write what follows the points, and close the file."""

    def _abandon(self) -> None:
        """Close what is open, and leave the half-written file to the caller."""
        self._file.close()


class SinglePartWriter(MapWriter):
    """Writes a map in one part."""

    def __init__(self, parts: PartWriter) -> None:
        super().__init__(parts.path, parts.point_count)
        parts.create()
        self._parts = parts
        self._file: MapPart = parts.open_part(0)

    def _append(self, records: Any) -> None:
        self._file.write(records)

    def _finish(self) -> None:
        self._file.close()
        self._parts.finish([self._file.summary])


class MapReader(ABC):
    """Reads one map file as a stream, and makes writers of maps like it.

    Making one reads and checks the header only; it holds no file open.

    Raises
    ------
    MapFormatError
        When the file is not what its format demands.
    """

    description: MapDescription
    threads: int = 1
    """Cores that reading, and writing by `writer`, may use at once where the format can (LAZ). What
    is read and written does not depend on it."""
    bytes_per_point: int = 0
    """Bytes of a record, or of the shortest, as far as that is known before it is read."""
    record_dtype: np.dtype[Any] | None = None
    """The type of a row of `PointBatch.records` that `batch_of` takes; None where it takes none."""
    seekable: bool
    """Whether some of the rows can be read without all rows before them."""
    sets_values: bool = False
    """Whether `with_values` can be asked; rows of text stay as they were written."""
    writes_parts: bool = False
    """Whether several processes can write one output at once, see `part_writer`."""
    further: tuple[Field, ...] = ()
    """Fields that `extend` puts behind those of the file."""
    _byte_order: str = "<"

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

    def batch_of(self, first_row: int, records: NDArray[Any]) -> PointBatch:
        """Make the batch again that had these records, an array of `record_dtype`."""
        raise NotImplementedError(f"{self.description.format}: records of no fixed size")

    def values(self, records: Any, name: str) -> NDArray[Any]:
        """Return a field with one value a point, (n,), of records of this reader, as stored.

        Raises
        ------
        MapFormatError
            When the fields of this map cannot be read apart.
        """
        raise self._refused("a map whose fields can be read apart")

    def with_values(self, records: Any, values: Mapping[str, NDArray[Any]]) -> Any:
        """Return records of this reader with other values, (n,), by names that `values` takes."""
        records = records.copy()
        with np.errstate(over="ignore", invalid="ignore"):
            for name, column in values.items():
                self.values(records, name)[:] = column
        return records

    def merged(self) -> "MapReader":
        """Return what writes the points of several maps like this one into one, in one frame.

        Raises
        ------
        MapFormatError
            When maps of this format have more to agree on than their fields.
        """
        raise self._refused("PCD in binary, npy or KITTI's, to be merged")

    def moved(self, records: NDArray[Any], xyz: NDArray[np.float64]) -> NDArray[Any]:
        """Return the records of points with other coordinates, (n, 3); see `merged`."""
        names = coordinate_names([field.name for field in self.description.fields])
        assert names is not None  # of what can be merged
        moved: NDArray[Any] = self.with_values(records, dict(zip(names, xyz.T, strict=True)))
        return moved

    def writer(self, path: Path, point_count: int) -> MapWriter:
        """Open a writer of a map of `point_count` points in this map's format, header and all."""
        if self.writes_parts:
            return SinglePartWriter(self._part_writer(path, point_count))
        return self._stream_writer(path, point_count)

    def _stream_writer(self, path: Path, point_count: int) -> MapWriter:
        raise NotImplementedError

    def _part_writer(self, path: Path, point_count: int) -> PartWriter:
        raise NotImplementedError

    def extended(self, fields: Sequence[Field]) -> "MapReader":
        """Return what makes and writes points like this map's that have further fields.

        Nothing is read from it. What a point had stays as it was stored; new values stand behind
        it, of the types that the format has.

        Parameters
        ----------
        fields : sequence of Field
            Of one value each, by names that the map does not have.

        Raises
        ------
        MapFormatError
            When the map has no place for them.
        """
        model = copy(self)
        model.further = tuple(fields)
        model._take_further()
        return model

    def _refused(self, expected: str) -> MapFormatError:
        return MapFormatError(self.description.path, expected, self.description.format)

    @abstractmethod
    def _take_further(self) -> None:
        """Make the header, or the schema, that of points which have the `further` fields too."""

    def extend(self, batch: PointBatch, values: Sequence[NDArray[Any]]) -> Any:
        """Return the records of a batch of the map that was extended, with further values.

        They are (n,) arrays, one for each of `further`.
        """
        return longer_records(batch.records, self.further, values, self._byte_order)

    def with_classes(self, records: Any, classification: NDArray[np.uint8]) -> Any:
        """Return extended records with these classes, (n,), where the format has any."""
        del classification
        return records

    def part_writer(self, path: Path, point_count: int) -> PartWriter:
        """Return what writes, in parts, the very file that `writer` writes as a stream.

        Raises
        ------
        PartsError
            When the format has no place for a point before those before it are written.
        """
        if not self.writes_parts:
            raise PartsError(self.description.path, self.description.format)
        return self._part_writer(path, point_count)


class StreamWriter(MapWriter):
    """Writes a new file from its beginning to its end, with what surrounds the points."""

    _file: BinaryIO

    def __init__(self, path: Path, point_count: int, around: Surroundings) -> None:
        super().__init__(path, point_count)
        self._around = around
        self._file = create_file(path)
        around.write_before(self._file)

    def _finish(self) -> None:
        self._around.write_after(self._file)
        self._file.close()


class TextWriter(StreamWriter):
    """Writes rows as they stood in the file they come from, after what stands before them there."""

    _ended = True

    def _append(self, records: Any) -> None:
        text = records.tobytes()
        if not self._ended:
            self._file.write(b"\n")
        self._file.write(text)
        # The last row of a file may have no line ending.
        self._ended = text.endswith(b"\n")
