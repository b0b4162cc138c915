"""One output file that several processes write at once, each a range of its points.

That takes records of one size: each point then has its place in the file as soon as it is known
how many points come before it. The bytes are those that one process writes, since that one
writes a single part.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from io import SEEK_END
from pathlib import Path
from typing import Any, BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from tiling.errors import PointCountError
from tiling.formats.checks import read_blocks
from tiling.output_file import create_shared, sync, write_only

Spans = Sequence[tuple[int, int]]


@dataclass(slots=True)
class PartSummary:
    """Which points of an output a part holds, and what the end of the writing must know of them.

    Small, and made to be sent from one process to another.
    """

    first: int
    """Row number, in the output, of its first point."""
    count: int = 0

    def add(self, records: Any) -> None:
        """Take at least one more point into account."""
        self.count += len(records)

    def to_json(self) -> dict[str, Any]:
        """Return what `restore` reads, of the types of JSON."""
        return {"first": self.first, "count": self.count}

    def restore(self, kept: Any) -> None:
        """Take over what `to_json` returned of another summary of the same output.

        Raises
        ------
        ValueError
            When it is anything else, as a file may be that somebody else wrote.
        """
        first, count = integers([member(kept, "first"), member(kept, "count")], 2)
        if first != self.first:
            raise ValueError(f"expected the summary of a part from {self.first}, found {first}")
        self.count = count


@dataclass(slots=True)
class Surroundings:
    """What stands before and after the points of an output.

    Before them are a head and bytes of another file, after them bytes of the same: spans, each from
    a byte to one before the end. That file must still be there when they are written.
    """

    head: bytes
    source: Path = Path()
    before: Spans = ()
    after: Spans = ()

    @property
    def points_offset(self) -> int:
        """Byte of the first point."""
        return len(self.head) + sum(end - start for start, end in self.before)

    def write_before(self, file: BinaryIO) -> None:
        """Write what is before the points."""
        file.write(self.head)
        _copy_spans(self.source, file, self.before)

    def write_after(self, file: BinaryIO) -> None:
        """Write what is after the points, at the end of which the file stands."""
        _copy_spans(self.source, file, self.after)


@dataclass
class PartWriter:
    """Writes a map of a known number of points in parts, in any order and from any process.

    One process calls `create`; then each writes its parts; and when all are written, one process
    calls `finish` with the summaries of all. The object remembers nothing of these calls: each may
    be made on another that was made alike.
    """

    path: Path
    point_count: int
    around: Surroundings
    record_size: int

    def create(self) -> None:
        """Write all but the points, and give the file its full size."""
        with create_shared(self.path) as file:
            self.around.write_before(file)
            file.truncate(self._start_of(self.point_count))
            file.seek(0, SEEK_END)
            self.around.write_after(file)

    def open_part(self, first: int) -> "MapPart":
        """Open the file, which must have been created, to write points from a row on."""
        return MapPart(self, first)

    def finish(self, summaries: Iterable[PartSummary]) -> None:
        """Write what only all points together tell, by the summaries of all parts, in any order.

        Raises
        ------
        PointCountError
            When the parts are not all points, each once.
        """
        parts = sorted(summaries, key=lambda part: (part.first, part.count))
        row = 0
        for part in parts:
            if part.first != row:
                raise PointCountError(
                    f"{self.path}: expected a part that begins with point {row}, "
                    f"found one that begins with {part.first}"
                )
            row += part.count
        if row != self.point_count:
            raise self.wrong_count(row)
        header = self._completed_header(parts)
        if header is not None:
            with write_only(self.path) as file:
                file.write(header)

    def wrong_count(self, given: int) -> PointCountError:
        """Return the error of another number of points than promised."""
        return PointCountError(f"{self.path}: created for {self.point_count} points, given {given}")

    def new_summary(self, first: int) -> PartSummary:
        """Return the summary of a part that has no points yet."""
        return PartSummary(first)

    def put(self, file: BinaryIO, first: int, records: NDArray[Any]) -> None:
        """Write records to their places, the first of them being that of point `first`."""
        put_records(file, self._start_of(first), records)

    def _start_of(self, row: int) -> int:
        return self.around.points_offset + row * self.record_size

    def _completed_header(self, parts: Sequence[PartSummary]) -> bytes | None:
        """Return how the file begins, where that takes knowledge of all points."""
        return None


class MapPart:
    """Some consecutive points of an output, from its row `first` on, written as a stream.

    A context manager that closes the file. `summary` is whole when all points are written.
    """

    def __init__(self, writer: PartWriter, first: int) -> None:
        if not 0 <= first <= writer.point_count:
            raise PointCountError(
                f"{writer.path}: expected a part that begins with one of {writer.point_count} "
                f"points, found {first}"
            )
        self.summary = writer.new_summary(first)
        self._writer = writer
        self._file = write_only(writer.path)

    def write(self, records: Any) -> None:
        """Append points, as the reader's batches hold them."""
        if not len(records):
            return
        row = self.summary.first + self.summary.count
        if row + len(records) > self._writer.point_count:
            raise self._writer.wrong_count(row + len(records))
        self._writer.put(self._file, row, records)
        self.summary.add(records)

    def flush(self) -> None:
        """Wait until what was written is on the disk."""
        self._file.flush()
        sync(self._file.fileno())

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def member(kept: Any, name: str) -> Any:
    """Return a member of an object that was read from JSON; raise a `ValueError` if it has none."""
    if not isinstance(kept, dict) or name not in kept:
        raise ValueError(f"expected an object with {name!r}")
    return kept[name]


def integers(values: Any, count: int, lowest: int = 0, highest: int = 1 << 62) -> list[int]:
    """Return integers that were read from JSON; raise a `ValueError` if they are anything else."""
    if (
        not isinstance(values, list)
        or len(values) != count
        or not all(type(value) is int and lowest <= value <= highest for value in values)
    ):
        raise ValueError(f"expected {count} integers between {lowest} and {highest}")
    return values


def put_records(file: BinaryIO, start: int, records: NDArray[Any]) -> None:
    """Write the bytes of an array of records from a byte of the file on."""
    file.seek(start)
    file.write(np.ascontiguousarray(records).view(np.uint8).data)


def _copy_spans(source: Path, target: BinaryIO, spans: Spans) -> None:
    if not spans:
        return
    with source.open("rb") as file:
        for start, end in spans:
            copied = sum(target.write(block) for block in read_blocks(file, start, end))
            if copied < end - start:
                raise OSError(f"{source}: cut short while it was read")
