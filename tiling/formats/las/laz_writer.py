"""Writes a LAZ file with the header, VLRs and EVLRs of another, byte for byte."""

import io
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tiling.formats.base import StreamWriter
from tiling.formats.las.compression import Compression, own_compression
from tiling.formats.las.header import LasHeader
from tiling.formats.las.laz import LARGEST_PARALLEL_CHUNK
from tiling.formats.las.metadata import LasSummary, LasSurroundings

lazrs: Any = import_module("lazrs")  # without types that a checker can use

_CHUNK = 50_000
"""Points in a chunk, where this module says how many."""
_LARGEST_CHUNK = 1_000_000
"""Points; a chunk of layers is held in memory until it is full."""
_LAYERED_WAVE_PACKETS = (9, 10)
"""Point formats whose wave packets lazrs gets wrong in chunks of several scanner channels."""


class LazWriter(StreamWriter):
    """Writes raw point records, compressed, under the header of the file they come from.

    That file must still be there, and its points are compressed in the same way. The threads, see
    `usable_threads`, change nothing about what is written.
    """

    def __init__(
        self,
        path: Path,
        point_count: int,
        header: LasHeader,
        compression: Compression,
        threads: int,
    ) -> None:
        data = _followed_compression(header, compression)
        self._las = LasSurroundings(header, data)
        self._summary = LasSummary.of(header)
        super().__init__(path, point_count, self._las)
        try:
            vlr = lazrs.LazVlr(compression.data if data is None else data)
            self._points = _chunks(self._file, vlr, point_count, threads)
        except BaseException:
            self._file.close()
            raise

    def _append(self, records: NDArray[np.uint8]) -> None:
        records = np.ascontiguousarray(records)
        self._summary.add(records)
        try:
            self._points.write(records)
        except lazrs.LazrsError as error:
            raise OSError(f"{self.path}: {error}") from error

    def _finish(self) -> None:
        with self._file:
            try:
                self._points.finish()
            except lazrs.LazrsError as error:
                raise OSError(f"{self.path}: {error}") from error
            points_end = self._file.seek(0, io.SEEK_END)
            self._las.write_after(self._file)
            self._file.seek(0)
            self._file.write(self._las.completed(points_end, self._summary))


def _followed_compression(header: LasHeader, compression: Compression) -> bytes | None:
    """Return the data of lazrs's own laszip VLR, None where it writes what the input's says."""
    variable_chunks = header.point_format in _LAYERED_WAVE_PACKETS
    # Both have the same items, if not of the same version, and hence the same length.
    data = own_compression(header, variable_chunks)
    follows = compression.can_be_written_as(data) and compression.chunk_size <= _LARGEST_CHUNK
    return None if follows and not variable_chunks else data


def _chunks(file: BinaryIO, vlr: Any, point_count: int, threads: int) -> "_Chunks":
    """Choose how to compress."""
    if vlr.uses_variable_size_chunks():
        return _ChannelChunks(file, vlr)
    size = vlr.chunk_size()
    if threads > 1 and size < point_count and size * vlr.item_size() <= LARGEST_PARALLEL_CHUNK:
        return _ParallelChunks(file, vlr, threads)
    return _Chunks(lazrs.LasZipCompressor(file, vlr))


class _Chunks:
    """Compresses points as they come, in chunks of one size."""

    def __init__(self, compressor: Any) -> None:
        self._compressor = compressor

    def write(self, records: NDArray[np.uint8]) -> None:
        """Append (n, record_length) points."""
        self._compressor.compress_many(records.reshape(-1))

    def finish(self) -> None:
        """Write what belongs to the points: the last chunk, and the chunk table."""
        self._compressor.done()


class _ParallelChunks(_Chunks):
    """Compresses as many chunks of one size at a time as there are threads."""

    def __init__(self, file: BinaryIO, vlr: Any, threads: int) -> None:
        super().__init__(lazrs.ParLasZipCompressor(file, vlr))
        self._gathered = np.empty((threads * vlr.chunk_size(), vlr.item_size()), dtype=np.uint8)
        self._count = 0

    def write(self, records: NDArray[np.uint8]) -> None:
        done = 0
        while done < len(records):
            count = min(len(self._gathered) - self._count, len(records) - done)
            self._gathered[self._count : self._count + count] = records[done : done + count]
            self._count += count
            done += count
            if self._count == len(self._gathered):
                self._write_gathered()

    def finish(self) -> None:
        if self._count:
            self._write_gathered()
        super().finish()

    def _write_gathered(self) -> None:
        super().write(self._gathered[: self._count])
        self._count = 0


class _ChannelChunks(_Chunks):
    """Ends a chunk where the scanner channel changes: lazrs mixes up the channels' wave packets."""

    def __init__(self, file: BinaryIO, vlr: Any) -> None:
        super().__init__(lazrs.LasZipCompressor(file, vlr))
        self._in_chunk = 0
        self._channel = 0

    def write(self, records: NDArray[np.uint8]) -> None:
        channels = (records[:, 15] >> 4) & 3
        starts = [0, *(np.flatnonzero(np.diff(channels)) + 1).tolist()]
        for start, end in zip(starts, [*starts[1:], len(records)], strict=True):
            if self._in_chunk and channels[start] != self._channel:
                self._end_chunk()
            self._channel = int(channels[start])
            done = start
            while done < end:
                if self._in_chunk == _CHUNK:
                    self._end_chunk()
                count = min(end - done, _CHUNK - self._in_chunk)
                super().write(records[done : done + count])
                self._in_chunk += count
                done += count

    def _end_chunk(self) -> None:
        self._compressor.finish_current_chunk()
        self._in_chunk = 0
