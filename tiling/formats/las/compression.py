"""How the points of a LAZ file are compressed, and where their chunks lie in it.

LASzip's format is described by its author (Isenburg 2013, LASzip: lossless compression of LiDAR
data) and by its source. What its VLR and its chunk table say is checked against the header and the
file's size.
"""

import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from itertools import accumulate, pairwise
from typing import Any, BinaryIO, NoReturn

from tiling.errors import MapFormatError
from tiling.formats.checks import check_leftover
from tiling.formats.las.header import LasHeader, VariableLengthRecord

lazrs: Any = import_module("lazrs")  # without types that a checker can use

_POINT_WISE, _POINT_WISE_CHUNKED, _LAYERED_CHUNKED = 1, 2, 3
_VARIABLE_CHUNK_SIZE = 0xFFFFFFFF
_AT_CHUNK_SIZE = 12
_AT_ITEMS = 32

_WAVE_PACKET13 = 9
_LAYERS = {10: 9, 11: 1, 12: 2, 13: 1}
"""Layers of each item of a chunk of layers, by its code; extra bytes are a layer each."""

_LARGEST_CHUNK_ENTRY = 16
"""Bytes; an entry of the chunk table is at most two integers of 32 bits and their bit counts."""


def is_laszip_record(record: VariableLengthRecord) -> bool:
    """Tell whether a VLR is the one that says how the points are compressed."""
    return record.names("laszip encoded", 22204)


@dataclass(frozen=True, slots=True)
class Compression:
    """How the points of a LAZ file are compressed: the laszip VLR, checked."""

    data: bytes
    compressor: int
    """1 for points in one stretch, 2 for chunks of points, 3 for chunks of layers."""
    chunk_size: int
    """Points in a chunk; `0xFFFFFFFF` where each has its own number."""
    item_versions: tuple[int, ...]
    layers: int
    """Separately compressed layers in a chunk of layers."""

    @property
    def has_chunks(self) -> bool:
        """Whether an offset to a chunk table precedes the points."""
        return self.compressor != _POINT_WISE

    @property
    def has_layers(self) -> bool:
        """Whether each chunk is made of layers."""
        return self.compressor == _LAYERED_CHUNKED

    @property
    def has_variable_chunks(self) -> bool:
        """Whether the chunk table says how many points each chunk has."""
        return self.has_chunks and self.chunk_size == _VARIABLE_CHUNK_SIZE

    @property
    def needs_laszip(self) -> bool:
        """Whether points of several scanner channels are stored in a way that lazrs cannot read.

        Version 4 of LASzip's items differs from version 3, which lazrs reads, in what the items
        beside the first remember of each channel.
        """
        return 4 in self.item_versions and len(self.item_versions) > 1

    def can_be_written_as(self, data: bytes) -> bool:
        """Tell whether a writer that follows the VLR `data` also follows this one.

        Both must agree in compressor and items; chunks of any fixed size will do.
        """
        same_items = self.data[_AT_ITEMS : len(data)] == data[_AT_ITEMS:]
        return self.data[:2] == data[:2] and same_items and not self.has_variable_chunks

    def for_chunks(self, points: int) -> bytes:
        """Return the VLR's data for lazrs, for chunks of so many points."""
        data = bytearray(self.data)
        struct.pack_into("<I", data, _AT_CHUNK_SIZE, min(points, _VARIABLE_CHUNK_SIZE - 1))
        for item, version in enumerate(self.item_versions):
            at = _AT_ITEMS + 2 + 6 * item + 4
            struct.pack_into("<H", data, at, min(version, 3))
        return bytes(data)


def own_compression(header: LasHeader, variable_chunks: bool = False) -> bytes:
    """Return the data of a laszip VLR that lazrs can follow, and every reader understands.

    lazrs calls its wave packets of point formats 4 and 5 version 2, although LASzip knows them in
    version 1 only, which is what they are.
    """
    new = lazrs.LazVlr.new_for_compression
    data = bytearray(new(header.point_format, header.extra_bytes, variable_chunks).record_data())
    for item, (kind, _, _) in enumerate(_items(data)):
        if kind == _WAVE_PACKET13:
            struct.pack_into("<H", data, _AT_ITEMS + 2 + 6 * item + 4, 1)
    return bytes(data)


def _items(data: bytes | bytearray) -> list[tuple[int, int, int]]:
    """Return code, bytes in a point and version of each item that a VLR lists."""
    (count,) = struct.unpack_from("<H", data, _AT_ITEMS)
    return list(struct.iter_unpack("<HHH", data[_AT_ITEMS + 2 :][: 6 * count]))


def read_compression(header: LasHeader) -> Compression:
    """Find the laszip VLR of a LAZ file; refuse none, and one of other points than the header's."""
    record = next((r for r in header.vlrs if is_laszip_record(r)), None)
    if record is None:
        raise MapFormatError(header.path, "a laszip VLR, since the points are compressed", "none")
    start = record.end - len(record.data)
    if len(record.data) < _AT_ITEMS + 2:
        _refuse(header, "a laszip VLR of 34 bytes or more", f"{len(record.data)} bytes", start)
    compressor, coder = struct.unpack_from("<HH", record.data)
    (chunk_size,) = struct.unpack_from("<I", record.data, _AT_CHUNK_SIZE)
    (item_count,) = struct.unpack_from("<H", record.data, _AT_ITEMS)
    if len(record.data) < _AT_ITEMS + 2 + 6 * item_count:
        _refuse(header, "the laszip VLR to hold its items", f"{item_count} items", start)
    allowed = (_LAYERED_CHUNKED,) if header.point_format >= 6 else (1, 2)
    if compressor not in allowed:
        names = " or ".join(map(str, allowed))
        expected = f"LASzip compressor {names} for point format {header.point_format}"
        _refuse(header, expected, str(compressor), start)
    if coder != 0:
        _refuse(header, "LASzip coder 0", str(coder), start + 2)
    if compressor != _POINT_WISE and chunk_size == 0:
        _refuse(header, "LASzip chunks of 1 point or more", "0", start + _AT_CHUNK_SIZE)
    stored = _items(record.data)
    _check_items(header, stored, start + _AT_ITEMS)
    return Compression(
        data=record.data,
        compressor=compressor,
        chunk_size=chunk_size,
        item_versions=tuple(version for _, _, version in stored),
        layers=sum(_LAYERS.get(kind, size) for kind, size, _ in stored),
    )


def _check_items(header: LasHeader, stored: list[tuple[int, int, int]], at: int) -> None:
    """Check that LASzip's items make up the points that the header describes."""
    layered = header.point_format >= 6
    expected = [(kind, size) for kind, size, _ in _items(own_compression(header))]
    found = [(kind, size) for kind, size, _ in stored]
    if found != expected:
        _refuse(header, f"LASzip items (type, bytes) {expected}", str(found), at)
    versions = {version for _, _, version in stored}
    known = ({3}, {4}) if layered else ({1}, {2}, {1, 2})
    if versions not in known:
        names = "3 or 4" if layered else "1 or 2"
        _refuse(header, f"LASzip items of version {names}", f"version {max(versions)}", at)


def _refuse(header: LasHeader, expected: str, found: str, at: int) -> NoReturn:
    """Raise the error of a file that is not what its header announces."""
    raise MapFormatError(header.path, expected, found, f"byte {at}")


@dataclass(frozen=True, slots=True)
class Chunk:
    """Compressed bytes that can be read without those before them."""

    start: int
    end: int
    """Bytes of the file."""
    first_row: int
    points: int
    """Row number of the first point, and the number of points."""
    chunk_size: int
    """Points that LASzip puts in a chunk: fewer than `points` where it is not known where the
    chunks after the first begin, which then are read as one."""


def find_chunks(
    file: BinaryIO, header: LasHeader, compression: Compression, rows: range
) -> Iterator[Chunk]:
    """Yield the chunks that hold some rows, each checked before it meets a decompressor.

    Chunks and layers that contradict the file's size are refused.
    """
    if not rows:
        return
    count, size = header.point_count, compression.chunk_size
    if not compression.has_chunks:
        yield Chunk(header.points_offset, header.file_size, 0, count, count)
    elif (known := _chunks_in_table(file, header, compression)) is not None:
        for chunk in known:
            if chunk.first_row < rows.stop and chunk.first_row + chunk.points > rows.start:
                if compression.has_layers:
                    _layered_chunk_end(file, header, compression, chunk.start, chunk.end)
                yield chunk
    elif compression.has_layers:
        start = _first_chunk_start(header)
        for row in range(0, rows.stop, size):
            end = _layered_chunk_end(file, header, compression, start, header.file_size)
            if row + size > rows.start:
                yield Chunk(start, end, row, min(size, count - row), size)
            start = end
    else:
        yield Chunk(_first_chunk_start(header), header.file_size, 0, count, size)


def knows_chunks(file: BinaryIO, header: LasHeader, compression: Compression) -> bool:
    """Tell whether it is known where each chunk begins."""
    return compression.has_chunks and (
        compression.has_layers or _chunks_in_table(file, header, compression) is not None
    )


def check_chunk_count(file: BinaryIO, header: LasHeader, compression: Compression) -> None:
    """Refuse chunks for more points than the header counts.

    Where points are not in layers, the last chunk does not say how many it has.
    """
    count, size = header.point_count, compression.chunk_size
    try:
        start, table = _read_chunk_table(file, header, compression)
    except MapFormatError:
        # A table that is missing or wrong is no matter where the points are read without it.
        if compression.has_variable_chunks:
            raise
        if not count:
            start, size = header.points_offset, header.record_length
            check_leftover(file, start, header.file_size, size, header.path, "0 points")
        return
    # A chunk begins with its first point as it is; writers may end with one that has none.
    filled = [points for points, stored in table if stored >= header.record_length]
    if compression.has_variable_chunks:
        if sum(filled) > count:
            _refuse(header, f"{count} points in the chunks", f"{sum(filled)}", start)
        return
    chunks = -(-count // size)
    if len(filled) > chunks:
        _refuse(header, f"{chunks} chunks for {count} points", f"{len(filled)}", start)
    if compression.has_layers and chunks:
        (last,) = find_chunks(file, header, compression, range(count - 1, count))
        file.seek(last.start + header.record_length)
        found = int.from_bytes(file.read(4), "little") + last.first_row
        if found > count:
            _refuse(header, f"{count} points in the chunks", f"{found}", last.start)


def _first_chunk_start(header: LasHeader) -> int:
    """Return where the first chunk begins, after the offset to the chunk table."""
    start, end = header.points_offset + 8, header.file_size
    if start > end:
        _refuse(header, "8 bytes for the offset to the chunk table", "the file's end", end)
    return start


def _chunks_in_table(
    file: BinaryIO, header: LasHeader, compression: Compression
) -> list[Chunk] | None:
    """Return the chunks that the table names, None where it is wrong and chunks do without it."""
    try:
        table_start, table = _read_chunk_table(file, header, compression)
    except MapFormatError:
        if compression.has_variable_chunks:
            raise
        return None
    count, size = header.point_count, compression.chunk_size
    bounds = accumulate((stored for _, stored in table), initial=header.points_offset + 8)
    spans = list(pairwise(bounds))
    end = spans[-1][1] if spans else header.points_offset + 8
    if not compression.has_variable_chunks:
        if end != table_start or len(table) != -(-count // size):
            return None
        return [
            Chunk(*span, row, min(size, count - row), size)
            for span, row in zip(spans, range(0, count, size), strict=True)
        ]
    if end > table_start:
        expected = f"LAZ chunks up to the chunk table at byte {table_start}"
        _refuse(header, expected, f"chunks of {end - spans[0][0]} bytes", spans[0][0])
    rows = accumulate((points for points, _ in table), initial=0)
    return [
        Chunk(*span, row, min(points, count - row), points)
        for span, row, (points, _) in zip(spans, rows, table, strict=False)
        if points and row < count
    ]


def _layered_chunk_end(
    file: BinaryIO, header: LasHeader, compression: Compression, start: int, end: int
) -> int:
    """Return where a chunk of layers ends, which must be no later than a byte of the file."""
    # It is its first point, the number of points, the size of each layer, and the layers.
    layers = compression.layers
    head_size = header.record_length + 4 + 4 * layers
    file.seek(start)
    head = file.read(min(head_size, max(end - start, 0)))
    size = head_size
    if len(head) == head_size:
        size += sum(struct.unpack_from(f"<{layers}I", head, head_size - 4 * layers))
    if start + size > end:
        _refuse(header, f"LAZ chunks up to byte {end}", f"one of {size} bytes or more", start)
    return start + size


def _read_chunk_table(
    file: BinaryIO, header: LasHeader, compression: Compression
) -> tuple[int, list[tuple[int, int]]]:
    """Return the byte of the chunk table, and of each chunk its bytes, and points if they vary."""
    points_offset = header.points_offset
    start = _read_chunk_table_offset(file, header)
    smallest_chunk = header.record_length + (4 + 4 * compression.layers) * compression.has_layers
    file.seek(start)
    version, count = struct.unpack("<II", file.read(8))
    # Writers may end the table with a chunk of no points.
    if version != 0 or count > (start - points_offset - 8) // smallest_chunk + 1:
        expected = f"a chunk table of version 0 for {start - points_offset - 8} bytes of points"
        _refuse(header, expected, f"version {version} and {count} chunks", start)
    file.seek(start)
    window = io.BytesIO(file.read(8 + 64 + _LARGEST_CHUNK_ENTRY * count))
    try:
        table = lazrs.read_chunk_table_only(window, lazrs.LazVlr(compression.data))
    except BaseException as error:
        if not comes_from_lazrs(error):
            raise
        expected = f"a chunk table of {count} chunks"
        raise MapFormatError(header.path, expected, str(error), f"byte {start}") from error
    return start, [(int(points), int(size)) for points, size in table]


def _read_chunk_table_offset(file: BinaryIO, header: LasHeader) -> int:
    """Return the byte of the chunk table; a streaming writer leaves it at the file's end."""
    points_offset, offset = header.points_offset, -1
    if header.file_size >= points_offset + 16:
        file.seek(points_offset)
        (offset,) = struct.unpack("<q", file.read(8))
        if offset == -1:
            file.seek(header.file_size - 8)
            (offset,) = struct.unpack("<q", file.read(8))
    if not points_offset + 8 <= offset <= header.file_size - 8:
        expected = f"a chunk table between the points and the file's end ({header.file_size})"
        _refuse(header, expected, f"its offset {offset}", points_offset)
    return int(offset)


def comes_from_lazrs(error: BaseException) -> bool:
    """Tell an error of lazrs from an interruption: its panics are no `Exception`.

    Their class cannot be imported, but has a name.
    """
    return isinstance(error, Exception) or type(error).__name__ == "PanicException"
