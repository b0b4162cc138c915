"""Compressed points (LAZ) decompressed several chunks at a time, through lazrs."""

from importlib import import_module
from itertools import islice
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tiling.errors import MapFormatError
from tiling.formats.las.header import LasHeader
from tiling.formats.las.laz import refuse_points
from tiling.formats.las.laz_chunks import Stretch, knows_chunks, longest_chunk, split_into_chunks
from tiling.formats.las.laz_header import Compression
from tiling.formats.las.lazrs_pool import LARGEST_PARALLEL_CHUNK

# It has no types that a checker can use.
lazrs: Any = import_module("lazrs")


def can_be_read_in_parallel(file: BinaryIO, header: LasHeader, compression: Compression) -> bool:
    """Tell whether chunks can be found without those before them, and are short enough."""
    return (
        not compression.needs_laszip
        and knows_chunks(file, header, compression)
        and longest_chunk(file, header, compression) * header.record_length
        <= LARGEST_PARALLEL_CHUNK
    )


class ParallelLazPoints:
    """Decompresses the points of a LAZ file from a row on, in order, with several threads.

    Parameters
    ----------
    file, header, compression, rows
        As for `LazPoints`, of a file that `can_be_read_in_parallel`.
    threads : int
        Chunks to decompress at a time, see `lazrs_pool`.
    """

    def __init__(
        self,
        file: BinaryIO,
        header: LasHeader,
        compression: Compression,
        rows: range,
        threads: int,
    ) -> None:
        self._file = file
        self._header = header
        self._compression = compression
        self._rows = rows
        self._threads = threads
        self._chunks = split_into_chunks(file, header, compression, rows)
        self._ready = self._memory = np.empty((0, header.record_length), dtype=np.uint8)

    def read_into(self, records: NDArray[np.uint8]) -> None:
        """Decompress the next points.

        Parameters
        ----------
        records : (n, record_length) uint8 array
            Where the next n points go; contiguous.

        Raises
        ------
        MapFormatError
            When chunks or layers contradict the file's size, or the compressed bytes end too
            early or make no sense.
        """
        done = 0
        while done < len(records):
            if not len(self._ready):
                done += self._decompress_next_chunks(records[done:])
            count = min(len(records) - done, len(self._ready))
            records[done : done + count] = self._ready[:count]
            self._ready = self._ready[count:]
            done += count

    def _decompress_next_chunks(self, room: NDArray[np.uint8]) -> int:
        """Decompress into the room where all that comes out is wanted and fits, else aside.

        Returns
        -------
        int
            Points that are now in the room.
        """
        chunks = list(islice(self._chunks, self._threads))
        if not chunks:
            raise MapFormatError(
                self._header.path, f"{self._header.point_count} points", "chunks of fewer"
            )
        first_row = chunks[0].first_row
        passed_over = max(self._rows.start - first_row, 0)
        table = [(self._wanted(chunk), chunk.end - chunk.start) for chunk in chunks]
        count = sum(points for points, _ in table)
        fits = passed_over == 0 and count <= len(room)
        points = room[:count] if fits else self._aside(count)
        self._file.seek(chunks[0].start)
        data = self._file.read(chunks[-1].end - chunks[0].start)
        vlr = self._compression.for_stretch(chunks[0].chunk_size)
        try:
            lazrs.decompress_points_with_chunk_table(data, vlr, points.reshape(-1), table)
        except BaseException as error:
            refuse_points(self._header, first_row, error)
        if fits:
            return count
        self._ready = points[passed_over:]
        return 0

    def _aside(self, count: int) -> NDArray[np.uint8]:
        """Return memory for points that are not handed out at once."""
        if len(self._memory) < count:
            self._memory = np.empty((count, self._header.record_length), dtype=np.uint8)
        return self._memory[:count]

    def _wanted(self, chunk: Stretch) -> int:
        """Return how many points of a chunk are to be decompressed, from its first on."""
        return min(chunk.points, self._rows.stop - chunk.first_row)
