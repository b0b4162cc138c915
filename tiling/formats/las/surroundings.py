"""What surrounds the points of a LAS or LAZ output: the header, VLRs and EVLRs of the input.

They are kept byte for byte. Only what depends on the points is set anew: their number, in all and
by return, their bounds, and the places of what follows them.
"""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from tiling.formats.las.header import (
    AT_FIRST_EVLR,
    AT_POINTS_OFFSET,
    AT_VLR_COUNT,
    AT_WAVEFORMS,
    LasHeader,
    VariableLengthRecord,
)
from tiling.formats.las.laz_header import is_laszip_record
from tiling.formats.las.summary import LasSummary
from tiling.formats.parts import PartSummary, PartWriter, copy_spans, put_records


def is_copc_index(record: VariableLengthRecord) -> bool:
    """Tell whether a record says where COPC's nodes lie (COPC 1.0, info VLR and hierarchy)."""
    return record.names("copc", 1) or record.names("copc", 1000)


class LasSurroundings:
    """The bytes before and after the points of an output.

    Parameters
    ----------
    header : LasHeader
        Of the input; the file must still be there when what follows the points is copied.
    laszip : bytes, optional
        Data of the output's laszip VLR, if they are not the input's.
    """

    def __init__(self, header: LasHeader, laszip: bytes | None = None) -> None:
        self._header = header
        self._block = bytearray(header.block)
        if laszip is not None:
            record = next(r for r in header.vlrs if is_laszip_record(r))
            start = record.end - len(record.data)
            self._block[start : start + len(laszip)] = laszip
        self._remove_copc_info()
        self._evlrs = [record for record in header.evlrs if not is_copc_index(record)]
        # Pieces of the input, from and to, in the order of the output.
        self._pieces = [(record.start, record.end) for record in self._evlrs]
        waveforms = header.waveforms
        if waveforms is not None and waveforms[0] not in [start for start, _ in self._pieces]:
            self._pieces.append(waveforms)

    @property
    def points_offset(self) -> int:
        """Byte of the first point."""
        return len(self._block)

    def write_header(self, file: BinaryIO) -> None:
        """Write the input's header and VLRs, which say nothing true of the points yet."""
        file.write(self._block)

    def write_after_points(self, file: BinaryIO) -> None:
        """Append EVLRs and waveform packets to a file that stands at the end of the points."""
        copy_spans(self._header.path, file, self._pieces)

    def completed_header(self, points_end: int, summary: LasSummary) -> bytes:
        """Return the header and VLRs with what depends on the points.

        Parameters
        ----------
        points_end : int
            Byte after the points, where EVLRs and waveform packets begin.
        summary : LasSummary
            Of all points.
        """
        block = bytearray(self._block)
        self._place_what_follows(block, points_end)
        summary.write_into(block, self._header)
        return bytes(block)

    def _remove_copc_info(self) -> None:
        """Take the COPC info VLR out of the block."""
        for record in reversed([r for r in self._header.vlrs if is_copc_index(r)]):
            del self._block[record.start : record.end]
            (count,) = struct.unpack_from("<I", self._block, AT_VLR_COUNT)
            struct.pack_into("<I", self._block, AT_VLR_COUNT, count - 1)
        struct.pack_into("<I", self._block, AT_POINTS_OFFSET, len(self._block))

    def _place_what_follows(self, block: bytearray, position: int) -> None:
        """Note in the header where EVLRs and waveform packets are."""
        header = self._header
        if header.minor_version >= 4:
            first = position if self._evlrs else 0
            struct.pack_into("<QI", block, AT_FIRST_EVLR, first, len(self._evlrs))
        for start, end in self._pieces:
            if header.waveforms is not None and start == header.waveforms[0]:
                struct.pack_into("<Q", block, AT_WAVEFORMS, position)
            position += end - start


class LasPartWriter(PartWriter):
    """Writes raw, uncompressed point records under the header of the file they come from.

    Parameters
    ----------
    path : Path
        The file to write.
    point_count : int
        Points it will hold.
    header : LasHeader
        Of the file that the points come from; it must still be there.
    """

    def __init__(self, path: Path, point_count: int, header: LasHeader) -> None:
        super().__init__(path, point_count)
        self._header = header
        self._surroundings = LasSurroundings(header)

    def new_summary(self, first: int) -> LasSummary:
        """Return the summary of a part that has no points yet."""
        return LasSummary.of(self._header, first)

    def put(self, file: BinaryIO, first: int, records: NDArray[np.uint8]) -> None:
        """Write (n, record_length) records to their places."""
        put_records(file, self._start_of(first), records)

    def _start_of(self, row: int) -> int:
        return self._surroundings.points_offset + row * self._header.record_length

    def _write_surroundings(self, file: BinaryIO) -> None:
        self._surroundings.write_header(file)
        end = self._start_of(self.point_count)
        file.truncate(end)
        file.seek(end)
        self._surroundings.write_after_points(file)

    def _completed_header(self, parts: Sequence[PartSummary]) -> bytes:
        whole = self.new_summary(0)
        for part in parts:
            whole.merge(cast(LasSummary, part))
        return self._surroundings.completed_header(self._start_of(self.point_count), whole)
