"""What lies behind the points of a LAS or LAZ file that nothing in its header speaks for."""

from collections.abc import Iterator
from typing import BinaryIO

from tiling.errors import MapFormatError
from tiling.formats.las.header import LasHeader
from tiling.formats.las.laz_chunks import check_chunk_count
from tiling.formats.las.laz_header import Compression
from tiling.formats.leftover import check_leftover


def check_behind_points(
    file: BinaryIO, header: LasHeader, compression: Compression | None
) -> tuple[str, ...]:
    """Refuse points that the header does not count; return notes on other bytes.

    EVLRs and waveform packets have their place behind the points. Of compressed points the chunks
    are counted; the last points of the last chunk are found missing when it is read.

    Raises
    ------
    MapFormatError
        When there are more points than the header counts, or others than it says.
    """
    counted = f"{header.point_count} points"
    if compression is None:
        notes: tuple[str, ...] = ()
        for start, stop in _gaps(header):
            size = header.record_length
            notes += check_leftover(file, start, stop, size, header.path, counted)
        return notes
    if not compression.has_chunks:
        if header.point_count:
            return ()  # known where decompression ends
        stop = min([start for start, _ in _known(header)], default=header.file_size)
        size = header.record_length
        return check_leftover(file, header.points_offset, stop, size, header.path, counted)
    check_chunk_count(file, header, compression)
    return ()


def _known(header: LasHeader) -> list[tuple[int, int]]:
    """Return first byte and end of what the header says is behind the points."""
    spans = [(record.start, record.end) for record in header.evlrs]
    if header.waveforms is not None:
        spans.append(header.waveforms)
    return sorted(spans)


def _gaps(header: LasHeader) -> Iterator[tuple[int, int]]:
    """Yield what lies between the points and these records, and between and behind them."""
    end = position = header.points_offset + header.point_count * header.record_length
    for start, stop in _known(header):
        if start < end:
            raise MapFormatError(
                header.path,
                f"{header.point_count} points before what follows them at byte {start}",
                f"points up to byte {end}",
            )
        yield position, start
        position = max(position, stop)
    yield position, header.file_size
