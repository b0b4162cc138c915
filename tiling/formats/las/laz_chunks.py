"""Where the chunks of compressed points (LAZ) lie, checked against the file's size.

LASzip's format is described by its author (Isenburg 2013, LASzip: lossless compression of LiDAR
data) and by its source.
"""

import io
import struct
from collections.abc import Iterator
from dataclasses import dataclass, replace
from importlib import import_module
from itertools import accumulate
from typing import Any, BinaryIO

from tiling.errors import MapFormatError
from tiling.formats.las.header import LasHeader
from tiling.formats.las.laz_header import Compression, refuse
from tiling.formats.leftover import check_leftover

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
    count = header.point_count
    if not rows:
        return
    if not compression.has_chunks:
        yield Stretch(header.points_offset, header.file_size, 0, count, count)
    elif compression.has_variable_chunks:
        yield from split_into_chunks(file, header, compression, rows)
    elif compression.has_layers:
        chunks = split_into_chunks(file, header, compression, rows)
        first = next(chunks)
        end = first.end
        for chunk in chunks:
            end = chunk.end
        yield replace(first, end=end, points=count - first.first_row)
    else:
        start = _first_chunk_start(header)
        first_chunk = rows.start // compression.chunk_size
        starts = _chunk_starts(file, header, compression) if first_chunk else None
        if starts is None:
            first_chunk = 0
        else:
            start = starts[first_chunk]
        row = first_chunk * compression.chunk_size
        yield Stretch(start, header.file_size, row, count - row, compression.chunk_size)


def split_into_chunks(
    file: BinaryIO, header: LasHeader, compression: Compression, rows: range
) -> Iterator[Stretch]:
    """Yield the chunks that hold some rows, each checked, where it is known where they begin.

    Raises
    ------
    MapFormatError
        When chunks or layers contradict the file's size.
    """
    if compression.has_variable_chunks:
        yield from _split_variable(file, header, compression, rows)
        return
    size = compression.chunk_size
    numbers = range(rows.start // size, -(-rows.stop // size))
    if compression.has_layers:
        ends = _layered_chunk_ends(file, header, compression, numbers)
    else:
        starts = _chunk_starts(file, header, compression)
        assert starts is not None
        ends = iter(starts[numbers.start : numbers.stop + 1])
    start = next(ends)
    for number, end in zip(numbers, ends, strict=True):
        row = number * size
        yield Stretch(start, end, row, min(size, header.point_count - row), size)
        start = end


def check_chunk_count(file: BinaryIO, header: LasHeader, compression: Compression) -> None:
    """Check that the chunks are for the points that the header counts, and for no more.

    Where points are not in layers, the last chunk does not say how many it has.

    Raises
    ------
    MapFormatError
        When there are more points in them.
    """
    count, size = header.point_count, compression.chunk_size
    try:
        start, table = read_chunk_table(file, header, compression)
    except MapFormatError:
        # A table that is missing or wrong is no matter where the points are read without it.
        if compression.has_variable_chunks:
            raise
        if not count:
            smallest = header.record_length
            check_leftover(
                file, header.points_offset, header.file_size, smallest, header.path, "0 points"
            )
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
        last = next(_layered_chunk_ends(file, header, compression, range(chunks - 1, chunks)))
        file.seek(last + header.record_length)
        stored_count = file.read(4)
        found = int.from_bytes(stored_count, "little") + (chunks - 1) * size
        if found > count:
            refuse(header, f"{count} points in the chunks", f"{found}", last)


def knows_chunks(file: BinaryIO, header: LasHeader, compression: Compression) -> bool:
    """Tell whether it is known where each chunk begins."""
    if not compression.has_chunks:
        return False
    if compression.has_variable_chunks or compression.has_layers:
        return True
    return _chunk_starts(file, header, compression) is not None


def longest_chunk(file: BinaryIO, header: LasHeader, compression: Compression) -> int:
    """Return how many points the longest chunk has, or may have where all have one size."""
    if not compression.has_variable_chunks:
        return compression.chunk_size
    _, table = read_chunk_table(file, header, compression)
    return max((points for points, _ in table), default=0)


def _first_chunk_start(header: LasHeader) -> int:
    """Return where the first chunk begins, after the offset to the chunk table."""
    start = header.points_offset + 8
    if start > header.file_size:
        end = header.file_size
        refuse(header, "8 bytes for the offset to the chunk table", "the file's end", end)
    return start


def _chunk_starts(file: BinaryIO, header: LasHeader, compression: Compression) -> list[int] | None:
    """Return where chunks of one size begin and the last ends, None where that is not known.

    The chunk table is not needed to read such chunks one after the other, and may be missing or
    wrong.
    """
    try:
        table_start, table = read_chunk_table(file, header, compression)
    except MapFormatError:
        return None
    starts = list(accumulate((size for _, size in table), initial=header.points_offset + 8))
    chunks = -(-header.point_count // compression.chunk_size)
    return starts if starts[-1] == table_start and len(table) == chunks else None


def _layered_chunk_ends(
    file: BinaryIO, header: LasHeader, compression: Compression, numbers: range
) -> Iterator[int]:
    """Yield where the first of some chunks of layers begins, and where each of them ends.

    Each says itself how long it is. The chunk table is only a short cut to the first.
    """
    end = header.file_size
    start = _first_chunk_start(header)
    if numbers.start:
        starts = _chunk_starts(file, header, compression)
        if starts is not None and _is_layered_chunk(
            file, header, compression, *starts[numbers.start : numbers.start + 2]
        ):
            start = starts[numbers.start]
        else:
            for _ in range(numbers.start):
                start = _layered_chunk_end(file, header, compression, start, end)
    yield start
    for _ in numbers:
        start = _layered_chunk_end(file, header, compression, start, end)
        yield start


def _is_layered_chunk(
    file: BinaryIO, header: LasHeader, compression: Compression, start: int, end: int
) -> bool:
    """Tell whether a chunk begins and ends where the chunk table says."""
    try:
        return _layered_chunk_end(file, header, compression, start, end) == end
    except MapFormatError:
        return False


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
            _layered_chunk_end(file, header, compression, start, end)
        if wanted:
            count = min(points, header.point_count - first_row)
            yield Stretch(start, end, first_row, count, points)
        first_row += points
        start = end


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
