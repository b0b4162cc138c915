"""How large the pages of a Parquet file say they are, before Arrow takes the memory that they ask.

Arrow believes the header of a page: one that is damaged has it take 2 GiB. The headers are in
Thrift's compact protocol, of which no more is read here than what they say of sizes.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, BinaryIO

from tiling.errors import MapFormatError

LARGEST_PAGE = 1 << 28
"""Bytes, packed or not: a page is in memory as a whole."""

_HEADER = 1 << 9
_LONGEST_HEADER = 1 << 24
"""Bytes: as Arrow has it."""

_ENDING = 8

_GROUPS, _COLUMNS, _DATA = 4, 1, 3
_VALUES, _PACKED, _FIRST_PAGE, _DICTIONARY = 5, 7, 9, 11
_WANTED = {_GROUPS: {_COLUMNS: {_DATA: {_VALUES: 0, _PACKED: 0, _FIRST_PAGE: 0, _DICTIONARY: 0}}}}
_UNPACKED_PAGE, _PACKED_PAGE = 2, 3
"""Numbers of fields in parquet.thrift."""

_DAMAGED = (IndexError, ValueError, RecursionError)

Chunks = list[list[tuple[int, int]]]
"""For each row group, where the pages of its columns begin, and where they end."""


def find_chunks(path: Path) -> Chunks:
    """Find where the pages of a file lie; nowhere where Arrow must say what is wrong with it."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(size - _ENDING, 0))
        length = int.from_bytes(file.read(4), "little")
        file.seek(max(size - _ENDING - length, 0))
        footer = file.read(length)
    try:
        groups = _Compact(footer).structure(_WANTED).get(_GROUPS, [])
        return [
            [_chunk(column[_DATA]) for column in group.get(_COLUMNS, []) if column.get(_DATA)]
            for group in groups
        ]
    except (*_DAMAGED, KeyError, TypeError, AttributeError):
        return []


def check_pages(path: Path, chunks: Iterable[tuple[int, int]]) -> None:
    """Refuse pages that say they are larger than the file, or than `LARGEST_PAGE`."""
    with path.open("rb", buffering=0) as file:
        size = path.stat().st_size
        for start, stop in chunks:
            place = start
            while 0 < place < min(stop, size):
                unpacked, packed, length = _header(file, place, path)
                if not (0 <= unpacked <= LARGEST_PAGE and 0 <= packed <= LARGEST_PAGE) or (
                    place + length + packed > size
                ):
                    expected = f"a page within the file, of at most {LARGEST_PAGE} bytes"
                    found = f"one of {packed} bytes, {unpacked} unpacked"
                    raise MapFormatError(path, expected, found, f"byte {place}")
                place += length + packed


def _chunk(data: Mapping[int, Any]) -> tuple[int, int]:
    """Return where the pages of a column begin and end."""
    if not data.get(_VALUES):
        return 0, 0
    start = min(each for each in (data[_FIRST_PAGE], data.get(_DICTIONARY, 0)) if each > 0)
    return start, start + data[_PACKED]


def _header(file: BinaryIO, place: int, path: Path) -> tuple[int, int, int]:
    """Read the header of a page: its sizes unpacked and packed, and the header's own."""
    length = _HEADER
    while True:
        file.seek(place)
        header = _Compact(file.read(length))
        try:
            found = header.structure({_UNPACKED_PAGE: {}, _PACKED_PAGE: {}})
            return int(found[_UNPACKED_PAGE]), int(found[_PACKED_PAGE]), header.place
        except (*_DAMAGED, KeyError, TypeError) as error:
            if not isinstance(error, IndexError) or length >= _LONGEST_HEADER:
                expected = "the header of a page"
                raise MapFormatError(path, expected, "another", f"byte {place}") from error
        length *= 32


class _Compact:
    """Reads a structure in the compact protocol; an IndexError where the bytes end before it."""

    def __init__(self, data: bytes) -> None:
        self._data, self.place = data, 0

    def structure(self, wanted: Mapping[int, Any]) -> dict[int, Any]:
        """Return the fields wanted, by their numbers; of those that are structures, these too."""
        found, number = {}, 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._integer()
            value = self._value(head & 15, wanted.get(number) or {})
            if number in wanted:
                found[number] = value
        return found

    def _value(self, kind: int, wanted: Mapping[int, Any]) -> Any:
        if kind in (1, 2):  # of a field; one in a list has a byte
            return kind == 1
        if kind in (4, 5, 6):
            return self._integer()
        if kind == 12:
            return self.structure(wanted)
        if kind in (9, 10):
            head = self._byte()
            count = head >> 4 if head >> 4 < 15 else self._varint()
            return [self._item(head & 15, wanted) for _ in range(count)]
        if kind == 11:
            count = self._varint()
            kinds = self._byte() if count else 0
            return [self._item(each, {}) for _ in range(count) for each in divmod(kinds, 16)]
        if kind not in (3, 7, 8):
            raise ValueError(f"a field of kind {kind}")
        self._skip(self._varint() if kind == 8 else 8 if kind == 7 else 1)
        return None

    def _item(self, kind: int, wanted: Mapping[int, Any]) -> Any:
        return self._byte() if kind in (1, 2) else self._value(kind, wanted)

    def _skip(self, count: int) -> None:
        self.place += count
        if self.place > len(self._data):
            raise IndexError

    def _byte(self) -> int:
        self.place += 1
        return self._data[self.place - 1]

    def _varint(self) -> int:
        number = shift = 0
        while (byte := self._byte()) > 127:
            number |= (byte & 127) << shift
            shift += 7
        return number | byte << shift

    def _integer(self) -> int:
        number = self._varint()
        return number >> 1 ^ -(number & 1)
