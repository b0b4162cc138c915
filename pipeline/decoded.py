"""A map in memory: its points, and as much of it as was decoded, which need not be done again."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np

from pipeline.progress import StageObserver
from pipeline.tiles.writing import BATCH
from tiling.formats import PointBatch
from tiling.formats.collection import MapCollection

MOST_KEPT = 1 << 28
"""Bytes of decoded records, at most."""

_OBJECT_BYTES = 60
"""Of a row of text beside its characters."""


class DecodedMap:
    """The points of a map; where decoding takes long, its records as well, if they are not many.

    Parameters
    ----------
    collection : MapCollection
    most_kept : int
        Bytes of records that may be kept. If they are more, all are read again.
    observer : StageObserver
        Told of the reading.

    Attributes
    ----------
    points : (N, 3) float64 array
    classification : (N,) uint8 array or None
        Where all files have classes.
    """

    def __init__(self, collection: MapCollection, most_kept: int, observer: StageObserver) -> None:
        self._collection = collection
        count = collection.point_count
        observer.stage("reading", count)
        self.points = np.empty((count, 3))
        classified = collection.has_classification
        self.classification = np.zeros(count, np.uint8) if classified else None
        self._kept: list[tuple[int, PointBatch]] = []
        left = 0 if all(reader.writes_parts for reader in collection.readers) else most_kept
        for file, batch in collection.batches(BATCH):
            rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
            self.points[rows] = batch.xyz
            if self.classification is not None and batch.classification is not None:
                self.classification[rows] = batch.classification
            left -= _size_of(batch.records)
            if left >= 0:
                self._kept.append((file, replace(batch, xyz=self.points[rows])))
            else:
                self._kept.clear()
            observer.advance(len(batch.xyz))

    def batches(self, file: int) -> Iterator[PointBatch]:
        """Yield the points of a file of the map, as its reader does."""
        if not self._kept:
            yield from self._collection.readers[file].batches(BATCH)
        for of_file, batch in self._kept:
            if of_file == file:
                first_row = batch.first_row - self._collection.first_rows[file]
                yield replace(batch, first_row=first_row)


def _size_of(records: Any) -> int:
    if not isinstance(records, np.ndarray):
        return MOST_KEPT + 1
    if records.dtype != object:
        return records.nbytes
    return sum(map(len, records)) + _OBJECT_BYTES * len(records)
