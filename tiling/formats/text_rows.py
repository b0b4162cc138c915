"""Points written as lines of numbers: the coordinates are parsed, the text itself is kept.

A row that stays in the map goes back to the output byte for byte, so no digit of any field is
rounded, reformatted or lost. What must be a number, Arrow converts: its result is the float64
nearest to the text.
"""

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray
from pyarrow.lib import ArrowInvalid, LargeStringArray, float64, py_buffer

from tiling.compiled import compiled, helper
from tiling.errors import MapFormatError

BLOCK = 2 << 20
"""Bytes of text read at a time."""

LONGEST_VALUE = 512
"""Bytes that one value and the blanks around it may take on average, in a row."""

COMMENTS = (b"#", b"//")
"""How lines begin that are passed over, where a layout says so."""

_TAB, _LINE_FEED, _RETURN, _BLANK, _HASH, _SLASH = 9, 10, 13, 32, 35, 47

_NUMBER = re.compile(
    rb"[+-]?(?:(?:\d+\.?\d*|\.\d+)(?:e[+-]?\d+)?|nan(?:\(\w*\))?|inf|infinity)", re.IGNORECASE
)
"""What C's `strtod` takes in the decimal system: `-1`, `2.`, `.5e-3`, `inf`, `nan(0x7)`."""

Bytes = NDArray[np.uint8]
Positions = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TextRows:
    """Rows of a text file, each with its line ending."""

    text: Bytes
    """(m,): the block of the file that holds the rows."""
    starts: Positions
    stops: Positions
    """(n,): where in `text` each row begins and ends."""

    def __len__(self) -> int:
        return len(self.starts)

    def __getitem__(self, chosen: NDArray[np.bool_] | slice) -> "TextRows":
        return TextRows(self.text, self.starts[chosen], self.stops[chosen])

    def __iter__(self) -> Iterator[bytes]:
        text, bounds = self.text.tobytes(), zip(self.starts, self.stops, strict=True)
        return (text[start:stop] for start, stop in bounds)

    def with_words(self, words: Sequence[bytes], separator: bytes = b" ") -> "TextRows":
        """Return the rows with some words behind the last value of each."""
        rows = []
        for row, more in zip(self, words, strict=True):
            content = row.rstrip() if separator == b" " else row.rstrip(b"\r\n")
            end = row[len(content) :].lstrip(b" \t")
            rows.append(b"%b%b%b%b" % (content, separator, more, end))
        bounds = np.cumsum([0, *map(len, rows)], dtype=np.int64)
        return TextRows(np.frombuffer(b"".join(rows), np.uint8), bounds[:-1], bounds[1:])

    def column(self, number: int, dtype: np.dtype[Any], separator: bytes = b"") -> NDArray[Any]:
        """Return a value of each row, counted from 0: whole numbers as such, others as float64."""
        words = (row.split(separator or None)[number] for row in self)
        values = np.array([float(word) for word in words], dtype=np.float64)
        whole = dtype.kind in "iu" and bool(np.isfinite(values).all())
        with np.errstate(invalid="ignore"):
            return values.astype(dtype) if whole else values

    def tobytes(self) -> bytes:
        """Return the rows' text, one row after the other."""
        joined = np.empty(int((self.stops - self.starts).sum()), dtype=np.uint8)
        _join_rows(self.text, self.starts, self.stops, joined)
        return joined.tobytes()


@dataclass(frozen=True, slots=True)
class RowLayout:
    """What a row of text holds."""

    values: int
    coordinates: tuple[int, ...]
    """Which of them, from 0, are x, y and z."""
    separator: bytes = b""
    """What is between values: one byte, or nothing for blanks, as many as there are."""
    free: bool = False
    """Whether other values may be any text, and lines that begin as `COMMENTS` do are passed over;
    else all values are numbers."""

    @property
    def wanted(self) -> NDArray[np.bool_]:
        """Which values are converted, (values,)."""
        places = np.arange(self.values)
        return np.isin(places, self.coordinates) if self.free else places >= 0


def read_rows(
    stream: BinaryIO,
    layout: RowLayout,
    row_count: int | None,
    max_rows: int,
    path: Path,
    first_line: int,
) -> Iterator[tuple[TextRows, NDArray[np.float64]]]:
    """Read all rows from a stream's position to its end: rows, and their coordinates, (n, 3).

    Blanks, tabs and carriage returns separate values, unless the layout has another separator;
    lines with nothing else are passed over.

    Parameters
    ----------
    row_count : int or None
        Rows that there must be; None if that is not known.
    max_rows : int
        Rows to give at a time, at most; fewer come where the text is read in smaller blocks.
    path, first_line : Path, int
        The file, and the line number of the first row, counted from 1: for messages.

    Raises
    ------
    MapFormatError
        For another number of rows or of values in a row, a value that is not a number, and a row
        too long to be one.
    """
    line = first_line
    found = 0
    for block in _whole_lines(stream, layout, path):
        text = np.frombuffer(block, dtype=np.uint8)
        position = 0
        while position < len(text):
            # One row is tried for when all have come, to tell blank lines from a row too many.
            limit = max_rows if row_count is None else min(max_rows, row_count - found) or 1
            rows, xyz, position, lines = parse_rows(text, position, limit, layout, path, line)
            line += lines
            found += len(rows)
            if row_count is not None and found > row_count:
                raise MapFormatError(path, f"{row_count} points", "more rows", f"line {line - 1}")
            if len(rows):
                yield rows, xyz
    if row_count is not None and found < row_count:
        end = f"the end of the file after {found}"
        raise MapFormatError(path, f"{row_count} points", end, f"line {line}")


def _whole_lines(stream: BinaryIO, layout: RowLayout, path: Path) -> Iterator[bytes]:
    """Yield the rest of a stream in blocks that end where a line does."""
    longest = max(BLOCK, LONGEST_VALUE * layout.values)
    carried: list[bytes] = []
    carried_size = 0
    while block := stream.read(BLOCK):
        end = block.rfind(b"\n") + 1
        if end:
            yield b"".join([*carried, block[:end]])
            carried, carried_size = [block[end:]], len(block) - end
        else:
            carried.append(block)
            carried_size += len(block)
        if carried_size > longest:
            at = f"byte {stream.tell() - carried_size}"
            expected = f"a row of {layout.values} values"
            raise MapFormatError(path, expected, f"a line of over {longest} bytes", at)
    if carried_size:
        yield b"".join(carried)


def parse_rows(
    text: Bytes, position: int, limit: int, layout: RowLayout, path: Path, line: int
) -> tuple[TextRows, NDArray[np.float64], int, int]:
    """Take up to `limit` rows out of whole lines of text, (m,), from a position on.

    Returns the rows, their coordinates, (n, 3), the position after them, and the lines passed. The
    file, and the number of the line at the position, are for messages: another number of values in
    a row, and a value that is not a number, are refused.
    """
    # A row has a byte for each value and one behind it, but for the last row of a file.
    least_bytes = layout.values * (1 if layout.separator else 2)
    limit = min(limit, (len(text) - position) // least_bytes + 1)
    wanted = layout.wanted
    numbers_wanted = int(np.count_nonzero(wanted))
    starts = np.empty(limit, dtype=np.int64)
    stops = np.empty(limit, dtype=np.int64)
    words = np.empty(len(text) - position, dtype=np.uint8)
    bounds = np.zeros(numbers_wanted * limit + 1, dtype=np.int64)
    separator = layout.separator[0] if layout.separator else 0
    rows, stop, lines, column = _split_rows(
        text, position, wanted, separator, layout.free, starts, stops, words, bounds
    )
    places = np.flatnonzero(wanted)
    numbers, wrong = _as_numbers(words, bounds[: numbers_wanted * rows + 1])
    if wrong is not None:
        row, place = divmod(wrong, numbers_wanted)
        word = bytes(words[bounds[wrong] : bounds[wrong + 1]])[:40].decode("ascii", "replace")
        lines_before = np.count_nonzero(text[position : starts[row]] == _LINE_FEED)
        at = f"line {line + lines_before}, value {places[place] + 1}"
        raise MapFormatError(path, "a number", repr(word), at)
    if column:
        at = f"line {line + lines}"
        raise MapFormatError(path, f"{layout.values} values in a row", str(column), at)
    order = np.searchsorted(places, layout.coordinates)
    xyz = numbers.reshape(rows, numbers_wanted).take(order, axis=1)
    return TextRows(text, starts[:rows], stops[:rows]), xyz, stop, lines


def _as_numbers(text: Bytes, bounds: Positions) -> tuple[NDArray[np.float64], int | None]:
    """Convert the words between successive bounds; or say which is the first that is no number."""
    buffers = len(bounds) - 1, py_buffer(bounds), py_buffer(text)
    try:
        numbers = LargeStringArray.from_buffers(*buffers).cast(float64())
        return np.asarray(numbers.to_numpy(zero_copy_only=False), dtype=np.float64), None
    except (ArrowInvalid, UnicodeDecodeError):
        words = [bytes(text[a:b]) for a, b in pairwise(bounds.tolist())]
    for place, word in enumerate(words):
        if not _NUMBER.fullmatch(word):
            return np.empty(0), place
    # Some versions of Arrow take fewer forms than C does.
    return np.array([float(word.split(b"(")[0]) for word in words], dtype=np.float64), None


@compiled
def _split_rows(
    text: Bytes,
    position: int,
    wanted: NDArray[np.bool_],
    separator: int,
    comments: bool,
    starts: Positions,
    stops: Positions,
    words: Bytes,
    bounds: Positions,
) -> tuple[int, int, int, int]:
    """Find rows, and copy the words that are wanted into `words`, one after the other."""
    # Returned are the rows found, the position reached, the lines passed, and the values of a row
    # that has another number of them; else 0.
    values = len(wanted)
    rows = lines = copied = words_found = 0
    while rows < len(starts) and position < len(text):
        start = position
        column = 0
        if comments and _is_comment(text, position):
            while position < len(text) and text[position] != _LINE_FEED:
                position += 1
        position = _after_blanks(text, position, separator)
        more = position < len(text) and text[position] != _LINE_FEED
        while more:
            first = copied
            keep = column < values and wanted[column]
            while position < len(text) and not _ends_word(text[position], separator):
                if keep:
                    words[copied] = text[position]
                    copied += 1
                position += 1
            if keep:
                while separator and copied > first and _is_blank(words[copied - 1], separator):
                    copied -= 1
                words_found += 1
                bounds[words_found] = copied
            column += 1
            if separator:
                more = position < len(text) and text[position] == separator
                position = _after_blanks(text, position + more, separator)
            else:
                position = _after_blanks(text, position, separator)
                more = position < len(text) and text[position] != _LINE_FEED
        position = min(position + 1, len(text))
        if column:
            if column != values:
                return rows, position, lines, column
            starts[rows] = start
            stops[rows] = position
            rows += 1
        lines += 1
    return rows, position, lines, 0


@helper
def _is_comment(text: Bytes, at: int) -> bool:
    slashes = at + 1 < len(text) and text[at] == _SLASH and text[at + 1] == _SLASH
    return slashes or text[at] == _HASH


@helper
def _is_blank(byte: int, separator: int) -> bool:
    # Comparisons one by one take half the time of `in`.
    return byte == _BLANK or byte == _RETURN or (byte == _TAB and separator != _TAB)  # noqa: PLR1714


@helper
def _after_blanks(text: Bytes, position: int, separator: int) -> int:
    while position < len(text) and _is_blank(text[position], separator):
        position += 1
    return position


@helper
def _ends_word(byte: int, separator: int) -> bool:
    if separator:
        return byte == separator or byte == _LINE_FEED  # noqa: PLR1714
    return byte <= _BLANK and (_is_blank(byte, separator) or byte == _LINE_FEED)


@compiled
def _join_rows(text: Bytes, starts: Positions, stops: Positions, joined: Bytes) -> None:
    """Copy rows one after the other into `joined`."""
    target = 0
    for row in range(len(starts)):
        for source in range(starts[row], stops[row]):
            joined[target] = text[source]
            target += 1
