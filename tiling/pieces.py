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

from tiling.chunks import Chunk, ChunkStore
from tiling.compiled import compiled, helper
from tiling.errors import ChunkError
from tiling.formats.points import DEFAULT_BATCH, PointBatch
from tiling.layout import NO_TILE, Layout


class PointSource(Protocol):
    """What gives the points of a map: its files, or a copy of their coordinates."""

    def batches(self, max_points: int, rows: range) -> Iterator[tuple[int, PointBatch]]:
        """Yield points of a range of rows, in order; see `MapCollection.batches`."""


def sort_by_tile(
    store: ChunkStore, source: PointSource, rows: range
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return a piece of consecutive rows of the map: points, (n, 4), and runs, (R, 3)."""
    sorter = TileSorter(store.layout, store.halo)
    sorted_points, runs, written = [np.empty((0, 4))], [np.empty((0, 3), np.int64)], 0
    for _, batch in source.batches(DEFAULT_BATCH, rows):
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


Points = NDArray[np.float64]
Integers = NDArray[np.int64]
Boxes = tuple[Points, Points]
"""Corner of the smallest, and of the largest, coordinates of each tile's box: (T, 2) each."""


class TileSorter:
    """Sorts points by tile: once for the tile whose core they are in, and once for each halo.

    Positions are counted first and filled then, so that no list of points grows. The halo is in
    metres.
    """

    def __init__(self, layout: Layout, halo: float) -> None:
        self._layout = layout
        self._reached = layout.low - halo, layout.high + halo
        # In here no other tile's halo reaches: rounding is monotonic, so not by a bit either.
        self._inner = layout.low + halo, layout.high - halo
        # For each tile, the others whose halo reaches into its core: found when it is met.
        self._others: dict[int, Integers] = {}

    def by_tile(self, xyz: Points, first_row: int) -> tuple[NDArray[np.float64], Integers]:
        """Return points sorted by tile, as pieces hold them, and how many are of each tile."""
        tiles = self._layout.tile_of(xyz)
        fixed = (xyz, tiles, *self._tables(tiles), self._inner, self._reached, first_row)
        counts = np.zeros(len(self._layout), np.int64)
        nowhere = np.empty((0, 4))
        _place(*fixed, counts, nowhere, nowhere.view(np.int64))
        points = np.empty((int(counts.sum()), 4))
        _place(*fixed, np.cumsum(counts) - counts, points, points.view(np.int64))
        return points, counts

    def _tables(self, tiles: NDArray[np.int32]) -> tuple[Integers, Integers]:
        """Return, end to end, the other tiles to look at for points of each tile, and where.

        Those of tile t are others[starts[t] : starts[t + 1]].
        """
        sizes = np.zeros(len(self._layout) + 1, np.int64)
        lists = [np.empty(0, np.int64)]
        present = np.bincount(tiles + 1, minlength=len(self._layout) + 1)[1:]
        for tile in np.flatnonzero(present).tolist():
            if tile not in self._others:
                near = self._layout.near(self._reached[0][tile], self._reached[1][tile])
                self._others[tile] = np.asarray(near[near != tile], np.int64)
            lists.append(self._others[tile])
            sizes[tile + 1] = len(lists[-1])
        return np.cumsum(sizes), np.concatenate(lists)


@helper
def _is_inside(x: float, y: float, boxes: Boxes, tile: int) -> bool:
    low, high = boxes
    along_x = low[tile, 0] <= x < high[tile, 0]
    return bool(along_x and low[tile, 1] <= y < high[tile, 1])


@compiled
def _place(
    xyz: Points,
    tiles: NDArray[np.int32],
    starts: Integers,
    others: Integers,
    inner: Boxes,
    reached: Boxes,
    first_row: int,
    places: Integers,
    points: Points,
    marks: Integers,
) -> None:
    """Put each point at the next place of each of its tiles; `marks` are the same bytes.

    Where there is no room at all, places are only counted.
    """
    counts_only = len(points) == 0
    for point in range(len(xyz)):
        tile = tiles[point]
        if tile == NO_TILE:
            continue
        if not counts_only:
            for axis in range(3):
                points[places[tile], axis] = xyz[point, axis]
            marks[places[tile], 3] = first_row + point
        places[tile] += 1
        if _is_inside(xyz[point, 0], xyz[point, 1], inner, tile):
            continue
        for place in range(starts[tile], starts[tile + 1]):
            other = others[place]
            if _is_inside(xyz[point, 0], xyz[point, 1], reached, other):
                if not counts_only:
                    for axis in range(3):
                        points[places[other], axis] = xyz[point, axis]
                    marks[places[other], 3] = ~(first_row + point)
                places[other] += 1
