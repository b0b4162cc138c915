"""The records of a PLY file, read one after the other as a stream: text or binary.

Both readers keep a record as the bytes it has in the file. Numbers are taken out of it only for
the properties that are asked for.
"""

import os
from abc import ABC, abstractmethod
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO, Literal, NoReturn

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.ply.header import PlyElement, PlyHeader, PlyProperty
from tiling.formats.text_rows import RowLayout, TextRows, parse_rows

_BLOCK = 1 << 20
_LONGEST_LINE = 1 << 24
_MOST_BYTES = 1 << 26
"""Bytes of records of no fixed size after which a batch ends early."""


class PlyRows(ABC):
    """Records from a place in the file on."""

    def __init__(self, file: BinaryIO, header: PlyHeader, path: Path) -> None:
        self._file = file
        self._path = path
        self.position = header.size
        """Byte at which the next record begins."""

    @abstractmethod
    def take(
        self, element: PlyElement, most: int, names: Sequence[str] = ()
    ) -> tuple[TextRows | NDArray[Any], NDArray[np.float64]]:
        """Read the next records, at least one and at most `most`, all of `element`.

        Returns them as they stand in the file, and the numbers of the properties asked for,
        (n, len(names)). A record that is not what the header says is refused.
        """

    def skip(self, element: PlyElement, count: int | None = None) -> None:
        """Pass over the next records of `element`, otherwise all, checking them on the way."""
        left = element.count if count is None else count
        while left:
            left -= len(self.take(element, min(left, _BLOCK // 16))[0])


def open_rows(file: BinaryIO, header: PlyHeader, path: Path) -> PlyRows:
    """Return the records after the header, for the file's encoding."""
    file.seek(header.size)
    return (_AsciiRows if header.encoding == "ascii" else _BinaryRows)(file, header, path)


class _AsciiRows(PlyRows):
    """Records that are lines of text; blank lines are no records."""

    def __init__(self, file: BinaryIO, header: PlyHeader, path: Path) -> None:
        super().__init__(file, header, path)
        self._line_end = header.line_end
        self._line = len(header.lines) + 1
        self._block = b""
        self._at = 0
        self._rest = b""

    def take(
        self, element: PlyElement, most: int, names: Sequence[str] = ()
    ) -> tuple[TextRows, NDArray[np.float64]]:
        rows, values = self._rows(element, most, names)
        while not len(rows):
            if not self._refill():
                expected = f"all {element.count} records of {element.name!r}"
                self._fail(expected, "the end of the file")
            rows, values = self._rows(element, most, names)
        for column, name in enumerate(names):
            dtype = element.scalar_dtype[name]
            if dtype.kind == "f":
                with np.errstate(all="ignore"):
                    values[:, column] = values[:, column].astype(dtype)
        return rows, values

    def _refill(self) -> bool:
        """Read further whole lines; return False at the end of the file."""
        pieces = [self._rest]
        size = len(self._rest)
        self._rest = b""
        while block := self._file.read(_BLOCK):
            end = block.rfind(self._line_end) + 1
            pieces.append(block[:end] if end else block)
            if end:
                self._rest = block[end:]
                break
            size += len(block)
            if size > _LONGEST_LINE:
                expected = f"a line of at most {_LONGEST_LINE} bytes"
                self._fail(expected, "a longer one")
        self._block, self._at = b"".join(pieces), 0
        return bool(self._block)

    def _rows(
        self, element: PlyElement, most: int, names: Sequence[str]
    ) -> tuple[TextRows, NDArray[np.float64]]:
        """Take rows out of the block, none where only blank lines are left in it."""
        start = self._at
        if element.is_fixed and len(names) == 3 and self._line_end == b"\n":
            columns = [element.scalar_dtype.names.index(name) for name in names]  # type: ignore[union-attr]
            x, y, z = columns
            layout = RowLayout(len(element.properties), (x, y, z))
            text = np.frombuffer(self._block, dtype=np.uint8)
            rows, values, self._at, lines = parse_rows(
                text, start, most, layout, self._path, self._line
            )
            self._line += lines
        else:
            rows, values = self._rows_one_by_one(element, most, names)
        self.position += self._at - start
        return rows, values

    def _rows_one_by_one(
        self, element: PlyElement, most: int, names: Sequence[str]
    ) -> tuple[TextRows, NDArray[np.float64]]:
        """Do the same for lists, for line ends of old Macs, and where no number is wanted."""
        starts: list[int] = []
        stops: list[int] = []
        values: list[list[float]] = []
        wanted = [element.scalar_dtype.names.index(name) for name in names]  # type: ignore[union-attr]
        while len(starts) < most and self._at < len(self._block):
            start = self._at
            self._at = (self._block.find(self._line_end, start) + 1) or len(self._block)
            words = self._block[start : self._at].split()
            if words:
                scalars = self._without_lists(element, words)
                starts.append(start)
                stops.append(self._at)
                values.append([self._number(scalars[column]) for column in wanted])
            self._line += 1
        text = np.frombuffer(self._block, dtype=np.uint8)
        rows = TextRows(text, np.array(starts, dtype=np.int64), np.array(stops, dtype=np.int64))
        return rows, np.array(values, dtype=np.float64).reshape(len(starts), len(names))

    def _without_lists(self, element: PlyElement, row: list[bytes]) -> list[bytes]:
        """Check that a row is whole, and return its numbers outside lists."""
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
                self._fail(f"the length of list {each.name!r}", found)
        if at != len(row):
            self._fail(f"{at} values in a row of {element.name!r}", f"{len(row)}")
        return scalars

    def _number(self, word: bytes) -> float:
        try:
            # float() takes 1_000, which no file format means.
            return float(word.replace(b"_", b"?"))
        except ValueError:
            self._fail("a number", _show(word))

    def _fail(self, expected: str, found: str) -> NoReturn:
        raise MapFormatError(self._path, expected, found, at=f"line {self._line}")


class _BinaryRows(PlyRows):
    """Records that are packed bytes."""

    def __init__(self, file: BinaryIO, header: PlyHeader, path: Path) -> None:
        super().__init__(file, header, path)
        self._size = os.fstat(file.fileno()).st_size

    def take(
        self, element: PlyElement, most: int, names: Sequence[str] = ()
    ) -> tuple[NDArray[Any], NDArray[np.float64]]:
        if element.is_fixed:
            content = bytearray(self._read(element, most * element.least_bytes))
            scalars = records = np.frombuffer(content, dtype=element.scalar_dtype)
        else:
            records, scalars = self._listed(element, most)
        values = np.empty((len(records), len(names)))
        with np.errstate(all="ignore"):
            for column, name in enumerate(names):
                values[:, column] = scalars[name]
        return records, values

    def skip(self, element: PlyElement, count: int | None = None) -> None:
        if not element.is_fixed:
            super().skip(element, count)
            return
        count = element.count if count is None else count
        end = self.position + count * element.least_bytes
        if end > self._size:
            self._end_of_file(element, end)
        self._file.seek(end)
        self.position = end

    def _listed(self, element: PlyElement, most: int) -> tuple[NDArray[Any], NDArray[Any]]:
        """Read records with lists, and the numbers outside the lists packed together."""
        found: list[bytes] = []
        packed: list[bytes] = []
        start = self.position
        while len(found) < most and self.position - start < _MOST_BYTES:
            parts = []
            for each in element.properties:
                if each.count_dtype is None:
                    parts.append(self._read(element, each.dtype.itemsize))
                    packed.append(parts[-1])
                else:
                    parts += self._list(element, each, each.count_dtype)
            found.append(b"".join(parts))
        records = np.empty(len(found), dtype=object)
        records[:] = found
        if not element.scalars:
            return records, np.empty(len(found), dtype=[])
        return records, np.frombuffer(b"".join(packed), dtype=element.scalar_dtype)

    def _list(self, element: PlyElement, each: PlyProperty, count: np.dtype) -> tuple[bytes, bytes]:
        """Read the length of a list, and its items."""
        place = self.position
        length = self._read(element, count.itemsize)
        order: Literal["big", "little"] = "big" if count.byteorder == ">" else "little"
        items = int.from_bytes(length, order, signed=count.kind == "i")
        if items < 0:
            raise MapFormatError(self._path, "the length of a list", f"{items}", f"byte {place}")
        return length, self._read(element, items * each.dtype.itemsize)

    def _read(self, element: PlyElement, size: int) -> bytes:
        content = self._file.read(size) if size <= self._size - self.position else b""
        if len(content) != size:
            self._end_of_file(element, self.position + size)
        self.position += size
        return content

    def _end_of_file(self, element: PlyElement, needed: int) -> NoReturn:
        expected = f"at least {needed} bytes for {element.count} records of {element.name!r}"
        found = f"a file of {self._size} bytes"
        raise MapFormatError(self._path, expected, found, f"byte {self.position}")


def _show(word: bytes) -> str:
    return repr(word[:24].decode("latin-1"))
