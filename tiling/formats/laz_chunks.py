"""Where the chunks of compressed points (LAZ) lie, checked against the file's size.

LASzip's format is described by its author (Isenburg 2013, LASzip: lossless compression of LiDAR
data) and by its source.
"""

import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from itertools import accumulate
from typing import Any, BinaryIO

from tiling.errors import MapFormatError
from tiling.formats.las_header import LasHeader
from tiling.formats.laz_header import Compression, refuse

# It has no types that a checker can use.
lazrs: Any = import_module("lazrs")

_LARGEST_CHUNK_ENTRY = 16
"""Bytes; an entry of the chunk table is at most two integers of 32 bits and their bit counts."""


@dataclass(frozen=True, slots=True)
class Stretch:
    """Compressed bytes of chunks that all have the same number of points.

    Attributes
    ----------
    start, end : int
        Bytes of the file.
    first_row, points : int
        Row number of the first point, and the number of points.
    chunk_size : int
        Points in a chunk.
    """

    start: int
    end: int
    first_row: int
    points: int
    chunk_size: int


def split_into_stretches(
    file: BinaryIO, header: LasHeader, compression: Compression, rows: range
) -> Iterator[Stretch]:
    """Yield the stretches that hold some rows, each checked before it meets a decompressor.

    The first begins with the chunk of the first row, or with the first chunk of all where it is
    not known where the others begin.

    Raises
    ------
    MapFormatError
        When chunks or layers contradict the file's size.
    """
    start, end = header.points_offset, header.file_size
    if not rows:
        return
    if not compression.has_chunks:
        yield Stretch(start, end, 0, header.point_count, header.point_count)
    elif compression.has_variable_chunks:
        yield from _split_variable(file, header, compression, rows)
    else:
        start += 8
        if start > end:
            refuse(header, "8 bytes for the offset to the chunk table", "the file's end", end)
        first_chunk = rows.start // compression.chunk_size
        if compression.has_layers:
            chunks = -(-rows.stop // compression.chunk_size)
            start = _walk_layers(file, header, compression, start, end, first_chunk)
            end = _walk_layers(file, header, compression, start, end, chunks - first_chunk)
        elif first_chunk:
            starts = _chunk_starts(file, header, compression)
            first_chunk = 0 if starts is None else first_chunk
            start = start if starts is None else starts[first_chunk]
        first_row = first_chunk * compression.chunk_size
        yield Stretch(start, end, first_row, header.point_count - first_row, compression.chunk_size)


def knows_chunks(file: BinaryIO, header: LasHeader, compression: Compression) -> bool:
    """Tell whether it is known where each chunk begins."""
    if not compression.has_chunks:
        return False
    if compression.has_variable_chunks or compression.has_layers:
        return True
    return _chunk_starts(file, header, compression) is not None


def _chunk_starts(file: BinaryIO, header: LasHeader, compression: Compression) -> list[int] | None:
    """Return where chunks of one size begin, None where the chunk table cannot be relied on.

    It is not needed to read such chunks one after the other, and may be missing or wrong.
    """
    try:
        table_start, table = read_chunk_table(file, header, compression)
    except MapFormatError:
        return None
    start = header.points_offset + 8
    *starts, end = accumulate((size for _, size in table), initial=start)
    chunks = -(-header.point_count // compression.chunk_size)
    return starts if end == table_start and len(starts) == chunks else None


def _split_variable(
    file: BinaryIO, header: LasHeader, compression: Compression, rows: range
) -> Iterator[Stretch]:
    """Yield the chunks of some rows that the chunk table names."""
    first_row = 0
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
        wanted = first_row < rows.stop and first_row + points > rows.start
        # What lies beyond the last point is checked too.
        surplus = first_row >= header.point_count
        if points and compression.has_layers and (wanted or surplus):
            _walk_layers(file, header, compression, start, end, 1)
        if wanted:
            count = min(points, header.point_count - first_row)
            yield Stretch(start, end, first_row, count, points)
        first_row += points
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
    # Writers may end the table with a chunk of no points.
    if version != 0 or count > (start - points_offset - 8) // smallest_chunk + 1:
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
        if not comes_from_lazrs(error):
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


def comes_from_lazrs(error: BaseException) -> bool:
    """Tell an error of lazrs from an interruption: its panics are no `Exception`.

    Their class cannot be imported, but has a name.
    """
    return isinstance(error, Exception) or type(error).__name__ == "PanicException"
