"""Writes a LAS file with the header, VLRs and EVLRs of another, byte for byte."""

from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from tiling.formats.las.header import LasHeader
from tiling.formats.las.summary import LasSummary
from tiling.formats.las.surroundings import LasSurroundings
from tiling.formats.parts import PartSummary, PartWriter, put_records


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
