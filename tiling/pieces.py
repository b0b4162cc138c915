"""Pieces: the points of a range of the map's rows, sorted by tile.

A point of a piece is x, y, z as float64 and its row number as int64, of which the complement (~row)
says that the point is in the tile's halo and not in its core; a point is there once for each tile
that it belongs to. Runs say where those of each tile are: tile, first point, number of points. The
points of a tile are in the order of their rows.
"""

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tiling.chunk_store import Chunk, ChunkStore
from tiling.errors import ChunkError
from tiling.formats.points import PointBatch
from tiling.tile_sorter import TileSorter

POINTS_AT_A_TIME = 500_000
"""Points that are read, and sorted by tile, at a time."""


class PointSource(Protocol):
    """What gives the points of a map: its files, or a copy of their coordinates."""

    def batches(self, max_points: int, rows: range) -> Iterator[tuple[int, PointBatch]]:
        """Yield points of a range of rows, in order; see `MapCollection.batches`."""


def sort_by_tile(
    store: ChunkStore, source: PointSource, rows: range
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return a piece: points, (n, 4), and runs, (R, 3).

    Parameters
    ----------
    store : ChunkStore
    source : PointSource
        The map.
    rows : range
        Consecutive row numbers.

    Raises
    ------
    RowRangeError
        When the map has no such rows.
    MapFormatError
        When a file of the map is not what its header announced.
    """
    sorter = TileSorter(store.layout, store.halo)
    sorted_points, runs, written = [np.empty((0, 4))], [np.empty((0, 3), np.int64)], 0
    for _, batch in source.batches(POINTS_AT_A_TIME, rows):
        points, counts = sorter.by_tile(batch.xyz, batch.first_row)
        tiles = np.flatnonzero(counts)
        sizes = counts[tiles]
        runs.append(np.column_stack([tiles, written + np.cumsum(sizes) - sizes, sizes]))
        sorted_points.append(points)
        written += len(points)
    return np.concatenate(sorted_points), np.concatenate(runs)


def gathered(store: ChunkStore, tile: int, runs: Sequence[NDArray[np.float64]]) -> Chunk:
    """Return the points of a tile: its runs of all pieces, in the order of the rows.

    Raises
    ------
    ChunkError
        When they are not as many as there must be in the core.
    """
    points = np.concatenate([np.empty((0, 4)), *runs])
    marked = points[:, 3].copy().view(np.int64)
    core = marked >= 0
    found, expected = int(np.count_nonzero(core)), int(store.layout.counts[tile])
    if found != expected:
        raise ChunkError(
            store.folder,
            f"{expected} points in the core of tile {tile}",
            f"{found}: damaged pieces, or those of another map",
        )
    return Chunk(np.ascontiguousarray(points[:, :3]), np.where(core, marked, ~marked), core)
