"""The map cut into tiles on disk: for each tile a chunk of its own points and of those around.

Two steps make the chunks, so that several processes can do each side by side, and one that was
killed can be repeated: `tiling.pieces.write_pieces` sorts a range of the map's rows by tile into
one file, and `assemble` gathers the points of one tile from all those files.
"""

from collections.abc import Iterable
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from tiling.atomic import atomic_file
from tiling.chunk_store import Chunk, ChunkStore, joined
from tiling.errors import ChunkError
from tiling.pieces import read_tile

_FORMATS = {"parquet": "chunks_parquet", "las": "chunks_las", "laz": "chunks_las"}


class _Format(Protocol):
    def write(self, path: Path, chunk: Chunk, store: ChunkStore, tile: int) -> None:
        """Write a chunk."""

    def read(self, path: Path) -> Chunk:
        """Read a chunk; any error of the library used is let through."""


def assemble(store: ChunkStore, tile: int) -> Chunk:
    """Gather the points of a tile from all pieces into its chunk, and return them.

    The chunk's bytes depend on the store alone, not on the ranges of rows that were cut. It
    appears whole or not at all. The memory needed is that of the tile's points, three times.

    Parameters
    ----------
    store : ChunkStore
        Every row of whose map is in a piece.
    tile : int
        Its index in the layout.

    Returns
    -------
    Chunk

    Raises
    ------
    ChunkError
        When a piece is missing, cut short, or of another map or layout.
    GridError
        When the chunk is LAS, and a point is not on the store's grid.
    """
    chunk = read_tile(store, tile)
    with atomic_file(store.chunk_path(tile)) as temporary:
        _format(store).write(temporary, chunk, store, tile)
    return chunk


def has_chunk(store: ChunkStore, tile: int) -> bool:
    """Tell whether a tile's chunk is there."""
    return store.chunk_path(tile).is_file()


def read_chunk(store: ChunkStore, tile: int) -> Chunk:
    """Read the chunk of a tile.

    Raises
    ------
    ChunkError
        When it is missing or damaged.
    """
    path = store.chunk_path(tile)
    expected = f"the chunk of tile {tile}"
    if not has_chunk(store, tile):
        raise ChunkError(path, expected, "no such file")
    try:
        chunk = _format(store).read(path)
    except Exception as error:  # of pyarrow, laspy or lazrs, and each has many
        raise ChunkError(path, expected, " ".join(str(error).split())[:200]) from error
    core_count = int(store.layout.counts[tile])
    if int(chunk.core.sum()) != core_count:
        found = f"{int(chunk.core.sum())}"
        raise ChunkError(path, f"{core_count} points in the core of tile {tile}", found)
    return chunk


def read_cores(
    store: ChunkStore,
    tiles: Iterable[int],
    low: NDArray[np.float64],
    high: NDArray[np.float64],
) -> Chunk:
    """Read the points of some tiles' cores that lie within a box.

    Parameters
    ----------
    store : ChunkStore
    tiles : iterable of int
        Indices in the layout, each once.
    low, high : (2,) float64 arrays
        The box: low <= x, y <= high, metres; may be infinite.

    Returns
    -------
    Chunk
        In the order of the rows, whatever that of the tiles.

    Raises
    ------
    ChunkError
        When a chunk is damaged, or neither a chunk nor all pieces are there.
    """
    parts = []
    for tile in tiles:
        chunk = read_chunk(store, tile) if has_chunk(store, tile) else read_tile(store, tile)
        x, y = chunk.xyz[:, 0], chunk.xyz[:, 1]
        inside = (x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])
        parts.append(chunk.select(chunk.core & inside))
    together = joined(parts)
    return together.select(np.argsort(together.rows))


def _format(store: ChunkStore) -> _Format:
    module: Any = import_module(f"tiling.{_FORMATS[store.format]}")
    return cast(_Format, module)
