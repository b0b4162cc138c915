"""The public header block of a LAS file and the variable length records around its points.

Every count and offset is checked against the file's size before it is used. Byte positions are
those of the ASPRS LAS specification, 1.4 R15 (table 3) and 1.5.
"""

import math
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, BinaryIO

from tiling.errors import MapFormatError
from tiling.formats.checks import SIGNATURE_LENGTH, kind_of

SMALLEST_HEADER = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375, 5: 393}
"""Bytes of the public header block by minor version."""
RECORD_LENGTHS = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of a point by point format, without extra bytes."""


class At:
    """Bytes of the public header block at which its fields begin."""

    GLOBAL_ENCODING = 6
    MINOR_VERSION = 25
    HEADER_SIZE = 94
    POINTS_OFFSET = 96
    VLR_COUNT = 100
    POINT_FORMAT = 104
    RECORD_LENGTH = 105
    LEGACY_COUNT = 107
    SCALES = 131
    OFFSETS = 155
    BOUNDS = 179
    WAVEFORMS = 227
    FIRST_EVLR = 235
    COUNT = 247
    GPS_TIME_BOUNDS = 375


WAVEFORMS_EXTERNAL = 0b100
"""Bit of the global encoding: waveform packets are in a `.wdp` file."""

CRS_USER_ID = "LASF_Projection"
"""Who registered the records of the coordinate reference system."""

_VLR_HEADER = 54
_EVLR_HEADER = 60
_COMPRESSED = 0x80
_LARGEST_GRID_COORDINATE = 1 << 31
_LARGEST_BLOCK = 1 << 27
"""Bytes before the points, which are held in memory as a whole."""
_LARGEST_CRS = 1 << 20
"""Bytes of an EVLR of a coordinate reference system; no other EVLR is looked into."""


@dataclass(frozen=True, slots=True)
class VariableLengthRecord:
    """One VLR or EVLR."""

    user_id: str
    record_id: int
    """Who registered it, and what it is."""
    start: int
    end: int
    """Bytes of the file: those of the whole record, its header included."""
    data: bytes
    """The record's own data; of an EVLR, only where it is of the coordinate reference system."""

    def names(self, user_id: str, record_id: int) -> bool:
        """Tell whether this is the record registered under these names."""
        return (self.user_id, self.record_id) == (user_id, record_id)


@dataclass(frozen=True, slots=True)
class LasHeader:
    """What precedes the points, as bytes, and what it says."""

    path: Path
    file_size: int
    block: bytes
    """Everything before the points: header, VLRs, and whatever else is there."""
    minor_version: int
    """x of LAS 1.x, of the latest whose fields the header has room for."""
    point_format: int
    """0 to 10."""
    compressed: bool
    record_length: int
    """Bytes of a point, extra bytes included."""
    point_count: int
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    vlrs: tuple[VariableLengthRecord, ...]
    evlrs: tuple[VariableLengthRecord, ...]
    """Before and after the points."""
    waveforms: tuple[int, int] | None
    """First byte, and byte after the last, of the waveform packets inside the file."""
    cut_off: int | None = None
    """Where an EVLR begins that the file ends in."""
    notes: tuple[str, ...] = ()
    """What the header says of itself that is not so, and does no harm."""

    @property
    def points_offset(self) -> int:
        """Byte of the first point."""
        return len(self.block)

    @property
    def extra_bytes(self) -> int:
        """Bytes of a point behind the fields of its format."""
        return self.record_length - RECORD_LENGTHS[self.point_format]

    @property
    def public_size(self) -> int:
        """Bytes of the public header block."""
        return int(struct.unpack_from("<H", self.block, At.HEADER_SIZE)[0])


def read_header(path: Path) -> LasHeader:
    """Read everything of a LAS or LAZ file but its points; refuse what contradicts its size."""
    with path.open("rb") as file:
        return _HeaderReader(path, file).read()


class _HeaderReader:
    """Reads what an open file says of itself, from its public header block on."""

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path = path
        self._file = file
        self._size = path.stat().st_size
        self._notes: list[str] = []
        self._minor, self._header = self._public_header()

    def read(self) -> LasHeader:
        point_format, compressed, record_length = self._point_layout()
        (legacy_count,) = self._unpack("<I", At.LEGACY_COUNT)
        # Since 1.4 the field of 64 bits, unless only the older is filled.
        count = (self._unpack("<Q", At.COUNT)[0] if self._minor >= 4 else 0) or legacy_count
        start = self._points_offset()
        room = (self._size - start) // record_length
        if not compressed and count > room:
            expected = f"{count} points of {record_length} bytes from byte {start}"
            raise self._wrong(expected, f"room for {room}: the file ends", self._size)
        scales, offsets = self._grid()
        self._file.seek(0)
        block = bytearray(self._file.read(start))
        vlrs = read_vlrs(block)
        self._note_missing("VLR", self._unpack("<I", At.VLR_COUNT)[0], len(vlrs))
        struct.pack_into("<I", block, At.VLR_COUNT, len(vlrs))
        promised, evlrs, end = self._evlrs(start)
        self._note_missing("EVLR", promised, len(evlrs))
        return LasHeader(
            path=self._path,
            file_size=self._size,
            block=bytes(block),
            minor_version=self._minor,
            point_format=point_format,
            compressed=compressed,
            record_length=record_length,
            point_count=count,
            scales=scales,
            offsets=offsets,
            vlrs=vlrs,
            evlrs=evlrs,
            waveforms=self._waveforms(start),
            cut_off=end if promised > len(evlrs) and start <= end < self._size else None,
            notes=tuple(self._notes),
        )

    def _unpack(self, form: str, at: int) -> tuple[Any, ...]:
        return struct.unpack_from(form, self._header, at)

    def _wrong(self, expected: str, found: str, byte: int) -> MapFormatError:
        return MapFormatError(self._path, expected, found, f"byte {byte}")

    def _note_missing(self, kind: str, promised: int, found: int) -> None:
        """Say where a header counts more records than there are; nobody can tell what they held."""
        if promised != found:
            self._notes.append(
                f"The header counts {promised} {kind}s, but the file has {found}, as the outputs "
                "will."
            )

    def _public_header(self) -> tuple[int, bytes]:
        """Return the minor version whose fields are there, and the public header block."""
        header = self._file.read(SMALLEST_HEADER[5])
        if header[:4] != b"LASF":
            raise self._wrong('the LAS signature "LASF"', kind_of(header[:SIGNATURE_LENGTH]), 0)
        if self._size < SMALLEST_HEADER[0]:
            expected = f"a header of {SMALLEST_HEADER[0]} bytes"
            raise MapFormatError(self._path, expected, f"the file's end at byte {self._size}")
        major, minor = header[24], header[25]
        if major != 1 or minor not in SMALLEST_HEADER:
            raise self._wrong("LAS version 1.0 to 1.5", f"{major}.{minor}", 24)
        (size,) = struct.unpack_from("<H", header, At.HEADER_SIZE)
        whole = SMALLEST_HEADER[minor]
        if not SMALLEST_HEADER[0] <= size <= self._size:
            expected = f"a header of {whole} bytes or more within the file's {self._size}"
            raise self._wrong(expected, f"header size {size}", At.HEADER_SIZE)
        if size < whole:
            self._notes.append(
                f"The header has {size} bytes, and that of LAS 1.{minor} has {whole}: what should "
                "follow is taken as not there."
            )
            minor = max(each for each, smallest in SMALLEST_HEADER.items() if smallest <= size)
        return minor, header[:size]

    def _point_layout(self) -> tuple[int, bool, int]:
        """Return point format, whether it is compressed, and the bytes of a point."""
        stored = self._header[At.POINT_FORMAT]
        point_format = stored & ~_COMPRESSED
        if point_format >= len(RECORD_LENGTHS):
            raise self._wrong("point format 0 to 10", f"{point_format}", At.POINT_FORMAT)
        (length,) = self._unpack("<H", At.RECORD_LENGTH)
        least = RECORD_LENGTHS[point_format]
        if length < least:
            expected = f"points of {least} bytes or more (point format {point_format})"
            raise self._wrong(expected, f"{length} bytes", At.RECORD_LENGTH)
        return point_format, bool(stored & _COMPRESSED), length

    def _points_offset(self) -> int:
        (offset,) = self._unpack("<I", At.POINTS_OFFSET)
        (end,) = self._unpack("<H", At.HEADER_SIZE)
        if not end <= offset <= self._size:
            expected = f"points between the header's end ({end}) and the file's ({self._size})"
            raise self._wrong(expected, f"offset to points {offset}", At.POINTS_OFFSET)
        if offset > _LARGEST_BLOCK:
            expected = f"at most {_LARGEST_BLOCK} bytes before the points"
            raise self._wrong(expected, f"{offset}", At.POINTS_OFFSET)
        return int(offset)

    def _grid(self) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
        """Return scales and offsets, which no integer takes beyond what is finite."""
        scales: tuple[float, float, float] = struct.unpack_from("<3d", self._header, At.SCALES)
        offsets: tuple[float, float, float] = struct.unpack_from("<3d", self._header, At.OFFSETS)
        for axis, (scale, offset) in enumerate(zip(scales, offsets, strict=True)):
            if scale == 0 or not math.isfinite(abs(scale) * _LARGEST_GRID_COORDINATE + abs(offset)):
                expected = (
                    f"a scale of {'xyz'[axis]} other than 0, and an offset, of finite coordinates"
                )
                place = f"bytes {At.SCALES + 8 * axis} and {At.OFFSETS + 8 * axis}"
                found = f"scale {scale}, offset {offset}"
                raise MapFormatError(self._path, expected, found, place)
        return scales, offsets

    def _evlrs(self, points_offset: int) -> tuple[int, tuple[VariableLengthRecord, ...], int]:
        """Return how many extended records there should be, the whole ones, and where these end."""
        if self._minor < 4:
            return 0, (), 0
        start, count = self._unpack("<QI", At.FIRST_EVLR)
        records: list[VariableLengthRecord] = []
        while len(records) < count and points_offset <= start <= self._size - _EVLR_HEADER:
            self._file.seek(start)
            head = self._file.read(_EVLR_HEADER)
            end = start + _EVLR_HEADER + struct.unpack_from("<Q", head, 20)[0]
            if end > self._size:
                break
            record = _record(head, start, end, b"")
            if record.user_id == CRS_USER_ID and end - start <= _LARGEST_CRS:
                record = replace(record, data=self._file.read(end - start - _EVLR_HEADER))
            records.append(record)
            start = end
        return count, tuple(records), start

    def _waveforms(self, points_offset: int) -> tuple[int, int] | None:
        """Find the record of waveform packets in the file; None where there is no whole one."""
        # It has the header of an EVLR, in LAS 1.3 too.
        start = self._unpack("<Q", At.WAVEFORMS)[0] if self._minor >= 3 else 0
        if start < points_offset or start + _EVLR_HEADER > self._size:
            return None
        self._file.seek(start + 20)
        (size,) = struct.unpack("<Q", self._file.read(8))
        end = start + _EVLR_HEADER + size
        return (start, end) if end <= self._size else None


def read_vlrs(block: bytes | bytearray) -> tuple[VariableLengthRecord, ...]:
    """Split what lies between the public header and the points into its records, the whole ones."""
    (start,) = struct.unpack_from("<H", block, At.HEADER_SIZE)
    (count,) = struct.unpack_from("<I", block, At.VLR_COUNT)
    records: list[VariableLengthRecord] = []
    while len(records) < count and start + _VLR_HEADER <= len(block):
        end = start + _VLR_HEADER + struct.unpack_from("<H", block, start + 20)[0]
        if end > len(block):
            break
        data = bytes(block[start + _VLR_HEADER : end])
        records.append(_record(block[start : start + _VLR_HEADER], start, end, data))
        start = end
    return tuple(records)


def _record(head: bytes | bytearray, start: int, end: int, data: bytes) -> VariableLengthRecord:
    user_id = bytes(head[2:18]).split(b"\0")[0].decode("latin-1")
    return VariableLengthRecord(user_id, struct.unpack_from("<H", head, 18)[0], start, end, data)
