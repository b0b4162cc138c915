"""Writes a LAS or LAZ file with the header, VLRs and EVLRs of another, byte for byte.

Only what depends on the points is set anew: their number, in all and by return, their bounds, and
the places of what follows them.
"""

import io
import struct
from importlib import import_module
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tiling.formats.base import MapWriter
from tiling.formats.las_header import (
    AT_BOUNDS,
    AT_COUNT,
    AT_FIRST_EVLR,
    AT_GPS_TIME_BOUNDS,
    AT_LEGACY_COUNT,
    AT_POINTS_OFFSET,
    AT_VLR_COUNT,
    AT_WAVEFORMS,
    RECORD_LENGTHS,
    LasHeader,
    VariableLengthRecord,
)
from tiling.formats.laz_header import Compression, is_laszip_record, own_compression

# It has no types that a checker can use.
lazrs: Any = import_module("lazrs")

_COPY_STEP = 1 << 20
_CHUNK = 50_000
"""Points in a chunk, where this module says how many."""
_LARGEST_CHUNK = 1_000_000
"""Points; a chunk of layers is held in memory until it is full."""
_LAYERED_WAVE_PACKETS = (9, 10)
"""Point formats whose wave packets lazrs gets wrong in chunks of several scanner channels."""
_WITHOUT_GPS_TIME = (0, 2)


def is_copc_index(record: VariableLengthRecord) -> bool:
    """Tell whether a record says where COPC's nodes lie (COPC 1.0, info VLR and hierarchy)."""
    return record.names("copc", 1) or record.names("copc", 1000)


class LasWriter(MapWriter):
    """Writes raw point records under the header of the file they come from.

    Parameters
    ----------
    path : Path
        The file to write.
    point_count : int
        Points it will hold.
    header : LasHeader
        Of the file that the points come from; it must still be there.
    compression : Compression or None
        How that file's points are compressed, if they are.
    """

    def __init__(
        self, path: Path, point_count: int, header: LasHeader, compression: Compression | None
    ) -> None:
        super().__init__(path, point_count)
        self._header = header
        self._summary = _Summary(header)
        self._block = bytearray(header.block)
        vlr = None if compression is None else self._settle_compression(compression)
        self._remove_copc_info()
        self._file = path.open("wb")
        try:
            self._file.write(self._block)
            self._points = _LazPoints(self._file, vlr) if vlr else _RawPoints(self._file)
        except BaseException:
            self._file.close()
            raise

    def _remove_copc_info(self) -> None:
        """Take the COPC info VLR out of the block."""
        for record in reversed([r for r in self._header.vlrs if is_copc_index(r)]):
            del self._block[record.start : record.end]
            (count,) = struct.unpack_from("<I", self._block, AT_VLR_COUNT)
            struct.pack_into("<I", self._block, AT_VLR_COUNT, count - 1)
        struct.pack_into("<I", self._block, AT_POINTS_OFFSET, len(self._block))

    def _settle_compression(self, compression: Compression) -> Any:
        """Keep the input's laszip VLR where lazrs writes what it says, else put lazrs's own."""
        point_format = self._header.point_format
        extra_bytes = self._header.record_length - RECORD_LENGTHS[point_format]
        variable_chunks = point_format in _LAYERED_WAVE_PACKETS
        data = own_compression(point_format, extra_bytes, variable_chunks)
        if (
            not variable_chunks
            and compression.can_be_written_as(data)
            and compression.chunk_size <= _LARGEST_CHUNK
        ):
            return lazrs.LazVlr(compression.data)
        # Both have the same items, if not of the same version, and hence the same length.
        record = next(r for r in self._header.vlrs if is_laszip_record(r))
        start = record.end - len(record.data)
        self._block[start : start + len(data)] = data
        return lazrs.LazVlr(data)

    def _append(self, records: NDArray[np.uint8]) -> None:
        records = np.ascontiguousarray(records)
        self._summary.add(records)
        self._points.write(records)

    def _finish(self) -> None:
        with self._file:
            self._points.finish()
            self._file.seek(0, io.SEEK_END)
            self._write_what_follows_points()
            self._summary.write_into(self._block)
            self._file.seek(0)
            self._file.write(self._block)

    def _abandon(self) -> None:
        self._file.close()

    def _write_what_follows_points(self) -> None:
        """Copy EVLRs and waveform packets, and note in the header where they now are."""
        header = self._header
        evlrs = [record for record in header.evlrs if not is_copc_index(record)]
        if header.minor_version >= 4:
            first = self._file.tell() if evlrs else 0
            struct.pack_into("<QI", self._block, AT_FIRST_EVLR, first, len(evlrs))
        moved = {record.start: self._copy(record.start, record.end) for record in evlrs}
        if header.waveforms is not None:
            start, end = header.waveforms
            new_start = moved[start] if start in moved else self._copy(start, end)
            struct.pack_into("<Q", self._block, AT_WAVEFORMS, new_start)

    def _copy(self, start: int, end: int) -> int:
        """Append bytes of the input, and return where they now start."""
        new_start = self._file.tell()
        with self._header.path.open("rb") as source:
            source.seek(start)
            while start < end:
                part = source.read(min(_COPY_STEP, end - start))
                if not part:
                    raise OSError(f"{self._header.path}: cut short while it was read")
                self._file.write(part)
                start += len(part)
        return new_start


class _RawPoints:
    """Writes points as they are."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file

    def write(self, records: NDArray[np.uint8]) -> None:
        """Append (n, record_length) points."""
        self._file.write(records.data)

    def finish(self) -> None:
        """Write what belongs to the points."""


class _LazPoints:
    """Writes points compressed.

    Where the VLR says that chunks vary, one ends where the scanner channel changes: lazrs, unlike
    LASzip, does not restore the wave packet that it remembers of each channel, and so loses them.
    """

    def __init__(self, file: BinaryIO, vlr: Any) -> None:
        self._path = file.name
        self._varies = vlr.uses_variable_size_chunks()
        self._compressor = lazrs.LasZipCompressor(file, vlr)
        self._in_chunk = 0
        self._channel = 0

    def write(self, records: NDArray[np.uint8]) -> None:
        """Append (n, record_length) points."""
        try:
            if self._varies:
                self._write_chunks(records)
            else:
                self._compressor.compress_many(records.reshape(-1))
        except lazrs.LazrsError as error:
            raise OSError(f"{self._path}: {error}") from error

    def _write_chunks(self, records: NDArray[np.uint8]) -> None:
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
                self._compressor.compress_many(records[done : done + count].reshape(-1))
                self._in_chunk += count
                done += count

    def _end_chunk(self) -> None:
        self._compressor.finish_current_chunk()
        self._in_chunk = 0

    def finish(self) -> None:
        """Write what belongs to the points: the last chunk, and the chunk table."""
        try:
            self._compressor.done()
        except lazrs.LazrsError as error:
            raise OSError(f"{self._path}: {error}") from error


class _Summary:
    """What a header says of the points: counts by return, bounds, GPS times."""

    def __init__(self, header: LasHeader) -> None:
        self._header = header
        self._count = 0
        self._returns = np.zeros(16, dtype=np.int64)
        self._lowest = np.full(3, np.iinfo(np.int32).max)
        self._highest = np.full(3, np.iinfo(np.int32).min)
        self._gps_time = (np.inf, -np.inf)

    def add(self, records: NDArray[np.uint8]) -> None:
        """Take at least one more point into account."""
        self._count += len(records)
        grid = np.ascontiguousarray(records[:, :12]).view("<i4")
        self._lowest = np.minimum(self._lowest, grid.min(axis=0))
        self._highest = np.maximum(self._highest, grid.max(axis=0))
        returns = records[:, 14] & (7 if self._header.point_format < 6 else 15)
        self._returns += np.bincount(returns, minlength=16)
        if self._header.minor_version >= 5 and self._header.point_format not in _WITHOUT_GPS_TIME:
            at = 20 if self._header.point_format < 6 else 22
            times = np.ascontiguousarray(records[:, at : at + 8]).view("<f8")
            times = times[np.isfinite(times)]
            if len(times):
                first, last = self._gps_time
                self._gps_time = (min(first, float(times.min())), max(last, float(times.max())))

    def write_into(self, block: bytearray) -> None:
        """Set the fields of a header block that depend on the points."""
        self._write_counts(block)
        self._write_bounds(block)
        first, last = self._gps_time
        if self._header.minor_version >= 5 and (first <= last or self._count == 0):
            times = (last, first) if self._count else (0.0, 0.0)
            struct.pack_into("<2d", block, AT_GPS_TIME_BOUNDS, *times)

    def _write_counts(self, block: bytearray) -> None:
        """Set both generations of counts; the older stays empty where it was, as 1.4 allows."""
        count, by_return = self._count, self._returns[1:].tolist()
        if self._header.minor_version >= 4:
            struct.pack_into("<16Q", block, AT_COUNT, count, *by_return)
            (legacy,) = struct.unpack_from("<I", block, AT_LEGACY_COUNT)
            unused = self._header.point_count > 0 and legacy == 0
            if unused or count > 0xFFFFFFFF:
                count, by_return = 0, [0] * 15
        struct.pack_into("<6I", block, AT_LEGACY_COUNT, count, *by_return[:5])

    def _write_bounds(self, block: bytearray) -> None:
        """Set the bounds; one that is still right keeps its bits, however it was rounded."""
        for axis in range(3):
            scale, offset = self._header.scales[axis], self._header.offsets[axis]
            ends = [self._highest[axis], self._lowest[axis]]
            for place, end in enumerate(ends if scale > 0 else reversed(ends)):
                at = AT_BOUNDS + 16 * axis + 8 * place
                value = float(end) * scale + offset if self._count else 0.0
                (old,) = struct.unpack_from("<d", block, at)
                if not self._count or not abs(old - value) < abs(scale) / 2:
                    struct.pack_into("<d", block, at, value)
