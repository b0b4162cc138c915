"""Compressed points (LAZ) as a stream, through lazrs, whatever the file claims of them.

lazrs believes what it reads: it reserves memory for as many chunks, and as many bytes in a layer,
as the file announces. So it is shown one stretch of compressed bytes at a time, whose sizes have
been walked beforehand, followed by a chunk table without entries. LASzip's format is described by
its author (Isenburg 2013, LASzip: lossless compression of LiDAR data) and by its source.
"""

import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from typing import Any, BinaryIO, NoReturn, Protocol

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.las_header import LasHeader
from tiling.formats.laz_header import Compression, refuse

# Neither has types that a checker can use.
laspy: Any = import_module("laspy")
lazrs: Any = import_module("lazrs")

_CHUNK_TABLE_WITHOUT_ENTRIES = bytes(8)
_LARGEST_CHUNK_ENTRY = 16
"""Bytes; an entry of the chunk table is at most two integers of 32 bits and their bit counts."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Compressed bytes of chunks that all have the same number of points."""

    start: int
    end: int
    points: int
    chunk_size: int


class PointSource(Protocol):
    """Where the points of a file come from, in order."""

    def read_into(self, records: NDArray[np.uint8]) -> None:
        """Fill (n, record_length) with the next n points."""


class LazPoints:
    """Decompresses the points of a LAZ file, in order.

    Parameters
    ----------
    file : BinaryIO
        The file, open for as long as this object is used.
    header : LasHeader
        Its header.
    compression : Compression
        Its laszip VLR.

    Raises
    ------
    MapFormatError
        When chunks or layers contradict the file's size.
    """

    def __init__(self, file: BinaryIO, header: LasHeader, compression: Compression) -> None:
        self._file = file
        self._header = header
        self._compression = compression
        self._stretches = split_into_stretches(file, header, compression)
        self._left_in_stretch = 0
        self._decompressor: Any | None = None
        self._row = 0

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
        done = 0
        while done < len(records):
            if self._left_in_stretch == 0:
                self._open_next_stretch()
            count = min(len(records) - done, self._left_in_stretch)
            self._decompress(records[done : done + count])
            self._left_in_stretch -= count
            done += count
        if self._compression.needs_laszip:
            self._check_single_channel(records)
        self._row += len(records)

    def _open_next_stretch(self) -> None:
        stretch = next(self._stretches, None)
        if stretch is None:
            raise MapFormatError(
                self._header.path,
                f"{self._header.point_count} points",
                f"chunks of {self._row} or more, but not as many",
            )
        self._left_in_stretch = stretch.points
        window = _Window(self._file, stretch.start, stretch.end, self._compression.has_chunks)
        data = self._compression.for_stretch(stretch.chunk_size)
        try:
            self._decompressor = lazrs.LasZipDecompressor(window, data)
        except Exception as error:
            self._refuse_points(error)

    def _decompress(self, records: NDArray[np.uint8]) -> None:
        assert self._decompressor is not None
        try:
            self._decompressor.decompress_many(records.reshape(-1))
        except BaseException as error:
            # A panic of lazrs is no Exception, and its class cannot be imported.
            if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
                raise
            self._refuse_points(error)

    def _refuse_points(self, error: BaseException) -> NoReturn:
        raise MapFormatError(
            self._header.path,
            f"{self._header.point_count} compressed points from byte {self._header.points_offset}",
            f"data that lazrs cannot read after point {self._row} ({error})",
        ) from error

    def _check_single_channel(self, records: NDArray[np.uint8]) -> None:
        """Refuse several scanner channels where lazrs would give wrong values for them."""
        channels = np.unique((records[:, 15] >> 4) & 3)
        if len(channels) > 1 or channels[0] != 0:
            raise MapFormatError(
                self._header.path,
                "LASzip items of version 3, or the package laszip to read version 4 with",
                "version 4 with several scanner channels, and no laszip",
            )


def split_into_stretches(
    file: BinaryIO, header: LasHeader, compression: Compression
) -> Iterator[Stretch]:
    """Yield the stretches of a file's points, each checked before it is shown to a decompressor.

    Raises
    ------
    MapFormatError
        When chunks or layers contradict the file's size.
    """
    start, end = header.points_offset, header.file_size
    if header.point_count == 0:
        return
    if not compression.has_chunks:
        yield Stretch(start, end, header.point_count, header.point_count)
    elif compression.has_variable_chunks:
        yield from _split_variable(file, header, compression)
    else:
        start += 8
        if start > end:
            refuse(header, "8 bytes for the offset to the chunk table", "the file's end", end)
        if compression.has_layers:
            chunks = -(-header.point_count // compression.chunk_size)
            end = _walk_layers(file, header, compression, start, end, chunks)
        yield Stretch(start, end, header.point_count, compression.chunk_size)


def _split_variable(
    file: BinaryIO, header: LasHeader, compression: Compression
) -> Iterator[Stretch]:
    """Yield the chunks that the chunk table names, as far as the header counts points."""
    left = header.point_count
    table_start, table = read_chunk_table(file, header, compression)
    start = header.points_offset + 8
    for points, size in table:
        end = start + size
        if end > table_start:
            refuse(
                header,
                f"LAZ chunks up to the chunk table at byte {table_start}",
                f"a chunk of {size} bytes",
                start,
            )
        if points and compression.has_layers:
            _walk_layers(file, header, compression, start, end, 1)
        if points and left:
            yield Stretch(start, end, min(points, left), points)
            left -= min(points, left)
        start = end


def _walk_layers(
    file: BinaryIO,
    header: LasHeader,
    compression: Compression,
    start: int,
    end: int,
    chunks: int,
) -> int:
    """Step over chunks of layers, and return where the last one ends.

    A chunk is its first point, the number of points, the size of each layer, and the layers.
    """
    layers = compression.layers
    head_size = header.record_length + 4 + 4 * layers
    for chunk in range(1, chunks + 1):
        file.seek(start)
        head = file.read(min(head_size, max(end - start, 0)))
        size = head_size
        if len(head) == head_size:
            size += sum(struct.unpack_from(f"<{layers}I", head, head_size - 4 * layers))
        if start + size > end:
            refuse(
                header,
                f"{chunks} LAZ chunks up to byte {end}",
                f"chunk {chunk} of {size} bytes or more",
                start,
            )
        start += size
    return start


def read_chunk_table(
    file: BinaryIO, header: LasHeader, compression: Compression
) -> tuple[int, list[tuple[int, int]]]:
    """Read the chunk table of a LAZ file whose chunks vary in size.

    Returns
    -------
    start : int
        Byte of the chunk table.
    table : list of (int, int)
        Points and bytes of each chunk.

    Raises
    ------
    MapFormatError
        When the table is not where it should be, or too long for what it describes.
    """
    points_offset = header.points_offset
    start = _read_chunk_table_offset(file, header, points_offset)
    smallest_chunk = header.record_length + (4 + 4 * compression.layers) * compression.has_layers
    file.seek(start)
    version, count = struct.unpack("<II", file.read(8))
    if version != 0 or count > (start - points_offset - 8) // smallest_chunk:
        refuse(
            header,
            f"a chunk table of version 0 for {start - points_offset - 8} bytes of points",
            f"version {version} and {count} chunks",
            start,
        )
    file.seek(start)
    window = io.BytesIO(file.read(8 + 64 + _LARGEST_CHUNK_ENTRY * count))
    try:
        table = lazrs.read_chunk_table_only(window, lazrs.LazVlr(compression.data))
    except BaseException as error:
        if not isinstance(error, Exception) and type(error).__name__ != "PanicException":
            raise
        raise MapFormatError(
            header.path, f"a chunk table of {count} chunks", str(error), f"byte {start}"
        ) from error
    return start, [(int(points), int(size)) for points, size in table]


def _read_chunk_table_offset(file: BinaryIO, header: LasHeader, points_offset: int) -> int:
    """Return the byte of the chunk table; a streaming writer leaves it at the file's end."""
    offset = -1
    if header.file_size >= points_offset + 16:
        file.seek(points_offset)
        (offset,) = struct.unpack("<q", file.read(8))
        if offset == -1:
            file.seek(header.file_size - 8)
            (offset,) = struct.unpack("<q", file.read(8))
    if not points_offset + 8 <= offset <= header.file_size - 8:
        refuse(
            header,
            f"a chunk table between the points and the file's end ({header.file_size})",
            f"its offset {offset}",
            points_offset,
        )
    return int(offset)


class _Window(io.RawIOBase):
    """Part of a file as a file of its own, dressed as lazrs expects compressed points."""

    def __init__(self, file: BinaryIO, start: int, end: int, has_chunks: bool) -> None:
        super().__init__()
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
            self._file.seek(self._start + self._position - len(self._head))
            part = self._file.read(min(wanted, self._tail_start - self._position))
        else:
            at = self._position - self._tail_start
            part = self._tail[at : at + wanted]
        buffer[: len(part)] = part
        self._position += len(part)
        return len(part)


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

    Raises
    ------
    MapFormatError
        When chunks or layers contradict the file's size.
    """

    def __init__(self, file: BinaryIO, header: LasHeader, compression: Compression) -> None:
        for _ in split_into_stretches(file, header, compression):
            pass
        self._header = header
        file.seek(0)
        self._reader = laspy.open(
            file, laz_backend=laspy.LazBackend.Laszip, read_evlrs=False, closefd=False
        )

    def read_into(self, records: NDArray[np.uint8]) -> None:
        """Decompress the next points into (n, record_length)."""
        try:
            data = self._reader.read_points(len(records)).array.tobytes()
            records[:] = np.frombuffer(data, dtype=np.uint8).reshape(records.shape)
        except Exception as error:
            raise MapFormatError(
                self._header.path,
                f"{self._header.point_count} compressed points",
                f"data that LASzip cannot read ({error})",
            ) from error
