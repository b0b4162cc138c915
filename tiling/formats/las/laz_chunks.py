"""Where the chunks of compressed points (LAZ) lie, checked against the file's size.

LASzip's format is described by its author (Isenburg 2013, LASzip: lossless compression of LiDAR
data) and by its source.
"""

import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from itertools import accumulate, pairwise
from typing import Any, BinaryIO

from tiling.errors import MapFormatError
from tiling.formats.checks import check_leftover
from tiling.formats.las.header import LasHeader
from tiling.formats.las.laz_header import Compression, refuse

lazrs: Any = import_module("lazrs")  # without types that a checker can use

_LARGEST_CHUNK_ENTRY = 16
"""Bytes; an entry of the chunk table is at most two integers of 32 bits and their bit counts."""


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
            refuse(header, f"{count} points in the chunks", f"{sum(filled)}", start)
        return
    chunks = -(-count // size)
    if len(filled) > chunks:
        refuse(header, f"{chunks} chunks for {count} points", f"{len(filled)}", start)
    if compression.has_layers and chunks:
        (last,) = find_chunks(file, header, compression, range(count - 1, count))
        file.seek(last.start + header.record_length)
        found = int.from_bytes(file.read(4), "little") + last.first_row
        if found > count:
            refuse(header, f"{count} points in the chunks", f"{found}", last.start)


def _first_chunk_start(header: LasHeader) -> int:
    """Return where the first chunk begins, after the offset to the chunk table."""
    start, end = header.points_offset + 8, header.file_size
    if start > end:
        refuse(header, "8 bytes for the offset to the chunk table", "the file's end", end)
    return start


def _chunks_in_table(
    file: BinaryIO, header: LasHeader, compression: Compression
) -> list[Chunk] | None:
    """Return the chunks that the table names, None where it is missing or wrong.

    It is not needed to read chunks of one size one after the other.
    """
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
        refuse(header, expected, f"chunks of {end - spans[0][0]} bytes", spans[0][0])
    rows = accumulate((points for points, _ in table), initial=0)
    return [
        Chunk(*span, row, min(points, count - row), points)
        for span, row, (points, _) in zip(spans, rows, table, strict=False)
        if points and row < count
    ]


def _layered_chunk_end(
    file: BinaryIO, header: LasHeader, compression: Compression, start: int, end: int
) -> int:
    """Return where a chunk of layers ends, which must be no later than a byte of the file.

    A chunk is its first point, the number of points, the size of each layer, and the layers.
    """
    layers = compression.layers
    head_size = header.record_length + 4 + 4 * layers
    file.seek(start)
    head = file.read(min(head_size, max(end - start, 0)))
    size = head_size
    if len(head) == head_size:
        size += sum(struct.unpack_from(f"<{layers}I", head, head_size - 4 * layers))
    if start + size > end:
        refuse(header, f"LAZ chunks up to byte {end}", f"one of {size} bytes or more", start)
    return start + size


def _read_chunk_table(
    file: BinaryIO, header: LasHeader, compression: Compression
) -> tuple[int, list[tuple[int, int]]]:
    """Return the byte of the chunk table, and points and bytes of each chunk.

    The points are there only where chunks vary in size. It is refused where it is not in its place,
    or too long for what it describes.
    """
    points_offset = header.points_offset
    start = _read_chunk_table_offset(file, header, points_offset)
    smallest_chunk = header.record_length + (4 + 4 * compression.layers) * compression.has_layers
    file.seek(start)
    version, count = struct.unpack("<II", file.read(8))
    # Writers may end the table with a chunk of no points.
    if version != 0 or count > (start - points_offset - 8) // smallest_chunk + 1:
        expected = f"a chunk table of version 0 for {start - points_offset - 8} bytes of points"
        refuse(header, expected, f"version {version} and {count} chunks", start)
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
        expected = f"a chunk table between the points and the file's end ({header.file_size})"
        refuse(header, expected, f"its offset {offset}", points_offset)
    return int(offset)


def comes_from_lazrs(error: BaseException) -> bool:
    """Tell an error of lazrs from an interruption: its panics are no `Exception`.

    Their class cannot be imported, but has a name.
    """
    return isinstance(error, Exception) or type(error).__name__ == "PanicException"
