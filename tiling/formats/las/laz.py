"""Compressed points (LAZ) as a stream, through lazrs, whatever the file claims of them.

lazrs believes what it reads: it reserves memory for as many chunks, and as many bytes in a layer,
as the file announces. So it is shown one stretch of compressed bytes at a time, whose sizes have
been walked beforehand, followed by a chunk table without entries.
"""

import io
import struct
from importlib import import_module
from importlib.util import find_spec
from typing import Any, BinaryIO, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.las.header import LasHeader
from tiling.formats.las.laz_chunks import (
    comes_from_lazrs,
    knows_chunks,
    split_into_chunks,
    split_into_stretches,
)
from tiling.formats.las.laz_header import Compression

lazrs: Any = import_module("lazrs")  # without types that a checker can use

_CHUNK_TABLE_WITHOUT_ENTRIES = bytes(8)
_PASSED_AT_A_TIME = 50_000
"""Points decompressed at a time only to come to those after them."""

_MOST_UNREAD = 1
"""Bytes that a decompressor may leave at the end; one more point takes more but in rare cases."""


class PointSource(Protocol):
    """Where the points of a file come from, in order."""

    def read_into(self, records: NDArray[np.uint8]) -> None:
        """Fill (n, record_length) with the next n points."""


class LazPoints:
    """Decompresses the points of a LAZ file from a row on, in order.

    Parameters
    ----------
    file : BinaryIO
        The file, open for as long as this object is used.
    header : LasHeader
        Its header.
    compression : Compression
        Its laszip VLR.
    rows : range
        The points that will be read.

    Raises
    ------
    MapFormatError
        When chunks or layers contradict the file's size.
    """

    def __init__(
        self, file: BinaryIO, header: LasHeader, compression: Compression, rows: range
    ) -> None:
        self._file = file
        self._header = header
        self._compression = compression
        self._stretches = split_into_stretches(file, header, compression, rows)
        self._left_in_stretch = 0
        self._window: _Window | None = None
        self._decompressor: Any | None = None
        self._row = 0
        self._first_row = rows.start

    def read_into(self, records: NDArray[np.uint8]) -> None:
        """Decompress the next points.

        Parameters
        ----------
        records : (n, record_length) uint8 array
            Where the next n points go; contiguous.

        Raises
        ------
        MapFormatError
            When the compressed bytes end too early or make no sense.
        """
        if self._decompressor is None:
            self._pass_over_points_before_range()
        done = 0
        while done < len(records):
            if self._left_in_stretch == 0:
                self._open_next_stretch()
            count = min(len(records) - done, self._left_in_stretch)
            self._decompress(records[done : done + count])
            self._left_in_stretch -= count
            done += count
        if not self._compression.has_chunks and self._row + done == self._header.point_count:
            _refuse_unread(self._header, self._decompressor, 0)
        if self._compression.needs_laszip:
            self._check_single_channel(records)
        self._row += len(records)

    def _pass_over_points_before_range(self) -> None:
        """Decompress what precedes the first row in its chunk."""
        self._open_next_stretch()
        while self._row < self._first_row:
            count = min(self._first_row - self._row, self._left_in_stretch, _PASSED_AT_A_TIME)
            self._decompress(np.empty((count, self._header.record_length), dtype=np.uint8))
            self._left_in_stretch -= count
            self._row += count
            if self._left_in_stretch == 0 and self._row < self._first_row:
                self._open_next_stretch()

    def _open_next_stretch(self) -> None:
        stretch = next(self._stretches, None)
        if stretch is None:
            raise MapFormatError(
                self._header.path,
                f"{self._header.point_count} points",
                f"chunks of {self._row} or more, but not as many",
            )
        self._row = stretch.first_row
        self._left_in_stretch = stretch.points
        has_chunks = self._compression.has_chunks
        self._window = _Window(self._file, stretch.start, stretch.end, has_chunks)
        data = self._compression.for_stretch(stretch.chunk_size)
        try:
            self._decompressor = lazrs.LasZipDecompressor(self._window, data)
        except BaseException as error:
            self._refuse_points(error)

    def _decompress(self, records: NDArray[np.uint8]) -> None:
        assert self._decompressor is not None
        try:
            self._decompressor.decompress_many(records.reshape(-1))
        except BaseException as error:
            self._refuse_points(error)

    def _refuse_points(self, error: BaseException) -> NoReturn:
        if comes_from_lazrs(error) and self._window is not None and self._window.fault is not None:
            raise self._window.fault
        refuse_points(self._header, self._row, error)

    def _check_single_channel(self, records: NDArray[np.uint8]) -> None:
        """Refuse several scanner channels where lazrs would give wrong values for them."""
        channels = np.unique((records[:, 15] >> 4) & 3)
        if len(channels) > 1 or channels[0] != 0:
            raise MapFormatError(
                self._header.path,
                "LASzip items of version 3, or the package laszip to read version 4 with",
                "version 4 with several scanner channels, and no laszip",
            )


def check_last_chunk(file: BinaryIO, header: LasHeader, compression: Compression) -> None:
    """Check that the last chunk ends with the last point that the header counts.

    Only points that are not in layers need to be decompressed for that; and nothing is checked
    where it is not known where the chunk begins, or where there are no chunks.

    Raises
    ------
    MapFormatError
        When there is more in it.
    """
    if compression.has_layers or not knows_chunks(file, header, compression):
        return
    rows = range(header.point_count - 1, header.point_count)
    for chunk in split_into_chunks(file, header, compression, rows):
        window = _Window(file, chunk.start, chunk.end, has_chunks=True)
        try:
            data = compression.for_stretch(chunk.chunk_size)
            decompressor = lazrs.LasZipDecompressor(window, data)
            for first in range(0, chunk.points, _PASSED_AT_A_TIME):
                count = min(_PASSED_AT_A_TIME, chunk.points - first)
                decompressor.decompress_many(np.empty(count * header.record_length, np.uint8))
        except BaseException as error:
            refuse_points(header, chunk.first_row, error)
        _refuse_unread(header, decompressor, len(_CHUNK_TABLE_WITHOUT_ENTRIES))


def _refuse_unread(header: LasHeader, decompressor: Any, after: int) -> None:
    """Refuse compressed bytes behind the last point; `after` of them are no points."""
    byte = np.empty(1, dtype=np.uint8)
    unread = -after
    try:
        while unread <= _MOST_UNREAD:
            decompressor.read_raw_bytes_into(byte)
            unread += 1
    except BaseException as error:
        if not comes_from_lazrs(error):
            raise
        return
    expected = f"no points but the {header.point_count} counted"
    raise MapFormatError(header.path, expected, "further compressed bytes behind them")


def refuse_points(header: LasHeader, row: int, error: BaseException) -> NoReturn:
    """Turn an error of lazrs into the file's, unless it is not about what the file holds."""
    if not comes_from_lazrs(error):
        raise error
    raise MapFormatError(
        header.path,
        f"{header.point_count} compressed points from byte {header.points_offset}",
        f"data that lazrs cannot read after point {row} ({error})",
    ) from error


class _Window(io.RawIOBase):
    """Part of a file as a file of its own, dressed as lazrs expects compressed points.

    Attributes
    ----------
    fault : OSError or None
        Why the file could not be read; lazrs keeps no more of it than a text.
    """

    def __init__(self, file: BinaryIO, start: int, end: int, has_chunks: bool) -> None:
        super().__init__()
        self.fault: OSError | None = None
        self._file = file
        self._start = start
        size = end - start
        self._head = struct.pack("<q", 8 + size) if has_chunks else b""
        self._tail_start = len(self._head) + size
        self._tail = _CHUNK_TABLE_WITHOUT_ENTRIES if has_chunks else b""
        self._size = self._tail_start + len(self._tail)
        self._position = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        base = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._size}[whence]
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


def laszip_is_installed() -> bool:
    """Tell whether the package laszip, the binding of LASzip itself, can be imported."""
    return find_spec("laszip") is not None


class LaszipPoints:
    """Decompresses with LASzip itself what lazrs cannot, see `Compression.needs_laszip`.

    Parameters
    ----------
    file : BinaryIO
        The file, open for as long as this object is used.
    header : LasHeader
        Its header.
    compression : Compression
        Its laszip VLR.
    rows : range
        The points that will be read.

    Raises
    ------
    MapFormatError
        When chunks or layers contradict the file's size.
    """

    def __init__(
        self, file: BinaryIO, header: LasHeader, compression: Compression, rows: range
    ) -> None:
        for _ in split_into_stretches(file, header, compression, range(header.point_count)):
            pass
        laspy: Any = import_module("laspy")
        self._header = header
        file.seek(0)
        try:
            self._reader = laspy.open(
                file, laz_backend=laspy.LazBackend.Laszip, read_evlrs=False, closefd=False
            )
            if rows.start:
                self._reader.seek(rows.start)
        except Exception as error:
            self._refuse_points(error)

    def read_into(self, records: NDArray[np.uint8]) -> None:
        """Decompress the next points into (n, record_length)."""
        try:
            data = self._reader.read_points(len(records)).array.tobytes()
            records[:] = np.frombuffer(data, dtype=np.uint8).reshape(records.shape)
        except Exception as error:
            self._refuse_points(error)

    def _refuse_points(self, error: Exception) -> NoReturn:
        raise MapFormatError(
            self._header.path,
            f"{self._header.point_count} compressed points from byte {self._header.points_offset}",
            f"data that LASzip cannot read ({error})",
        ) from error
