"""A map in memory: its points, and as much of it as was decoded, which need not be done again."""

from bisect import bisect_left, bisect_right
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.configuration.run import InputParameters
from pipeline.progress import StageObserver
from pipeline.taking_part import left_out
from pipeline.tiles.writing import BATCH
from tiling.collection import MapCollection
from tiling.formats import PointBatch

MOST_KEPT = 1 << 28
"""Bytes of decoded records, at most."""

_OBJECT_BYTES = 60
"""Of a row of text beside its characters."""


@dataclass(frozen=True, slots=True)
class DecodedMap:
    """The points of a map, and its records where they were kept.

    Attributes
    ----------
    collection : MapCollection
    points : (N, 3) float64 array
    classification : (N,) uint8 array or None
        Where all files have classes.
    left_out : (N,) bool array or None
        Points marked as noise or as deleted, where there are any.
    kept : tuple of (int, PointBatch)
        All batches of the map, each after the file that it comes from; or none.
    """

    collection: MapCollection
    points: NDArray[np.float64]
    classification: NDArray[np.uint8] | None
    left_out: NDArray[np.bool_] | None
    kept: tuple[tuple[int, PointBatch], ...]

    def batches(self, file: int) -> Iterator[PointBatch]:
        """Yield the points of a file of the map, as its reader does."""
        if not self.kept:
            yield from self.collection.readers[file].batches(BATCH)
        # They are in the order of the files.
        first = bisect_left(self.kept, file, key=_file_of)
        stop = bisect_right(self.kept, file, key=_file_of)
        for _, batch in self.kept[first:stop]:
            first_row = batch.first_row - self.collection.first_rows[file]
            yield replace(batch, first_row=first_row)


def read_map(
    collection: MapCollection,
    most_kept: int,
    observer: StageObserver,
    parameters: InputParameters | None = None,
) -> DecodedMap:
    """Read the points of a map; keep its records if decoding takes long and they are not many.

    Parameters
    ----------
    collection : MapCollection
    most_kept : int
        Bytes of records that may be kept. If they are more, none is.
    observer : StageObserver
        Told of the reading.
    parameters : InputParameters, optional
        Which points are left out.

    Raises
    ------
    MapFormatError
        When a file is not what its header announced.
    """
    parameters = parameters or InputParameters()
    count = collection.point_count
    observer.stage("reading", count)
    points = np.empty((count, 3))
    classes = np.zeros(count, np.uint8) if collection.has_classification else None
    unwanted: NDArray[np.bool_] | None = None
    kept: list[tuple[int, PointBatch]] = []
    # Where the bytes of a file are its records, they are as soon read again.
    left = 0 if collection.writes_parts else most_kept
    for file, batch in collection.batches(BATCH):
        rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
        points[rows] = batch.xyz
        if classes is not None and batch.classification is not None:
            classes[rows] = batch.classification
        out = left_out(batch, parameters)
        if out.any():
            unwanted = np.zeros(count, np.bool_) if unwanted is None else unwanted
            unwanted[rows] = out
        left -= _size_of(batch.records)
        if left >= 0:
            kept.append((file, replace(batch, xyz=points[rows])))
        else:
            kept.clear()
        observer.advance(len(batch.xyz))
    return DecodedMap(collection, points, classes, unwanted, tuple(kept))


def _file_of(kept: tuple[int, PointBatch]) -> int:
    return kept[0]


def _size_of(records: Any) -> int:
    """Return the bytes of records; more than are ever kept where they do not tell."""
    if not isinstance(records, np.ndarray):
        return MOST_KEPT + 1
    if records.dtype != object:
        return records.nbytes
    return sum(map(len, records)) + _OBJECT_BYTES * len(records)
