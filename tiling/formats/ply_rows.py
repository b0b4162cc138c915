"""The records of a PLY file, read one after the other as a stream: text or binary.

Both readers keep a record as the bytes it has in the file. Numbers are taken out of it only for
the properties that are asked for.
"""

import math
import os
import struct
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, NoReturn

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.ply_header import PlyElement, PlyHeader

_BLOCK = 1 << 20
_LONGEST_LINE = 1 << 24
_LENGTH_TYPES = {
    "i1": "b",
    "u1": "B",
    "i2": "h",
    "u2": "H",
    "i4": "i",
    "u4": "I",
    "i8": "q",
    "u8": "Q",
}
_MOST_BYTES = 1 << 26
"""Bytes of records of no fixed size after which a batch ends early."""


class PlyRows(ABC):
    """Records from a place in the file on.

    Attributes
    ----------
    position : int
        Byte at which the next record begins.
    """

    position: int

    @abstractmethod
    def take(
        self, element: PlyElement, most: int, names: Sequence[str] = ()
    ) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Read the next records, at least one and at most `most`, all of `element`.

        Returns
        -------
        records : (n,) array
            As they stand in the file.
        values : (n, len(names)) float64 array
            The numbers of the properties asked for.

        Raises
        ------
        MapFormatError
            When the file ends before, or a record is not what the header says.
        """

    def skip(self, element: PlyElement) -> None:
        """Pass over all records of `element`, checking them on the way."""
        left = element.count
        while left:
            left -= len(self.take(element, min(left, _BLOCK // 16))[0])


def open_rows(file: BinaryIO, header: PlyHeader, path: Path) -> PlyRows:
    """Return the records after the header, for the file's encoding."""
    file.seek(header.size)
    return (TextRows if header.encoding == "ascii" else BinaryRows)(file, header, path)


class TextRows(PlyRows):
    """Records that are lines of text; blank lines are no records."""

    def __init__(self, file: BinaryIO, header: PlyHeader, path: Path) -> None:
        self.position = header.size
        self._file = file
        self._path = path
        self._line_end = header.line_end
        self._next_line = len(header.lines) + 1
        self._lines: list[bytes] = []
        self._used = 0
        self._rest = b""
        self._ended = False

    def take(
        self, element: PlyElement, most: int, names: Sequence[str] = ()
    ) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Read the next lines; see `PlyRows.take`."""
        lines, numbers = self._rows(element, most)
        rows = [line.split() for line in lines]
        if element.is_fixed:
            width = len(element.properties)
            for row, number in zip(rows, numbers, strict=True):
                if len(row) != width:
                    self._fail(f"{width} numbers of a {element.name}", f"{len(row)}", number)
        else:
            rows = [
                self._without_lists(element, row, number)
                for row, number in zip(rows, numbers, strict=True)
            ]
        values = np.empty((len(rows), len(names)))
        for column, name in enumerate(names):
            values[:, column] = self._numbers(element, name, rows, numbers)
        records = np.empty(len(lines), dtype=object)
        records[:] = lines
        return records, values

    def _rows(self, element: PlyElement, most: int) -> tuple[list[bytes], list[int]]:
        """Return the next lines that are not blank, and their line numbers."""
        rows: list[bytes] = []
        numbers: list[int] = []
        size = 0
        while len(rows) < most and size < _MOST_BYTES:
            if self._used == len(self._lines) and not self._refill():
                if not rows:
                    self._fail(
                        f"all {element.count} records of {element.name!r}",
                        "the end of the file",
                        self._next_line,
                    )
                break
            line = self._lines[self._used]
            self._used += 1
            if line and not line.isspace():
                rows.append(line)
                numbers.append(self._next_line)
            self._next_line += 1
            size += len(line)
            self.position += len(line) + len(self._line_end)
        return rows, numbers

    def _refill(self) -> bool:
        """Read further lines; return False at the end of the file."""
        self._lines, self._used = [], 0
        while not self._lines and not self._ended:
            block = self._file.read(_BLOCK)
            pieces = (self._rest + block).split(self._line_end)
            self._rest = pieces.pop()
            self._lines = pieces
            if len(self._rest) > _LONGEST_LINE:
                number = self._next_line + len(self._lines)
                self._fail(f"a line of at most {_LONGEST_LINE} bytes", "a longer one", number)
            if not block:
                self._ended = True
                if self._rest:
                    self._lines, self._rest = [self._rest], b""
        return bool(self._lines)

    def _without_lists(self, element: PlyElement, row: list[bytes], number: int) -> list[bytes]:
        """Check a row that has lists, and return its other numbers."""
        scalars = []
        at = 0
        for each in element.properties:
            word = row[at] if at < len(row) else b""
            at += 1
            if each.count_dtype is None:
                scalars.append(word)
            elif len(word) < 10 and word.isdigit():
                at += int(word)
            else:
                found = _show(word) if word else "the end of the line"
                self._fail(f"the length of list {each.name!r}", found, number)
        if at != len(row):
            self._fail(f"{at} numbers of a {element.name}", f"{len(row)}", number)
        return scalars

    def _numbers(
        self, element: PlyElement, name: str, rows: list[list[bytes]], numbers: list[int]
    ) -> NDArray[np.float64]:
        """Return one property of the rows, as a binary file of the same type would hold it."""
        column = element.scalar_dtype.names.index(name)  # type: ignore[union-attr]
        try:
            words = [row[column] for row in rows]
            # float() takes 1_000, which no file format means.
            values = np.array([float(w) if b"_" not in w else math.nan for w in words], dtype=float)
            sound = not np.isnan(values).any()
        except ValueError:
            sound = False
        if not sound:
            values = np.array(
                [self._number(name, row[column], n) for row, n in zip(rows, numbers, strict=True)],
                dtype=float,
            )
        dtype = element.scalar_dtype[name]
        if dtype.kind != "f":
            return values
        with np.errstate(all="ignore"):
            return values.astype(dtype).astype(np.float64)

    def _number(self, name: str, word: bytes, number: int) -> float:
        try:
            if b"_" in word:
                raise ValueError
            return float(word)
        except ValueError:
            self._fail(f"a number for {name!r}", _show(word), number)

    def _fail(self, expected: str, found: str, line: int) -> NoReturn:
        raise MapFormatError(self._path, expected, found, at=f"line {line}")


class BinaryRows(PlyRows):
    """Records that are packed bytes."""

    def __init__(self, file: BinaryIO, header: PlyHeader, path: Path) -> None:
        self.position = header.size
        self._file = file
        self._path = path
        self._size = os.fstat(file.fileno()).st_size
        self._ahead = b""

    def take(
        self, element: PlyElement, most: int, names: Sequence[str] = ()
    ) -> tuple[NDArray[Any], NDArray[np.float64]]:
        """Read the next records; see `PlyRows.take`."""
        if element.is_fixed:
            records = self._fixed(element, most)
            scalars = records
        else:
            records, scalars = self._listed(element, most)
        values = np.empty((len(records), len(names)))
        with np.errstate(all="ignore"):
            for column, name in enumerate(names):
                values[:, column] = scalars[name]
        return records, values

    def skip(self, element: PlyElement) -> None:
        """Pass over all records of `element`, by its size where that is known."""
        if not element.is_fixed:
            super().skip(element)
            return
        end = self.position + element.count * element.least_bytes
        if end > self._size:
            self._end_of_file(element, end)
        self._move(end)

    def _move(self, position: int) -> None:
        self._file.seek(position)
        self._ahead = b""
        self.position = position

    def _fixed(self, element: PlyElement, most: int) -> NDArray[Any]:
        self._move(self.position)
        size = element.least_bytes
        content = bytearray(self._file.read(most * size))
        if len(content) != most * size:
            self._end_of_file(element, self.position + most * size)
        self.position += len(content)
        return np.frombuffer(content, dtype=element.scalar_dtype)

    def _listed(self, element: PlyElement, most: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Read records with lists, and the numbers outside the lists packed together."""
        layout = _Layout.of(element)
        found: list[bytes] = []
        packed: list[bytes] = []
        size = 0
        at = 0
        while len(found) < most and size < _MOST_BYTES:
            record = self._measure(layout, at)
            while record.end > len(self._ahead):
                self._read_ahead(element, at, record.end)
                at = 0
                record = self._measure(layout, at)
            content = self._ahead[at : record.end]
            packed.extend(self._ahead[start:end] for start, end in record.scalars)
            found.append(content)
            size += len(content)
            at = record.end
        self._ahead = self._ahead[at:]
        self.position += size
        records = np.empty(len(found), dtype=object)
        records[:] = found
        if not element.scalars:
            return records, np.empty(len(found), dtype=[])
        return records, np.frombuffer(b"".join(packed), dtype=element.scalar_dtype)

    def _measure(self, layout: "_Layout", at: int) -> "_Measure":
        try:
            return layout.measure(self._ahead, at)
        except _NegativeLengthError as error:
            place = f"byte {self._file.tell() - len(self._ahead) + at}"
            raise MapFormatError(self._path, "the length of a list", str(error), at=place) from None

    def _read_ahead(self, element: PlyElement, at: int, end: int) -> None:
        """Drop the bytes before `at`, and read until there are those before `end`."""
        needed = end - len(self._ahead)
        if needed > self._size - self._file.tell():
            self._end_of_file(element, self._file.tell() + needed)
        self._ahead = self._ahead[at:] + self._file.read(max(needed, _BLOCK))

    def _end_of_file(self, element: PlyElement, needed: int) -> NoReturn:
        raise MapFormatError(
            self._path,
            f"at least {needed} bytes for {element.count} records of {element.name!r}",
            f"a file of {self._size} bytes",
            at=f"byte {self.position}",
        )


class _NegativeLengthError(ValueError):
    """A list has a length below zero."""


@dataclass(frozen=True, slots=True)
class _Measure:
    """Where a record ends, and where its numbers outside lists lie.

    `end` is the least it can be where the buffer ends before the record does.
    """

    end: int
    scalars: list[tuple[int, int]]


@dataclass(frozen=True, slots=True)
class _Layout:
    """The plan of a record with lists.

    Attributes
    ----------
    lists : tuple of (int, struct.Struct, int)
        For each list: bytes before it, the type of its length, and bytes of an item.
    after : int
        Bytes after the last list.
    """

    lists: tuple[tuple[int, struct.Struct, int], ...]
    after: int

    @classmethod
    def of(cls, element: PlyElement) -> "_Layout":
        lists = []
        before = 0
        for each in element.properties:
            if each.count_dtype is None:
                before += each.dtype.itemsize
            else:
                order = ">" if each.count_dtype.byteorder == ">" else "<"
                count = struct.Struct(order + _LENGTH_TYPES[each.count_dtype.str[1:]])
                lists.append((before, count, each.dtype.itemsize))
                before = 0
        return cls(tuple(lists), before)

    def measure(self, buffer: bytes, start: int) -> _Measure:
        scalars = []
        for before, count, item in self.lists:
            if before:
                scalars.append((start, start + before))
            start += before
            if start + count.size > len(buffer):
                return _Measure(start + count.size, scalars)
            length = count.unpack_from(buffer, start)[0]
            if length < 0:
                raise _NegativeLengthError(length)
            start += count.size + length * item
        if self.after:
            scalars.append((start, start + self.after))
        return _Measure(start + self.after, scalars)


def _show(word: bytes) -> str:
    return repr(word[:24].decode("latin-1"))
