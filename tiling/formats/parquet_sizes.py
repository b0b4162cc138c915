"""The sizes and counts that a Parquet file claims, checked before Arrow believes them.

Arrow reserves as much memory as the header of a page asks for, and reads as many values as the
footer counts. Here the headers of all pages are read, and no page is.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, NoReturn

from tiling.errors import MapFormatError
from tiling.formats.thrift_compact import Structure, ThriftError, read_structure

LARGEST_PAGE = 1 << 28
"""Bytes of a page that is not compressed: it is in memory as a whole."""

_MAGIC = b"PAR1"
_PAGE_HEADER = 1 << 10
_LONGEST_PAGE_HEADER = 1 << 24

# Most bytes that a codec, by its number, makes out of one; of others it is not known.
_EXPANSION = {0: 1, 1: 24, 2: 1040, 5: 256, 6: 1 << 15, 7: 256}
_SLACK = 1 << 16
"""Bytes that a page may have beyond that, where a codec has a fixed part."""

_VALUE_BYTES = 8
"""Of a value in memory, at least, where repetitions are stored as such."""

# Numbers of fields in parquet.thrift.
_SCHEMA, _ROWS, _GROUPS = 2, 3, 4
_NAME_OF, _REPETITION = 4, 3
_COLUMNS, _GROUP_ROWS = 1, 3
_CHUNK_DATA, _INDEXES = 3, ((4, 5), (6, 7))
_PATH, _CODEC, _VALUES, _UNPACKED, _PACKED, _DATA_AT, _DICTIONARY_AT = 3, 4, 5, 6, 7, 9, 11
_BLOOM_AT, _BLOOM_SIZE = 14, 15
_UNPACKED_PAGE, _PACKED_PAGE = 2, 3
_DATA_HEADERS = (5, 8)
_PAGE_HEADERS = (5, 7, 8)
_REPEATED = 2


@dataclass(frozen=True, slots=True)
class _Chunk:
    """The values of one column in one row group, and where their pages lie."""

    name: str
    codec: int
    values: int
    start: int
    stop: int


def check_sizes(path: Path) -> int:
    """Check what a Parquet file says of its own size, and that nothing is left over.

    Returns
    -------
    int
        Bytes that a row takes in memory, on average in the row group where it takes most; values
        that are stored once and referred to count once.

    Raises
    ------
    MapFormatError
        When a page would be larger than its bytes can make it, or than is ever held, when chunks
        lie outside the file, or when there are more values or chunks than the footer counts.
    """
    with path.open("rb") as file:
        try:
            return _check(file, path)
        except ThriftError as error:
            raise MapFormatError(path, "a whole Parquet file", f"a footer with {error}") from error
        except (AttributeError, TypeError, LookupError) as error:
            found = "a footer whose fields have other types"
            raise MapFormatError(path, "a whole Parquet file", found) from error


def _check(file: BinaryIO, path: Path) -> int:
    size = file.seek(0, 2)
    file.seek(size - 8)
    (length,) = struct.unpack("<I", file.read(4))
    end = size - 8 - length
    if end < len(_MAGIC):
        raise MapFormatError(
            path,
            f"a whole Parquet file, whose footer is within its {size} bytes",
            f"a footer of {length}",
            f"byte {size - 8}",
        )
    file.seek(end)
    footer, _ = read_structure(file.read(length))
    scalars = (
        {
            element.get(_NAME_OF)
            for element in footer[_SCHEMA][1:]
            if element.get(_REPETITION) != _REPEATED
        }
        if _SCHEMA in footer
        else set()
    )
    known: list[tuple[int, int]] = []
    bytes_per_row = 0
    for group in footer.get(_GROUPS, []):
        rows = group.get(_GROUP_ROWS, 0)
        in_memory = 0
        for column in group.get(_COLUMNS, []):
            data = column.get(_CHUNK_DATA)
            if data is None or not (rows or data.get(_VALUES)):
                continue  # encrypted, which Arrow says; or without a row, and without a place
            chunk = _chunk(data, end, path)
            is_scalar = len(data[_PATH]) == 1 and data[_PATH][0] in scalars
            _check_pages(file, chunk, path, rows if is_scalar else None)
            known += [(chunk.start, chunk.stop), *_beside(column, data)]
            in_memory += max(data.get(_UNPACKED, 0), _VALUE_BYTES * chunk.values)
        bytes_per_row = max(bytes_per_row, in_memory // max(rows, 1))
    position = len(_MAGIC)
    for start, stop in [*sorted(known), (end, size)]:
        if _begins_page(file, position, start):
            expected = f"no pages but those of the {footer.get(_ROWS)} rows counted"
            raise MapFormatError(path, expected, "another one", f"byte {position}")
        position = max(position, stop)
    return bytes_per_row


def _chunk(data: Structure, end: int, path: Path) -> _Chunk:
    """Return what the footer says of a chunk, which must lie before the footer."""
    start = data.get(_DATA_AT, 0)
    dictionary = data.get(_DICTIONARY_AT) or start
    start = min(start, dictionary) if dictionary > 0 else start
    stop = start + data.get(_PACKED, 0)
    name = b".".join(data[_PATH]).decode("utf-8", "replace")
    if not len(_MAGIC) <= start <= stop <= end:
        expected = f"column {name!r} between bytes {len(_MAGIC)} and {end}"
        raise MapFormatError(path, expected, f"it from {start} to {stop}")
    return _Chunk(name, data.get(_CODEC, 0), data.get(_VALUES, 0), start, stop)


def _beside(column: Structure, data: Structure) -> Iterator[tuple[int, int]]:
    """Yield where a column's indexes and its filter lie."""
    for at, length in _INDEXES:
        if at in column:
            yield column[at], column[at] + column.get(length, 0)
    if _BLOOM_AT in data:
        yield data[_BLOOM_AT], data[_BLOOM_AT] + data.get(_BLOOM_SIZE, 1 << 62)


def _check_pages(file: BinaryIO, chunk: _Chunk, path: Path, rows: int | None) -> None:
    """Check the headers of a chunk's pages, and that they have the values that are counted."""
    position, values = chunk.start, 0
    while position < chunk.stop and values < chunk.values:
        header, size = _page_header(file, position, chunk, path)
        packed, unpacked = header.get(_PACKED_PAGE, -1), header.get(_UNPACKED_PAGE, -1)
        position += size
        most = chunk.stop - position
        if not 0 <= packed <= most:
            _refuse(path, chunk, f"a page of at most {most} bytes", f"{packed}", position)
        most = min(LARGEST_PAGE, packed * _EXPANSION.get(chunk.codec, LARGEST_PAGE) + _SLACK)
        if not 0 <= unpacked <= most:
            expected = f"a page of at most {most} bytes when it is unpacked"
            _refuse(path, chunk, expected, f"{unpacked}", position)
        position += packed
        values += sum(header[kind].get(1, 0) for kind in _DATA_HEADERS if kind in header)
    counted = chunk.values if rows is None else rows
    if rows is not None and chunk.values > rows:
        values = max(values, chunk.values)
    if values > counted:
        _refuse(path, chunk, f"the {counted} values counted", f"{values}", chunk.start)
    if _begins_page(file, position, chunk.stop):
        _refuse(path, chunk, f"no pages but those of {counted} values", "another one", position)


def _page_header(file: BinaryIO, position: int, chunk: _Chunk, path: Path) -> tuple[Structure, int]:
    length = _PAGE_HEADER
    while True:
        file.seek(position)
        try:
            return read_structure(file.read(min(length, chunk.stop - position)))
        except ThriftError as error:
            length *= 16
            if not error.is_short or position + length // 16 >= chunk.stop:
                _refuse(path, chunk, "the header of a page", f"bytes with {error}", position)
            if length > _LONGEST_PAGE_HEADER:
                _refuse(path, chunk, "the header of a page", "a longer one", position)


def _begins_page(file: BinaryIO, start: int, stop: int) -> bool:
    """Tell whether a page with values begins at a byte. Writers leave other things there."""
    if stop <= start:
        return False
    file.seek(start)
    try:
        header, _ = read_structure(file.read(min(_PAGE_HEADER, stop - start)))
    except ThriftError:
        return False
    kinds = [header[kind] for kind in _PAGE_HEADERS if kind in header]
    return any(isinstance(kind, dict) and kind.get(1, 0) != 0 for kind in kinds)


def _refuse(path: Path, chunk: _Chunk, expected: str, found: str, at: int) -> NoReturn:
    raise MapFormatError(path, f"{expected} in column {chunk.name!r}", found, f"byte {at}")
