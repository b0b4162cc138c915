"""Points as plain text: XYZ, TXT, PTS, ASC and CSV, a point a line.

Values are separated by blanks, tabs, commas or semicolons. Before the points there may be comments
(`#`, `//`), the number of points (PTS), and a line of names; all of that is kept. Rows are never
taken apart: those that stay are written back byte for byte, and only x, y and z need be numbers.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import MapReader, MapWriter, TextWriter
from tiling.formats.checks import SIGNATURE_LENGTH, kind_of
from tiling.formats.parts import Surroundings
from tiling.formats.points import (
    COORDINATES,
    Field,
    MapDescription,
    PointBatch,
    coordinate_names,
    longer_rows,
    numbered,
    only_rows,
)
from tiling.formats.text_rows import COMMENTS, RowLayout, TextRows, read_rows

_SEPARATORS = {b";": "semicolons", b",": "commas", b"\t": "tabs", b"": "blanks"}
"""In the order in which they are tried: the first that splits the first row counts."""

_LONGEST_LINE = 1 << 16
_MOST_LINES = 1000
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"
_COUNT = re.compile(rb"\s*\d{1,18}\s*")
_BLOCK = 1 << 20


@dataclass(frozen=True, slots=True)
class TextHead:
    """What stands before the first point."""

    lines: tuple[bytes, ...]
    count_line: int | None
    names_line: int | None
    """Which of them has the number of points, and which the names of the values."""
    names: tuple[str, ...]
    """One for each value; those of coordinates are x, y and z where the file has no names."""
    layout: RowLayout

    @property
    def size(self) -> int:
        """Bytes before the first point."""
        return sum(map(len, self.lines))

    @property
    def count(self) -> int | None:
        """Points that it promises, where it does."""
        return None if self.count_line is None else int(self.lines[self.count_line])

    def for_points(self, count: int) -> bytes:
        """Return the head of a file of so many points."""
        lines = list(self.lines)
        if self.count_line is not None:
            old = lines[self.count_line]
            lines[self.count_line] = old.replace(old.strip(), b"%d" % count)
        return b"".join(lines)

    def extended(self, names: Sequence[str]) -> "TextHead":
        """Return the head of a file whose rows have further values."""
        layout = replace(self.layout, values=self.layout.values + len(names))
        lines = list(self.lines)
        if self.names_line is not None:
            line = lines[self.names_line]
            content = line.rstrip()
            separator = self.layout.separator or b" "
            more = separator.join(name.encode() for name in names)
            lines[self.names_line] = content + separator + more + line[len(content) :]
        return replace(self, lines=tuple(lines), names=(*self.names, *names), layout=layout)


class TextReader(MapReader):
    """Reads a text file of points.

    Making one counts the rows, for which the whole file is read once.
    """

    seekable = False  # where a row begins is known from those before it

    def __init__(self, path: Path) -> None:
        self._path = path
        self._head = read_head(path)
        state = path.stat()
        identity = (state.st_size, state.st_mtime_ns, state.st_ino)
        self._count, has_comments = _counted(path, self._head, identity)
        if self._head.count not in (None, self._count):
            expected = f"{self._head.count} points, as its head says"
            raise MapFormatError(path, expected, f"{self._count}")
        layout = self._head.layout
        notes = ["The comments between and behind the points are left out."] * has_comments
        if not self._count:
            notes.append("The file has no points.")
        self.description = MapDescription(
            path=path,
            format=f"text, values separated by {_SEPARATORS[layout.separator]}",
            suffix=path.suffix.lower(),
            point_count=self._count,
            fields=tuple(
                Field(name, "float64" if place in layout.coordinates else "text")
                for place, name in enumerate(self._head.names)
            ),
            notes=tuple(notes),
        )
        self.bytes_per_point = state.st_size // max(self._count, 1)

    def _batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        with self._path.open("rb") as stream:
            parts = _rows(stream, self._head, self._path, self._count, max_points)
            yield from only_rows(numbered(parts), rows)

    def values(self, records: Any, name: str) -> NDArray[Any]:
        """Return one value of some rows as a number; see `MapReader.values`."""
        rows: TextRows = records
        column = self._head.names.index(name)
        try:
            return rows.column(column, np.dtype(np.float64), self._head.layout.separator)
        except ValueError as error:
            raise MapFormatError(self._path, f"numbers in the field {name}", str(error)) from None

    def _stream_writer(self, path: Path, point_count: int) -> MapWriter:
        return TextWriter(path, point_count, Surroundings(self._head.for_points(point_count)))

    def _take_further(self) -> None:
        self._head = self._head.extended([field.name for field in self.further])

    def extend(self, batch: PointBatch, values: Sequence[NDArray[Any]]) -> TextRows:
        """Return the rows with further values; see `MapReader.extend`."""
        separator = self._head.layout.separator or b" "
        return longer_rows(batch.records, self.further, values, separator)


def read_head(path: Path) -> TextHead:
    """Read what stands before the first point, and find out how the points are written."""
    lines: list[bytes] = []
    count_line = names_line = layout = None
    with path.open("rb") as stream:
        start = stream.read(SIGNATURE_LENGTH)
        if b"\0" in start:
            raise MapFormatError(path, "points as text", kind_of(start), at="byte 0")
        stream.seek(0)
        if start.startswith(_BYTE_ORDER_MARK):
            lines.append(stream.read(len(_BYTE_ORDER_MARK)))
        while line := stream.readline(_LONGEST_LINE):
            content = line.strip()
            named = b"" if names_line is None else lines[names_line]
            layout = _layout_of(content, named)
            if layout is not None:
                break
            may_be_named = not named or named.startswith(COMMENTS)
            if content.startswith(COMMENTS):
                # CloudCompare's names are in a comment, the last one.
                names_line = len(lines) if may_be_named else names_line
            elif count_line is None and _COUNT.fullmatch(content):
                count_line = len(lines)
            elif may_be_named and _has_coordinates(content):
                names_line = len(lines)
            elif content or len(lines) > _MOST_LINES:
                found = repr(content[:60].decode("utf-8", "replace"))
                expected = "a row of three numbers or more, or names with x, y and z"
                raise MapFormatError(path, expected, found, at=f"line {len(lines) + 1}")
            lines.append(line)
    named = b"" if names_line is None else lines[names_line]
    if layout is None:  # no points
        layout = RowLayout(max(len(_words(named, b"")), 3), (0, 1, 2), free=True)
    names = _words(named, layout.separator)
    if len(names) != layout.values or len(set(names)) != layout.values:
        if named and not named.startswith(COMMENTS):
            raise MapFormatError(path, f"{layout.values} different names", f"{', '.join(names)}")
        of_places = dict(zip(layout.coordinates, COORDINATES, strict=True))
        names = [of_places.get(n, f"column {n + 1}") for n in range(layout.values)]
        names_line = None
    return TextHead(tuple(lines), count_line, names_line, tuple(names), layout)


def _layout_of(content: bytes, names_line: bytes) -> RowLayout | None:
    """Return how a line holds a point, None if it does not."""
    if content.startswith(COMMENTS):
        return None
    for separator in _SEPARATORS:
        words = content.split(separator or None)
        names = _words(names_line, separator)
        known = coordinate_names(names) if len(names) == len(words) else None
        places = [names.index(name) for name in known or ()] or [0, 1, 2]
        if len(words) >= len(COORDINATES) and all(_is_number(words[place]) for place in places):
            x, y, z = places
            return RowLayout(len(words), (x, y, z), separator, free=True)
    return None


def _has_coordinates(line: bytes) -> bool:
    return any(coordinate_names(_words(line, each)) is not None for each in _SEPARATORS)


def _words(line: bytes, separator: bytes) -> list[str]:
    """Return the names in a line, be it a comment or not."""
    text = line.decode("utf-8", "replace").strip("\r\n").lstrip("#/ ")
    words = text.split(separator.decode()) if separator else re.split(r"[;,\s]+", text.strip())
    return [word.strip(" \t\"'") for word in words]


def _is_number(word: bytes) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return b"_" not in word


def _rows(
    stream: BinaryIO, head: TextHead, path: Path, count: int | None, max_points: int
) -> Iterator[tuple[TextRows, NDArray[np.float64]]]:
    stream.seek(head.size)
    first_line = len([line for line in head.lines if line.endswith(b"\n")]) + 1
    return read_rows(stream, head.layout, count, max_points, path, first_line)


@lru_cache(maxsize=1024)
def _counted(path: Path, head: TextHead, identity: tuple[int, ...]) -> tuple[int, bool]:
    """Return the rows of a file, and whether there are comments among them.

    It is remembered as long as size, time and inode of the file stay: each opening asks.
    """
    del identity
    only_counted = replace(head, layout=replace(head.layout, coordinates=()))
    with path.open("rb") as stream:
        count = sum(len(rows) for rows, _ in _rows(stream, only_counted, path, None, _BLOCK))
        stream.seek(head.size)
        before, has_comments = b"\n", False
        while block := stream.read(_BLOCK):
            text = before + block
            has_comments |= any(b"\n" + mark in text for mark in COMMENTS)
            before = text[-2:]
    return count, has_comments
