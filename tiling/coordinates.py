"""The coordinates of a map, kept as they are, where reading the map means to decode it.

Compressed and text files take many times longer to read than the bytes of their coordinates. The
survey reads them once, and keeps in a file what the cutting needs; row ranges of it can be read
side by side, even where those of the map cannot.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from tiling.atomic import write_only
from tiling.errors import ChunkError
from tiling.formats.base import PointBatch

_POINT_BYTES = 24


@dataclass(frozen=True, slots=True)
class KeptCoordinates:
    """A file of x, y, z as float64, row by row.

    Attributes
    ----------
    path : Path
    point_count : int
        Points of the map.
    """

    path: Path
    point_count: int

    def make(self) -> None:
        """Make the file, of its full size: several processes fill it in."""
        with self.path.open("wb") as stream:
            stream.truncate(self.point_count * _POINT_BYTES)

    def keep(self, batches: Iterator[PointBatch]) -> Iterator[PointBatch]:
        """Write the coordinates of batches as they pass; they are on the disk at the end."""
        with self._opened(write_only) as stream:
            for batch in batches:
                stream.seek(batch.first_row * _POINT_BYTES)
                stream.write(np.ascontiguousarray(batch.xyz).data)
                yield batch
            stream.flush()
            os.fsync(stream.fileno())

    def batches(self, max_points: int, rows: range) -> Iterator[tuple[int, PointBatch]]:
        """Yield points of a range of rows, in order, without records; as `MapCollection` does.

        Raises
        ------
        ChunkError
            When the file is not there, or not of its size.
        """
        with self._opened(lambda path: path.open("rb")) as stream:
            stream.seek(rows.start * _POINT_BYTES)
            for first in range(rows.start, rows.stop, max_points):
                xyz = self._read(stream, min(max_points, rows.stop - first))
                yield 0, PointBatch(first, xyz, None)

    def _read(self, stream: BinaryIO, count: int) -> NDArray[np.float64]:
        xyz = np.fromfile(stream, np.float64, 3 * count)
        if len(xyz) < 3 * count:
            expected = f"coordinates of {self.point_count} points"
            raise ChunkError(self.path, expected, "the end of the file")
        return xyz.reshape(-1, 3)

    @contextmanager
    def _opened(self, how: Callable[[Path], BinaryIO]) -> Iterator[BinaryIO]:
        try:
            stream = how(self.path)
        except FileNotFoundError:
            expected = f"coordinates of {self.point_count} points"
            raise ChunkError(self.path, expected, "no such file") from None
        with stream:
            yield stream
