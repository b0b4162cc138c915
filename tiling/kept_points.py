"""The points of a map as they were decoded, kept where reading the map means to decode it.

Compressed and text files take many times longer to read than the bytes of their points. The survey
reads them once, and keeps in a file what comes after it needs: the records, which the outputs are
written from too, or only the coordinates, where records have no size of their own (text). Row
ranges of the file can be read side by side, even where those of the map cannot.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import accumulate
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from tiling.collection import MapCollection
from tiling.errors import ChunkError
from tiling.formats.points import PointBatch
from tiling.output_file import make_sized, sync, write_only

_COORDINATES = np.dtype((np.float64, 3))

_LARGEST_BATCH = 1 << 27
"""Bytes of records at a time: those of LAS may be 65,535 bytes each."""


def bytes_kept(collection: MapCollection) -> int:
    """Return the bytes that a map's points take until its outputs are written."""
    if collection.writes_parts:
        return 0
    kept = KeptPoints(Path(), collection)
    return kept.size if kept.has_records else 0


@dataclass(frozen=True)
class KeptPoints:
    """A file of the points of a map, row by row."""

    path: Path
    collection: MapCollection

    @cached_property
    def has_records(self) -> bool:
        """Whether whole records are kept, and not only coordinates."""
        return all(reader.record_dtype is not None for reader in self.collection.readers)

    @property
    def size(self) -> int:
        """Bytes of the file."""
        return self._starts[-1]

    def make(self) -> None:
        """Make the file, of its full size: several processes fill it in. What is there stays."""
        make_sized(self.path, self.size)

    def keep(self, batches: Iterator[tuple[int, PointBatch]]) -> Iterator[PointBatch]:
        """Write points of `MapCollection.batches` as they pass; they are on the disk at the end."""
        with self._opened(write_only) as stream:
            for file, batch in batches:
                stream.seek(self._place(file, batch.first_row))
                kept = batch.records if self.has_records else batch.xyz
                stream.write(np.ascontiguousarray(kept).data.cast("B"))
                yield batch
            stream.flush()
            sync(stream.fileno())

    def batches(self, max_points: int, rows: range) -> Iterator[tuple[int, PointBatch]]:
        """Yield the points of a range of rows, in order, as `MapCollection.batches` does.

        They have no records where these are not kept. A `ChunkError` says that the file is not
        there, or not of its size.
        """
        with self._opened(lambda path: path.open("rb")) as stream:
            for file in self.collection.files_of(rows):
                of_file, dtype = self.collection.rows_of(file), self._dtype(file)
                start, stop = max(rows.start, of_file.start), min(rows.stop, of_file.stop)
                most = max(1, min(max_points, _LARGEST_BATCH // dtype.itemsize))
                stream.seek(self._place(file, start))
                for first in range(start, stop, most):
                    kept = self._read(stream, dtype, min(most, stop - first))
                    yield file, self._batch(file, first, kept)

    def batches_of(self, file: int, max_points: int) -> Iterator[PointBatch]:
        """Yield the points of one file of the map, in order, as its reader does."""
        rows = self.collection.rows_of(file)
        for _, batch in self.batches(max_points, rows):
            yield replace(batch, first_row=batch.first_row - rows.start)

    def _dtype(self, file: int) -> np.dtype[Any]:
        """Return the type of the rows of a file of the map."""
        kept = self.collection.readers[file].record_dtype if self.has_records else None
        return kept or _COORDINATES

    @cached_property
    def _starts(self) -> list[int]:
        """Where the points of each file of the map begin, and where the last of them end."""
        files = range(len(self.collection.readers))
        sizes = (len(self.collection.rows_of(n)) * self._dtype(n).itemsize for n in files)
        return list(accumulate(sizes, initial=0))

    def _place(self, file: int, row: int) -> int:
        rows_before = row - self.collection.first_rows[file]
        return self._starts[file] + rows_before * self._dtype(file).itemsize

    def _batch(self, file: int, first: int, kept: NDArray[Any]) -> PointBatch:
        if not self.has_records:
            return PointBatch(first, kept, None)
        batch = self.collection.readers[file].batch_of(first, kept)
        return self.collection.in_map(file, batch)

    def _read(self, stream: BinaryIO, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        kept = np.empty(count, dtype)
        found = stream.readinto(kept.data.cast("B"))  # type: ignore[attr-defined]
        if found < kept.nbytes:
            raise ChunkError(self.path, self._expected, "the end of the file")
        return kept

    @property
    def _expected(self) -> str:
        return f"{self.collection.point_count} points as they were decoded"

    def _opened(self, how: Callable[[Path], BinaryIO]) -> BinaryIO:
        try:
            return how(self.path)
        except FileNotFoundError:
            raise ChunkError(self.path, self._expected, "no such file") from None
