"""The public header block of a LAS file and the variable length records around its points.

Every count and offset is checked against the file's size before it is used. Byte positions are
those of the ASPRS LAS specification, 1.4 R15 (table 3) and 1.5.
"""

import math
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from tiling.errors import MapFormatError

SMALLEST_HEADER = {0: 227, 1: 227, 2: 227, 3: 235, 4: 375, 5: 393}
"""Bytes of the public header block by minor version."""
RECORD_LENGTHS = (20, 28, 26, 34, 57, 63, 30, 36, 38, 59, 67)
"""Bytes of a point by point format, without extra bytes."""

AT_GLOBAL_ENCODING = 6
AT_MINOR_VERSION = 25
AT_HEADER_SIZE = 94
AT_POINTS_OFFSET = 96
AT_VLR_COUNT = 100
AT_POINT_FORMAT = 104
AT_RECORD_LENGTH = 105
AT_LEGACY_COUNT = 107
AT_SCALES = 131
AT_OFFSETS = 155
AT_BOUNDS = 179
AT_WAVEFORMS = 227
AT_FIRST_EVLR = 235
AT_COUNT = 247
AT_GPS_TIME_BOUNDS = 375

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
    size: int
    """Bytes of the whole record, its header included."""
    data: bytes
    """The record's own data; of an EVLR, only where it is of the coordinate reference system."""

    @property
    def end(self) -> int:
        """Byte after the record."""
        return self.start + self.size

    def names(self, user_id: str, record_id: int) -> bool:
        """Tell whether this is the record registered under these names."""
        return (self.user_id, self.record_id) == (user_id, record_id)


@dataclass(frozen=True, slots=True)
class LasHeader:
    """What precedes the points, as bytes, and what it says."""

    path: Path
    """The file."""
    file_size: int
    """Its bytes."""
    block: bytes
    """Everything before the points: header, VLRs, and whatever else is there."""
    minor_version: int
    """x of LAS 1.x, of the latest whose fields the header has room for."""
    point_format: int
    """0 to 10."""
    compressed: bool
    """Whether the points are LAZ."""
    record_length: int
    """Bytes of a point, extra bytes included."""
    point_count: int
    """Points in the file."""
    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]
    """Of x, y and z."""
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
    def public_size(self) -> int:
        """Bytes of the public header block."""
        return int(struct.unpack_from("<H", self.block, AT_HEADER_SIZE)[0])

    @property
    def global_encoding(self) -> int:
        """Bit field of the header."""
        return int(struct.unpack_from("<H", self.block, AT_GLOBAL_ENCODING)[0])

    @property
    def has_waveforms(self) -> bool:
        """Whether each point has a waveform packet."""
        return self.point_format in (4, 5, 9, 10)


def read_header(path: Path) -> LasHeader:
    """Read and check everything of a LAS or LAZ file but its points.

    Raises
    ------
    MapFormatError
        When the header contradicts the specification or the file's size.
    """
    file_size = path.stat().st_size
    with path.open("rb") as file:
        minor, header, notes = _read_public_header(path, file, file_size)
        point_format, compressed, record_length = _check_point_layout(path, header)
        point_count = _point_count(header, minor)
        points_offset = _check_points_offset(path, header, file_size)
        if not compressed:
            _check_room(path, points_offset, file_size, point_count, record_length)
        scales, offsets = _check_grid(path, header)
        file.seek(0)
        block = bytearray(file.read(points_offset))
        vlrs = read_vlrs(block)
        notes += _note_missing("VLR", struct.unpack_from("<I", block, AT_VLR_COUNT)[0], len(vlrs))
        struct.pack_into("<I", block, AT_VLR_COUNT, len(vlrs))
        promised, evlrs, end = _read_evlrs(file, file_size, header, minor, points_offset)
        notes += _note_missing("EVLR", promised, len(evlrs))
        waveforms = _find_waveforms(file, file_size, header, minor, points_offset)
    return LasHeader(
        path=path,
        file_size=file_size,
        block=bytes(block),
        minor_version=minor,
        point_format=point_format,
        compressed=compressed,
        record_length=record_length,
        point_count=point_count,
        scales=scales,
        offsets=offsets,
        vlrs=vlrs,
        evlrs=evlrs,
        waveforms=waveforms,
        cut_off=end if promised > len(evlrs) and points_offset <= end < file_size else None,
        notes=notes,
    )


def _note_missing(kind: str, promised: int, found: int) -> tuple[str, ...]:
    """Say where a header counts more records than there are; nobody can tell what they held."""
    if promised == found:
        return ()
    return (
        f"The header counts {promised} {kind}s, but the file has {found}, as the outputs will.",
    )


def _read_public_header(
    path: Path, file: BinaryIO, file_size: int
) -> tuple[int, bytes, tuple[str, ...]]:
    """Return the minor version whose fields are there, the public header block, and notes."""
    header = file.read(SMALLEST_HEADER[5])
    if not header:
        raise MapFormatError(path, 'the LAS signature "LASF"', "an empty file", "byte 0")
    if header.startswith(b"version https://git-lfs"):
        raise MapFormatError(
            path, 'the LAS signature "LASF"', "a Git LFS pointer in place of the file", "byte 0"
        )
    if header[:4] != b"LASF":
        raise MapFormatError(path, 'the LAS signature "LASF"', repr(header[:4])[1:], "byte 0")
    if file_size < SMALLEST_HEADER[0]:
        raise MapFormatError(
            path, f"a header of {SMALLEST_HEADER[0]} bytes", f"the file's end at byte {file_size}"
        )
    major, minor = header[24], header[25]
    if major != 1 or minor not in SMALLEST_HEADER:
        raise MapFormatError(path, "LAS version 1.0 to 1.5", f"{major}.{minor}", "byte 24")
    (header_size,) = struct.unpack_from("<H", header, AT_HEADER_SIZE)
    if not SMALLEST_HEADER[0] <= header_size <= file_size:
        raise MapFormatError(
            path,
            f"a header of {SMALLEST_HEADER[minor]} bytes or more within the file's {file_size}",
            f"header size {header_size}",
            f"byte {AT_HEADER_SIZE}",
        )
    if header_size >= SMALLEST_HEADER[minor]:
        return minor, header[:header_size], ()
    note = (
        f"The header has {header_size} bytes, and that of LAS 1.{minor} has "
        f"{SMALLEST_HEADER[minor]}: what should follow is taken as not there."
    )
    minor = max(each for each, size in SMALLEST_HEADER.items() if size <= header_size)
    return minor, header[:header_size], (note,)


def _check_point_layout(path: Path, header: bytes) -> tuple[int, bool, int]:
    """Return point format, whether it is compressed, and the bytes of a point."""
    stored = header[AT_POINT_FORMAT]
    compressed = bool(stored & _COMPRESSED)
    point_format = stored & ~_COMPRESSED
    if point_format >= len(RECORD_LENGTHS):
        raise MapFormatError(
            path, "point format 0 to 10", str(point_format), f"byte {AT_POINT_FORMAT}"
        )
    (record_length,) = struct.unpack_from("<H", header, AT_RECORD_LENGTH)
    if record_length < RECORD_LENGTHS[point_format]:
        raise MapFormatError(
            path,
            f"points of {RECORD_LENGTHS[point_format]} bytes or more (point format {point_format})",
            f"{record_length} bytes",
            f"byte {AT_RECORD_LENGTH}",
        )
    return point_format, compressed, record_length


def _point_count(header: bytes, minor: int) -> int:
    """Return the number of points: since 1.4 the 64-bit field, unless only the older is filled."""
    (legacy,) = struct.unpack_from("<I", header, AT_LEGACY_COUNT)
    count = struct.unpack_from("<Q", header, AT_COUNT)[0] if minor >= 4 else 0
    return int(count or legacy)


def _check_points_offset(path: Path, header: bytes, file_size: int) -> int:
    (header_size,) = struct.unpack_from("<H", header, AT_HEADER_SIZE)
    (points_offset,) = struct.unpack_from("<I", header, AT_POINTS_OFFSET)
    if not header_size <= points_offset <= file_size:
        raise MapFormatError(
            path,
            f"points between the header's end ({header_size}) and the file's ({file_size})",
            f"offset to points {points_offset}",
            f"byte {AT_POINTS_OFFSET}",
        )
    if points_offset > _LARGEST_BLOCK:
        expected = f"at most {_LARGEST_BLOCK} bytes before the points"
        raise MapFormatError(path, expected, str(points_offset), f"byte {AT_POINTS_OFFSET}")
    return int(points_offset)


def _check_room(path: Path, start: int, file_size: int, count: int, record_length: int) -> None:
    room = (file_size - start) // record_length
    if count > room:
        raise MapFormatError(
            path,
            f"{count} points of {record_length} bytes from byte {start}",
            f"room for {room}: the file ends",
            f"byte {file_size}",
        )


def _check_grid(
    path: Path, header: bytes
) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    scales = struct.unpack_from("<3d", header, AT_SCALES)
    offsets = struct.unpack_from("<3d", header, AT_OFFSETS)
    for axis, name in enumerate("xyz"):
        farthest = abs(scales[axis]) * _LARGEST_GRID_COORDINATE + abs(offsets[axis])
        if scales[axis] == 0 or not math.isfinite(farthest):
            raise MapFormatError(
                path,
                f"a scale of {name} other than 0, and an offset, of finite coordinates",
                f"scale {scales[axis]}, offset {offsets[axis]}",
                f"bytes {AT_SCALES + 8 * axis} and {AT_OFFSETS + 8 * axis}",
            )
    return scales, offsets


def read_vlrs(block: bytes | bytearray) -> tuple[VariableLengthRecord, ...]:
    """Split what lies between the public header and the points into its records, the whole ones."""
    (start,) = struct.unpack_from("<H", block, AT_HEADER_SIZE)
    (count,) = struct.unpack_from("<I", block, AT_VLR_COUNT)
    records: list[VariableLengthRecord] = []
    while len(records) < count and start + _VLR_HEADER <= len(block):
        size = _VLR_HEADER + struct.unpack_from("<H", block, start + 20)[0]
        if start + size > len(block):
            break
        data = bytes(block[start + _VLR_HEADER : start + size])
        records.append(_record(block[start : start + _VLR_HEADER], start, size, data))
        start += size
    return tuple(records)


def _read_evlrs(
    file: BinaryIO, file_size: int, header: bytes, minor: int, points_offset: int
) -> tuple[int, tuple[VariableLengthRecord, ...], int]:
    """Return how many extended records there should be, the whole ones, and where these end."""
    if minor < 4:
        return 0, (), 0
    start, count = struct.unpack_from("<QI", header, AT_FIRST_EVLR)
    records: list[VariableLengthRecord] = []
    while len(records) < count and points_offset <= start <= file_size - _EVLR_HEADER:
        file.seek(start)
        head = file.read(_EVLR_HEADER)
        size = _EVLR_HEADER + struct.unpack_from("<Q", head, 20)[0]
        if start + size > file_size:
            break
        record = _record(head, start, size, b"")
        if record.user_id == CRS_USER_ID and size <= _LARGEST_CRS:
            record = replace(record, data=file.read(size - _EVLR_HEADER))
        records.append(record)
        start += size
    return count, tuple(records), start


def _record(head: bytes | bytearray, start: int, size: int, data: bytes) -> VariableLengthRecord:
    user_id = bytes(head[2:18]).split(b"\0")[0].decode("latin-1")
    return VariableLengthRecord(user_id, struct.unpack_from("<H", head, 18)[0], start, size, data)


def _find_waveforms(
    file: BinaryIO, file_size: int, header: bytes, minor: int, points_offset: int
) -> tuple[int, int] | None:
    """Find the record of waveform packets in the file; None where there is none, or no whole one.

    It has the header of an EVLR, in LAS 1.3 too.
    """
    if minor < 3:
        return None
    (start,) = struct.unpack_from("<Q", header, AT_WAVEFORMS)
    if start < points_offset or start + _EVLR_HEADER > file_size:
        return None
    file.seek(start + 20)
    (size,) = struct.unpack("<Q", file.read(8))
    end = start + _EVLR_HEADER + size
    return (start, end) if end <= file_size else None
