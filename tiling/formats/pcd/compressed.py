"""The data of binary_compressed PCD files: LZF compression of whole columns, as streams.

The format is that of Marc Lehmann's LibLZF: a sequence of instructions, each with a control byte.

- `000LLLLL` and L + 1 bytes: these bytes themselves (1 to 32 of them);
- `LLLDDDDD dddddddd`, L from 1 to 6: L + 2 bytes again, from D * 256 + d + 1 bytes back;
- `111DDDDD llllllll dddddddd`: the same for l + 9 bytes.

A copy reaches back 8192 bytes at most, so a window of that size is all that a decoder must keep,
and blocks compressed on their own make one valid stream when written one after the other.

Neither end of this module holds more than a few MiB, whatever the size of the data.
"""

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import BinaryIO, Self

import numpy as np
from numpy.typing import NDArray

from tiling.compiled import compiled
from tiling.errors import MapFormatError

BLOCK = 1 << 20
"""Bytes read, compressed or decompressed at a time."""

REACH = 1 << 13
"""How far back a copy can reach."""

LONGEST_COPY = 264
LONGEST_LITERAL = 32

EXPANSION = LONGEST_COPY // 3
"""Most bytes that one compressed byte can stand for: the longest copy takes three."""

_HASH_BITS = 16
_DONE, _BEFORE_START = 0, 1

Bytes = NDArray[np.uint8]


def decompress(stream: BinaryIO, packed_size: int, size: int, path: Path) -> Iterator[Bytes]:
    """Decompress the next `packed_size` bytes of a stream into `size` bytes, as the file says.

    They come as (n,) arrays in a buffer that is used again: they must be copied before the next
    step. Data are refused that are truncated, point back before their beginning, or give another
    number of bytes than `size`.
    """
    window = np.empty(REACH + BLOCK, dtype=np.uint8)
    filled = kept = produced = 0
    packed = b""
    start, left = stream.tell(), packed_size

    def wrong(expected: str, found: str) -> MapFormatError:
        return MapFormatError(path, expected, found, f"byte {start}")

    while left or packed:
        block = stream.read(min(BLOCK, left))
        if left and not block:
            raise wrong(f"{packed_size} compressed bytes", "the end of the file")
        left -= len(block)
        packed += block
        used, filled, fault = _decode(np.frombuffer(packed, dtype=np.uint8), window, filled)
        start += used
        packed = packed[used:]
        if fault == _BEFORE_START:
            raise wrong("LZF data", "a copy of bytes before the first")
        produced += filled - kept
        if produced > size:
            raise wrong(f"{size} bytes of LZF data", "more than these")
        if not left and not used and packed:
            raise wrong("LZF data", "an instruction that is cut short")
        yield window[kept:filled]
        # What a copy may still reach moves to the front.
        kept = min(filled, REACH)
        window[:kept] = window[filled - kept : filled].copy()
        filled = kept
    if produced != size:
        raise wrong(f"{size} bytes of LZF data", f"{produced} bytes")


def compress(block: Bytes) -> bytes:
    """Compress a block, (n,) of less than 2 GiB, into n + n / 32 + 1 bytes at most.

    The results of successive blocks make one stream; `BLOCK` bytes are a good size.
    """
    packed = np.empty(len(block) + len(block) // LONGEST_LITERAL + 8, dtype=np.uint8)
    latest = np.full(1 << _HASH_BITS, -1, dtype=np.int32)
    return packed[: _encode(block, packed, latest)].tobytes()


@compiled
def _decode(packed: Bytes, window: Bytes, filled: int) -> tuple[int, int, int]:
    """Decode while the window has room; return bytes used, bytes of it filled, and the fault."""
    position = 0
    while position < len(packed):
        control = int(packed[position])
        if control < LONGEST_LITERAL:
            after = position + control + 2
            if after > len(packed) or filled + control + 1 > len(window):
                break
            for source in range(position + 1, after):
                window[filled] = packed[source]
                filled += 1
        else:
            after = position + (3 if control >> 5 == 7 else 2)
            if after > len(packed):
                break
            length = (control >> 5) + 2
            if control >> 5 == 7:
                length += int(packed[position + 1])
            if filled + length > len(window):
                break
            source = filled - ((control & 31) << 8) - int(packed[after - 1]) - 1
            if source < 0:
                return position, filled, _BEFORE_START
            for _ in range(length):
                window[filled] = window[source]
                filled += 1
                source += 1
        position = after
    return position, filled, _DONE


@compiled
def _encode(block: Bytes, packed: Bytes, latest: NDArray[np.int32]) -> int:
    """Encode a block greedily; `latest` tells of each hash of three bytes where they were last."""
    position = written = literal = 0
    while position + 2 < len(block):
        triple = (
            (int(block[position]) << 16)
            | (int(block[position + 1]) << 8)
            | int(block[position + 2])
        )
        slot = ((triple * 2654435761) & 0xFFFFFFFF) >> (32 - _HASH_BITS)
        source = int(latest[slot])
        latest[slot] = position
        length = 0
        if source >= 0 and position - source <= REACH:
            most = min(LONGEST_COPY, len(block) - position)
            while length < most and block[source + length] == block[position + length]:
                length += 1
        if length < 3:
            position += 1
            continue
        written = _put_literals(block, literal, position, packed, written)
        back = position - source - 1
        if length < 9:
            packed[written] = ((length - 2) << 5) | (back >> 8)
        else:
            packed[written] = (7 << 5) | (back >> 8)
            written += 1
            packed[written] = length - 9
        packed[written + 1] = back & 255
        written += 2
        position += length
        literal = position
    return _put_literals(block, literal, len(block), packed, written)


@compiled
def _put_literals(block: Bytes, start: int, stop: int, packed: Bytes, written: int) -> int:
    """Write the bytes from `start` to `stop` as they are; return where the next go."""
    while start < stop:
        length = min(LONGEST_LITERAL, stop - start)
        packed[written] = length - 1
        packed[written + 1 : written + 1 + length] = block[start : start + length]
        written += 1 + length
        start += length
    return written


class ColumnSpool:
    """Fixed-size records of points, kept on disk as columns, as compressed files hold them.

    Widths are bytes of each column in a record. The file lies in the folder for temporary files
    (`TMPDIR`), has no name, and is gone when it is closed, or when the process ends for whatever
    reason. A context manager that closes it.
    """

    def __init__(self, widths: Sequence[int], point_count: int) -> None:
        self._widths = tuple(widths)
        self._point_count = point_count
        with _blaming_its_folder():
            # Unbuffered, so that a full disk is met where it is written to.
            self._file = TemporaryFile(buffering=0)  # noqa: SIM115 - closed by `__exit__`

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def append(self, data: bytes) -> None:
        """Write the next bytes of the columns, in the file's order."""
        left = memoryview(data)
        with _blaming_its_folder():
            while left:
                left = left[self._file.write(left) :]

    def blocks(self) -> Iterator[NDArray[np.uint8]]:
        """Yield the bytes of all columns, in the file's order."""
        self._file.seek(0)
        while block := self._file.read(BLOCK):
            yield np.frombuffer(block, dtype=np.uint8)

    def write_points(self, first_row: int, records: NDArray[np.void]) -> None:
        """Put the records of consecutive points into their columns."""
        rows = records.view(np.uint8).reshape(len(records), -1)
        for part in self._columns(first_row):
            self.append(rows[:, part].tobytes())

    def read_points(self, first_row: int, count: int) -> NDArray[np.void]:
        """Gather the records of consecutive points from their columns."""
        rows = np.empty((count, sum(self._widths)), dtype=np.uint8)
        for part in self._columns(first_row):
            width = part.stop - part.start
            values = np.frombuffer(self._file.read(count * width), dtype=np.uint8)
            rows[:, part] = values.reshape(count, width)
        return rows.view(f"V{rows.shape[1]}")[:, 0]

    def _columns(self, first_row: int) -> Iterator[slice]:
        """Go to a row of each column in turn; yield the bytes of a record that are in it."""
        start = 0
        for width in self._widths:
            self._file.seek(start * self._point_count + first_row * width)
            yield slice(start, start + width)
            start += width


@contextmanager
def _blaming_its_folder() -> Iterator[None]:
    """Name the folder for temporary files in an error, as the file itself has no name."""
    try:
        yield
    except OSError as error:
        folder = tempfile.gettempdir()
        raise OSError(error.errno, error.strerror, f"{folder} (temporary files)") from error
