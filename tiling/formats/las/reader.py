"""LAS and LAZ 1.0 to 1.5, point formats 0 to 10, and COPC as input.

A point travels as the raw bytes of its record. They are not turned into laspy's arrays and back,
nor is the header, because laspy's writer renews what it understands (generating software, records
reserved for others, text after a terminating zero) and the map must keep it. Fields are named as
laspy names them, and coordinates are computed as laspy computes them.
"""

import struct
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.base import MapReader, MapWriter
from tiling.formats.checks import check_leftover
from tiling.formats.las.compression import (
    Compression,
    check_chunk_count,
    knows_chunks,
    read_compression,
)
from tiling.formats.las.crs import crs_name, crs_units
from tiling.formats.las.fields import (
    LAST_SHORT_CLASS,
    extended_header,
    extra_fields,
    standard_fields,
)
from tiling.formats.las.header import (
    WAVEFORMS_EXTERNAL,
    At,
    LasHeader,
    read_header,
)
from tiling.formats.las.laz import LaszipPoints, LazPoints, PointSource, usable_threads
from tiling.formats.las.laz_writer import LazWriter
from tiling.formats.las.metadata import LasPartWriter, is_copc_index
from tiling.formats.parts import PartWriter
from tiling.formats.points import MapDescription, PointBatch, bytes_of, packed
from tiling.grid import Grid, integers_in_records

_WITH_WAVEFORMS = (4, 5, 9, 10)
_SHORT_CLASS = np.uint8(LAST_SHORT_CLASS)


class LasReader(MapReader):
    """Reads a LAS, LAZ or COPC file; COPC points come in the file's order."""

    sets_values = True

    def __init__(self, path: Path) -> None:
        self._header = read_header(path)
        self.bytes_per_point = self._header.record_length
        self.record_dtype = np.dtype((np.uint8, self._header.record_length))
        self._compression: Compression | None = None
        self.seekable = self.writes_parts = not self._header.compressed
        if self._header.compressed:
            self._compression = read_compression(self._header)
        with path.open("rb") as file:
            notes = _check_behind_points(file, self._header, self._compression)
            if self._compression is not None:
                self.seekable = knows_chunks(file, self._header, self._compression)
        self.description = _describe(self._header, notes)

    def _batches(self, max_points: int, rows: range) -> Iterator[PointBatch]:
        """Yield points whose `records` are (n, record_length) uint8."""
        header = self._header
        with header.path.open("rb") as file:
            source = self._point_source(file, rows)
            for first in range(rows.start, rows.stop, max_points):
                count = min(max_points, rows.stop - first)
                records = np.empty((count, header.record_length), dtype=np.uint8)
                source.read_into(records)
                yield self.batch_of(first, records)

    def batch_of(self, first_row: int, records: NDArray[Any]) -> PointBatch:
        """Make a batch of raw records; see `MapReader.batch_of`."""
        header = self._header
        xyz = Grid(header.scales, header.offsets).coordinates(integers_in_records(records))
        flags = records[:, 15]
        if header.point_format < 6:  # they share their byte with the class
            return PointBatch(first_row, xyz, records, flags & _SHORT_CLASS, flags >= 128)
        return PointBatch(first_row, xyz, records, records[:, 16].copy(), (flags & 4) != 0)

    def values(self, records: Any, name: str) -> NDArray[Any]:
        """Return one field of some points, as laspy takes them apart; see `MapReader.values`."""
        return np.asarray(self._taken_apart(records)[name])

    def with_values(
        self, records: NDArray[np.uint8], values: Mapping[str, NDArray[Any]]
    ) -> NDArray[np.uint8]:
        """Return records with other values, set by laspy; see `MapReader.with_values`."""
        records = records.copy()
        for name, column in values.items():
            self._taken_apart(records)[name] = column
        return records

    def _taken_apart(self, records: NDArray[np.uint8]) -> Any:
        from laspy.point.record import PackedPointRecord  # noqa: PLC0415 (slow to import)

        return PackedPointRecord.from_buffer(records.data, self._point_format)

    @cached_property
    def _point_format(self) -> Any:
        from laspy import LasHeader as Header  # noqa: PLC0415

        with self._header.path.open("rb") as file:
            try:
                found = Header.read_from(file).point_format
            except Exception as error:  # laspy raises many kinds
                expected = "fields that laspy can take apart"
                raise MapFormatError(self._header.path, expected, str(error)) from error
        if found.size != self._header.record_length:
            expected = f"points of {self._header.record_length} bytes, as laspy reads them"
            raise MapFormatError(self._header.path, expected, f"{found.size} bytes")
        return found

    def _stream_writer(self, path: Path, point_count: int) -> MapWriter:
        assert self._compression is not None  # else it is written in parts
        threads = usable_threads(self.threads)
        return LazWriter(path, point_count, self._header, self._compression, threads)

    def _part_writer(self, path: Path, point_count: int) -> PartWriter:
        return LasPartWriter(path, point_count, self._header)

    def _take_further(self) -> None:
        self._header = extended_header(self._header, self.further)
        if self._header.compressed:
            self._compression = read_compression(self._header)

    def extend(self, batch: PointBatch, values: Sequence[NDArray[Any]]) -> NDArray[np.uint8]:
        """Return the records with further values; see `MapReader.extend`."""
        return np.hstack([batch.records, bytes_of(packed(self.further, values))])

    def with_classes(
        self, records: NDArray[np.uint8], classification: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """Set the classes of records; see `MapReader.with_classes`."""
        if self._header.point_format < 6:
            # The other three bits are flags: synthetic, key-point, withheld.
            records[:, 15] &= ~_SHORT_CLASS
            records[:, 15] |= classification & _SHORT_CLASS
        else:
            records[:, 16] = classification
        return records

    def _point_source(self, file: BinaryIO, rows: range) -> PointSource:
        if self._compression is None:
            return _RawPoints(file, self._header, rows.start)
        if self._compression.needs_laszip:
            return LaszipPoints(file, self._header, self._compression, rows)
        threads = usable_threads(self.threads)
        return LazPoints(file, self._header, self._compression, rows, threads)


class _RawPoints:
    """The points of an uncompressed file from a row on, in order."""

    def __init__(self, file: BinaryIO, header: LasHeader, first_row: int) -> None:
        self._file = file
        self._header = header
        file.seek(header.points_offset + first_row * header.record_length)

    def read_into(self, records: NDArray[np.uint8]) -> None:
        found = self._file.readinto(records.reshape(-1).data)  # type: ignore[attr-defined]
        if found != records.size:
            expected = f"{self._header.point_count} points"
            found = "the file's end: it was cut after its header was read"
            at = f"byte {self._file.tell()}"
            raise MapFormatError(self._header.path, expected, found, at)


def _describe(header: LasHeader, notes: tuple[str, ...]) -> MapDescription:
    kind = f"{'LAZ' if header.compressed else 'LAS'} 1.{header.block[At.MINOR_VERSION]}"
    kind = f"{kind}, point format {header.point_format}"
    if header.compressed and _has_copc_index(header):
        kind = f"COPC ({kind})"
    return MapDescription(
        path=header.path,
        format=kind,
        suffix=".laz" if header.compressed else ".las",
        point_count=header.point_count,
        fields=(*standard_fields(header.point_format), *extra_fields(header)),
        crs=crs_name(header.vlrs + header.evlrs),
        units=crs_units(header.vlrs + header.evlrs),
        has_classification=True,
        largest_class=LAST_SHORT_CLASS if header.point_format < 6 else 255,
        grid=Grid(header.scales, header.offsets),
        notes=(*_notes(header), *notes),
    )


def _has_copc_index(header: LasHeader) -> bool:
    return any(is_copc_index(record) for record in header.vlrs + header.evlrs)


def _notes(header: LasHeader) -> Iterator[str]:
    yield from header.notes
    if _has_copc_index(header):
        yield (
            f"The output is plain {'LAZ' if header.compressed else 'LAS'}: the COPC index (info "
            "VLR and hierarchy EVLR) is left out, since it describes where other points lie."
        )
    if header.point_format in _WITH_WAVEFORMS:
        (encoding,) = struct.unpack_from("<H", header.block, At.GLOBAL_ENCODING)
        if encoding & WAVEFORMS_EXTERNAL:
            yield (
                "The waveform packets are in a .wdp file beside the input, which is not copied: "
                "the points keep their places in it."
            )
        elif header.minor_version >= 3 and header.waveforms is None:
            (start,) = struct.unpack_from("<Q", header.block, At.WAVEFORMS)
            if start:
                yield (
                    f"The waveform packets said to start at byte {start} are not there, "
                    "and cannot be copied."
                )


def _check_behind_points(
    file: BinaryIO, header: LasHeader, compression: Compression | None
) -> tuple[str, ...]:
    """Refuse points that the header does not count; return notes on other bytes."""
    gaps: list[tuple[int, int]] = []
    if compression is None:
        gaps = list(_gaps(header))
    elif compression.has_chunks:
        check_chunk_count(file, header, compression)
    elif not header.point_count:  # else it is seen where decompression ends
        stop = min([start for start, _ in _known(header)], default=header.file_size)
        gaps = [(header.points_offset, stop)]
    counted, size = f"{header.point_count} points", header.record_length
    notes = [check_leftover(file, *gap, size, header.path, counted) for gap in gaps]
    return tuple(chain.from_iterable(notes))


def _known(header: LasHeader) -> list[tuple[int, int]]:
    """Return first byte and end of what the header says is behind the points."""
    spans = [(record.start, record.end) for record in header.evlrs]
    if header.waveforms is not None:
        spans.append(header.waveforms)
    if header.cut_off is not None:
        spans.append((header.cut_off, header.file_size))
    return sorted(spans)


def _gaps(header: LasHeader) -> Iterator[tuple[int, int]]:
    """Yield what lies between the points and these records, and between and behind them."""
    end = position = header.points_offset + header.point_count * header.record_length
    for start, stop in _known(header):
        if start < end:
            expected = f"{header.point_count} points before what follows them at byte {start}"
            raise MapFormatError(header.path, expected, f"points up to byte {end}")
        yield position, start
        position = max(position, stop)
    yield position, header.file_size
