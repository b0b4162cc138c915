"""Compressed points (LAZ) as a stream, through lazrs, whatever the file claims of them.

lazrs believes what it reads: it reserves memory for as many chunks, and as many bytes in a layer,
as the file announces. So it is shown chunks that have been checked beforehand, followed by a chunk
table without entries.
"""

import io
import os
import struct
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from itertools import chain, islice
from typing import Any, BinaryIO, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.las.compression import Chunk, Compression, comes_from_lazrs, find_chunks
from tiling.formats.las.header import LasHeader

lazrs: Any = import_module("lazrs")  # without types that a checker can use

LARGEST_PARALLEL_CHUNK = 1 << 26
"""Bytes of points in a chunk; longer ones are not held in memory, one for each thread."""

_CHUNK_TABLE_WITHOUT_ENTRIES = bytes(8)
_PASSED_AT_A_TIME = 50_000
"""Points decompressed at a time only to come to those after them."""

_MOST_UNREAD = 1
"""Bytes that a decompressor may leave at the end; one more point takes more but in rare cases."""


class PointSource(Protocol):
    """Where the points of a file come from, in order."""

    def read_into(self, records: NDArray[np.uint8]) -> None:
        """Fill (n, record_length) with the next n points."""


def usable_threads(threads: int) -> int:
    """Return how many threads lazrs can be given: those wanted, or 1.

    lazrs hands the chunks of a call to a pool of threads that the whole process shares, one to
    each: so no more are busy than chunks are handed over. A process forked from one that has used
    the pool has no threads in its copy of it, and would wait for them for ever.
    """
    return threads if threads > 1 and _owner_of_pool() == os.getpid() else 1


@cache
def _owner_of_pool() -> int:
    """Return the process that first used the pool; what is remembered outlives a fork."""
    return os.getpid()


@dataclass
class LazPoints:
    """Decompresses some rows of the points of a LAZ file, in order.

    The file stays open for as long as this object is used. As many chunks are decompressed at a
    time as there are threads, see `usable_threads`.
    """

    file: BinaryIO
    header: LasHeader
    compression: Compression
    rows: range
    threads: int

    def __post_init__(self) -> None:
        """Find the chunks, of which none is read yet."""
        self._chunks = find_chunks(self.file, self.header, self.compression, self.rows)
        self._ready: PointSource | None = None
        self._left = 0
        self._row = self.rows.start

    def read_into(self, records: NDArray[np.uint8]) -> None:
        """Decompress the next points into (n, record_length), contiguous.

        Refused are bytes that end too early or make no sense, and chunks beyond the file's size.
        """
        done = 0
        while done < len(records):
            if not self._left:
                self._open_next_chunks()
            assert self._ready is not None
            count = min(len(records) - done, self._left)
            self._ready.read_into(records[done : done + count])
            self._left -= count
            self._row += count
            done += count

    def _open_next_chunks(self) -> None:
        chunks = list(islice(self._chunks, self.threads))
        if not chunks:
            found = f"chunks of {self._row} or more, but not as many"
            raise MapFormatError(self.header.path, f"{self.header.point_count} points", found)
        if self.threads > 1 and self._can_be_read_at_once(chunks):
            self._ready = _Decompressed(self.file, self.header, self.compression, chunks)
        else:
            self._chunks = chain(chunks[1:], self._chunks)
            chunks = chunks[:1]
            self._ready = _Stream(self.file, self.header, self.compression, chunks[0])
        self._left = chunks[-1].first_row + chunks[-1].points - chunks[0].first_row
        passed_over = self._row - chunks[0].first_row
        while passed_over:
            count = min(passed_over, _PASSED_AT_A_TIME)
            self._ready.read_into(np.empty((count, self.header.record_length), dtype=np.uint8))
            self._left -= count
            passed_over -= count

    def _can_be_read_at_once(self, chunks: list[Chunk]) -> bool:
        # What is behind the last point is seen by reading its chunk alone, unless it has layers.
        last = chunks[-1].first_row + chunks[-1].points == self.header.point_count
        longest = max(chunk.points for chunk in chunks) * self.header.record_length
        return longest <= LARGEST_PARALLEL_CHUNK and (self.compression.has_layers or not last)


class _Stream:
    """The points of one chunk, or of all where it is not known where they begin."""

    def __init__(
        self, file: BinaryIO, header: LasHeader, compression: Compression, chunk: Chunk
    ) -> None:
        self._header = header
        self._row = chunk.first_row
        # A chunk that ends with the file is not known to end there.
        known = not compression.has_chunks or chunk.end < header.file_size
        self._ends_with_points = known and not compression.has_layers
        self._window = _Window(file, chunk.start, chunk.end, compression.has_chunks)
        try:
            data = compression.for_chunks(chunk.chunk_size)
            self._decompressor = lazrs.LasZipDecompressor(self._window, data)
        except BaseException as error:
            self._refuse(error)

    def read_into(self, records: NDArray[np.uint8]) -> None:
        try:
            self._decompressor.decompress_many(records.reshape(-1))
        except BaseException as error:
            self._refuse(error)
        self._row += len(records)
        if self._ends_with_points and self._row == self._header.point_count:
            self._check_end()

    def _check_end(self) -> None:
        """Refuse compressed bytes behind the last point."""
        byte = np.empty(1, dtype=np.uint8)
        unread = -self._window.bytes_behind
        try:
            while unread <= _MOST_UNREAD:
                self._decompressor.read_raw_bytes_into(byte)
                unread += 1
        except BaseException as error:
            if not comes_from_lazrs(error):
                raise
            return
        expected = f"no points but the {self._header.point_count} counted"
        raise MapFormatError(self._header.path, expected, "further compressed bytes behind them")

    def _refuse(self, error: BaseException) -> NoReturn:
        if comes_from_lazrs(error) and self._window.fault is not None:
            raise self._window.fault
        _refuse_points(self._header, self._row, error)


class _Decompressed:
    """The points of several chunks, decompressed at once by as many threads."""

    def __init__(
        self, file: BinaryIO, header: LasHeader, compression: Compression, chunks: list[Chunk]
    ) -> None:
        table = [(chunk.points, chunk.end - chunk.start) for chunk in chunks]
        count = sum(points for points, _ in table)
        self._points = np.empty((count, header.record_length), dtype=np.uint8)
        file.seek(chunks[0].start)
        data = file.read(chunks[-1].end - chunks[0].start)
        vlr = compression.for_chunks(chunks[0].chunk_size)
        try:
            lazrs.decompress_points_with_chunk_table(data, vlr, self._points.reshape(-1), table)
        except BaseException as error:
            _refuse_points(header, chunks[0].first_row, error)

    def read_into(self, records: NDArray[np.uint8]) -> None:
        records[:] = self._points[: len(records)]
        self._points = self._points[len(records) :]


def _refuse_points(
    header: LasHeader, row: int, error: BaseException, library: str = "lazrs"
) -> NoReturn:
    """Turn an error of a library into the file's, unless it is not about what the file holds."""
    if not comes_from_lazrs(error):
        raise error
    raise MapFormatError(
        header.path,
        f"{header.point_count} compressed points from byte {header.points_offset}",
        f"data that {library} cannot read after point {row} ({error})",
    ) from error


class _Window(io.RawIOBase):
    """Part of a file as a file of its own, dressed as lazrs expects compressed points."""

    def __init__(self, file: BinaryIO, start: int, end: int, has_chunks: bool) -> None:
        super().__init__()
        self.fault: OSError | None = None
        """Why the file could not be read; lazrs keeps no more of it than a text."""
        self._file = file
        self._start = start
        self._head = struct.pack("<q", 8 + end - start) if has_chunks else b""
        self._tail = _CHUNK_TABLE_WITHOUT_ENTRIES if has_chunks else b""
        self.bytes_behind = len(self._tail)
        self._tail_start = len(self._head) + end - start
        self._position = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = (0, self._position, self._tail_start + self.bytes_behind)[whence]
        self._position = max(0, base + offset)
        return self._position

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        wanted = len(buffer)
        if self._position < len(self._head):
            part = self._head[self._position : self._position + wanted]
        elif self._position < self._tail_start:
            part = self._read_points(min(wanted, self._tail_start - self._position))
        else:
            at = self._position - self._tail_start
            part = self._tail[at : at + wanted]
        buffer[: len(part)] = part
        self._position += len(part)
        return len(part)

    def _read_points(self, size: int) -> bytes:
        try:
            self._file.seek(self._start + self._position - len(self._head))
            return self._file.read(size)
        except OSError as fault:
            self.fault = fault
            raise


class LaszipPoints:
    """Decompresses with LASzip itself what lazrs cannot, see `Compression.needs_laszip`."""

    def __init__(
        self, file: BinaryIO, header: LasHeader, compression: Compression, rows: range
    ) -> None:
        for _ in find_chunks(file, header, compression, range(header.point_count)):
            pass
        laspy: Any = import_module("laspy")
        self._header = header
        self._row = rows.start
        file.seek(0)
        try:
            self._reader = laspy.open(
                file, laz_backend=laspy.LazBackend.Laszip, read_evlrs=False, closefd=False
            )
            if rows.start:
                self._reader.seek(rows.start)
        except Exception as error:
            _refuse_points(header, self._row, error, "LASzip")

    def read_into(self, records: NDArray[np.uint8]) -> None:
        """Decompress the next points into (n, record_length)."""
        try:
            data = self._reader.read_points(len(records)).array.tobytes()
            records[:] = np.frombuffer(data, dtype=np.uint8).reshape(records.shape)
        except Exception as error:
            _refuse_points(self._header, self._row, error, "LASzip")
        self._row += len(records)
