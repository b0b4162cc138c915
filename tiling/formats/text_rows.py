"""Points written as lines of numbers: the coordinates are parsed, the text itself is kept.

A row that stays in the map goes back to the output byte for byte, so no digit of any field is
rounded, reformatted or lost. Every value must still be a number; only the three coordinates are
converted, by Arrow, whose result is the float64 nearest to the text.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray
from pyarrow.lib import ArrowInvalid, LargeStringArray, float64, py_buffer

from tiling.compiled import compiled, helper
from tiling.errors import MapFormatError

BLOCK = 2 << 20
"""Bytes of text read at a time."""

LONGEST_VALUE = 512
"""Bytes that one value and the blanks around it may take on average, in a row."""

_TAB, _LINE_FEED, _RETURN, _BLANK = 9, 10, 13, 32
_PLUS, _MINUS, _POINT, _ZERO, _NINE = (ord(c) for c in "+-.09")
_OPENING, _CLOSING, _UNDERSCORE = (ord(c) for c in "()_")
_LOWER_CASE = 32
_A, _E, _F, _I, _N, _T, _Y, _Z = (ord(c) for c in "aefintyz")
_FINE, _NOT_A_NUMBER, _WRONG_COUNT = 0, 1, 2

Bytes = NDArray[np.uint8]
Positions = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TextRows:
    """Rows of a text file, each with its line ending.

    Attributes
    ----------
    text : (m,) uint8 array
        The block of the file that holds the rows.
    starts, stops : (n,) int64 arrays
        Where in `text` each row begins and ends.
    """

    text: Bytes
    starts: Positions
    stops: Positions

    def __len__(self) -> int:
        return len(self.starts)

    def __getitem__(self, chosen: NDArray[np.bool_] | slice) -> "TextRows":
        return TextRows(self.text, self.starts[chosen], self.stops[chosen])

    def with_words(self, words: Sequence[bytes]) -> "TextRows":
        """Return the rows with some words behind the last value of each."""
        text = self.text.tobytes()
        rows = []
        for start, stop, more in zip(self.starts, self.stops, words, strict=True):
            row = text[start:stop]
            content = row.rstrip()
            rows.append(b"%b %b%b" % (content, more, row[len(content) :].lstrip(b" \t")))
        bounds = np.cumsum([0, *map(len, rows)], dtype=np.int64)
        return TextRows(np.frombuffer(b"".join(rows), np.uint8), bounds[:-1], bounds[1:])

    def tobytes(self) -> bytes:
        """Return the rows' text, one row after the other."""
        joined = np.empty(int((self.stops - self.starts).sum()), dtype=np.uint8)
        _join_rows(self.text, self.starts, self.stops, joined)
        return joined.tobytes()


@dataclass(frozen=True, slots=True)
class RowLayout:
    """What a row of text holds.

    Attributes
    ----------
    values : int
        Numbers in a row.
    coordinates : tuple of three int
        Which of them, from 0, are x, y and z.
    """

    values: int
    coordinates: tuple[int, int, int]


def read_rows(
    stream: BinaryIO,
    layout: RowLayout,
    row_count: int,
    max_rows: int,
    path: Path,
    first_line: int,
) -> Iterator[tuple[TextRows, NDArray[np.float64]]]:
    """Read all rows from a stream's position to its end.

    Blanks, tabs and carriage returns separate values; lines with nothing else are passed over.

    Parameters
    ----------
    stream : binary file
    layout : RowLayout
    row_count : int
        Rows that there must be.
    max_rows : int
        Rows to give at a time, at most; fewer come where the text is read in smaller blocks.
    path : Path
        The file, for messages.
    first_line : int
        Line number of the first row, counted from 1.

    Yields
    ------
    TextRows, (n, 3) float64 array
        Rows and their coordinates.

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
            limit = min(max_rows, row_count - found) or 1
            rows, xyz, position, lines = parse_rows(text, position, limit, layout, path, line)
            line += lines
            found += len(rows)
            if found > row_count:
                raise MapFormatError(path, f"{row_count} points", "more rows", f"line {line - 1}")
            if len(rows):
                yield rows, xyz
    if found < row_count:
        raise MapFormatError(
            path, f"{row_count} points", f"the end of the file after {found}", f"line {line}"
        )


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
            raise MapFormatError(
                path, f"a row of {layout.values} values", f"a line of over {longest} bytes", at
            )
    if carried_size:
        yield b"".join(carried)


def parse_rows(
    text: Bytes, position: int, limit: int, layout: RowLayout, path: Path, line: int
) -> tuple[TextRows, NDArray[np.float64], int, int]:
    """Take up to `limit` rows out of whole lines of text.

    Parameters
    ----------
    text : (m,) uint8 array
    position : int
        Where in `text` to begin.
    limit : int
        Rows to take at most.
    layout : RowLayout
    path : Path
        The file, for messages.
    line : int
        Number of the line at `position`, for messages.

    Returns
    -------
    TextRows, (n, 3) float64 array, int, int
        The rows, their coordinates, the position after them, and the lines passed.

    Raises
    ------
    MapFormatError
        For another number of values in a row, and a value that is not a number.
    """
    # A value and its separator take two bytes at least.
    limit = min(limit, (len(text) - position) // (2 * layout.values) + 1)
    starts = np.empty(limit, dtype=np.int64)
    stops = np.empty(limit, dtype=np.int64)
    digits = np.empty(len(text) - position, dtype=np.uint8)
    bounds = np.zeros(3 * limit + 1, dtype=np.int64)
    wanted = np.sort(np.array(layout.coordinates, dtype=np.int64))
    rows, stop, lines, fault, column = _split_rows(
        text, position, layout.values, wanted, starts, stops, digits, bounds
    )
    if fault == _NOT_A_NUMBER:
        word = bytes(text[stop : stop + 40]).split()[0].decode("ascii", "replace")
        at = f"line {line + lines}, value {column + 1}"
        raise MapFormatError(path, "a number", repr(word), at)
    if fault == _WRONG_COUNT:
        at = f"line {line + lines}"
        raise MapFormatError(path, f"{layout.values} values in a row", str(column), at)
    values = _as_numbers(digits, bounds[: 3 * rows + 1]).reshape(rows, 3)
    order = np.argsort(np.argsort(layout.coordinates))
    return TextRows(text, starts[:rows], stops[:rows]), values[:, order], stop, lines


def _as_numbers(digits: Bytes, bounds: Positions) -> NDArray[np.float64]:
    """Convert the numbers between successive bounds to float64."""
    words = LargeStringArray.from_buffers(len(bounds) - 1, py_buffer(bounds), py_buffer(digits))
    try:
        numbers = words.cast(float64()).to_numpy(zero_copy_only=False)
    except ArrowInvalid:
        # A number beyond the range of float64 is none to Arrow; to the standard it is infinite.
        numbers = np.array([float(word) for word in words.to_pylist()])
    return np.asarray(numbers, dtype=np.float64)


@compiled
def _split_rows(
    text: Bytes,
    position: int,
    values: int,
    wanted: Positions,
    starts: Positions,
    stops: Positions,
    digits: Bytes,
    bounds: Positions,
) -> tuple[int, int, int, int, int]:
    """Find rows, check that they are numbers, and copy the wanted ones into `digits`.

    Returns the rows found, the position reached, the lines passed, the fault and its column.
    """
    rows = lines = words = 0
    while rows < len(starts) and position < len(text):
        start = position
        column = next_wanted = 0
        while True:
            while position < len(text) and _is_blank(text[position]):
                position += 1
            if position == len(text) or text[position] == _LINE_FEED:
                break
            stop = _number_end(text, position)
            if stop < 0:
                return rows, position, lines, _NOT_A_NUMBER, column
            if next_wanted < 3 and column == wanted[next_wanted]:
                bounds[words + 1] = _copy_number(text, position, stop, digits, bounds[words])
                words += 1
                next_wanted += 1
            column += 1
            position = stop
        position = min(position + 1, len(text))
        if column:
            if column != values:
                return rows, position, lines, _WRONG_COUNT, column
            starts[rows] = start
            stops[rows] = position
            rows += 1
        lines += 1
    return rows, position, lines, _FINE, 0


@helper
def _is_blank(byte: int) -> bool:
    return byte == _BLANK or byte == _TAB or byte == _RETURN  # noqa: PLR1714 - half the time


@helper
def _copy_number(text: Bytes, start: int, stop: int, digits: Bytes, target: int) -> int:
    """Copy a number without what Arrow does not take: a plus sign, the argument of `nan(...)`."""
    if text[start] == _PLUS:
        start += 1
    while start < stop and text[start] != _OPENING:
        digits[target] = text[start]
        start += 1
        target += 1
    return target


@helper
def _number_end(text: Bytes, position: int) -> int:
    """Return where the number at `position` ends, or -1 where there is none.

    A number is what C's `strtod` takes in the decimal system: `-1`, `2.`, `.5e-3`, `inf`, `nan`.
    """
    if text[position] == _PLUS or text[position] == _MINUS:
        position += 1
    if position < len(text) and text[position] > _NINE:
        position = _name_end(text, position)
    else:
        position = _decimal_end(text, position)
    if position < 0 or position == len(text):
        return position
    if _is_blank(text[position]) or text[position] == _LINE_FEED:
        return position
    return -1


@helper
def _decimal_end(text: Bytes, position: int) -> int:
    """Return where digits, with a point and an exponent or without, end; -1 if there are none."""
    start = position
    position = _digits_end(text, position)
    count = position - start
    if position < len(text) and text[position] == _POINT:
        start = position + 1
        position = _digits_end(text, start)
        count += position - start
    if count == 0:
        return -1
    if position < len(text) and text[position] | _LOWER_CASE == _E:
        position += 1
        if position < len(text) and (text[position] == _PLUS or text[position] == _MINUS):
            position += 1
        start = position
        position = _digits_end(text, position)
        if position == start:
            return -1
    return position


@helper
def _digits_end(text: Bytes, position: int) -> int:
    while position < len(text) and _ZERO <= text[position] <= _NINE:
        position += 1
    return position


@helper
def _name_end(text: Bytes, position: int) -> int:
    """Return where `nan`, `nan(...)`, `inf` or `infinity` ends, in any case; -1 for others."""
    if _is_word(text, position, (_I, _N, _F, _I, _N, _I, _T, _Y)):
        return position + 8
    if _is_word(text, position, (_I, _N, _F)):
        return position + 3
    if not _is_word(text, position, (_N, _A, _N)):
        return -1
    position += 3
    if position == len(text) or text[position] != _OPENING:
        return position
    position += 1
    while position < len(text) and (
        _ZERO <= text[position] <= _NINE
        or _A <= text[position] | _LOWER_CASE <= _Z
        or text[position] == _UNDERSCORE
    ):
        position += 1
    return position + 1 if position < len(text) and text[position] == _CLOSING else -1


@helper
def _is_word(text: Bytes, position: int, word: tuple[int, ...]) -> bool:
    if position + len(word) > len(text):
        return False
    same = 0
    while same < len(word) and text[position + same] | _LOWER_CASE == word[same]:
        same += 1
    return same == len(word)


@compiled
def _join_rows(text: Bytes, starts: Positions, stops: Positions, joined: Bytes) -> None:
    """Copy rows one after the other into `joined`."""
    target = 0
    for row in range(len(starts)):
        for source in range(starts[row], stops[row]):
            joined[target] = text[source]
            target += 1
