"""Pieces: the points of a range of the map's rows, sorted by tile, in one file.

A piece is a sequence of points, an index, and an end. A point is x, y, z as float64 and its row
number as int64, of which the complement (~row) says that the point is in the tile's halo and not
in its core; a point is there once for each tile that it belongs to. The index names runs of
points: tile, first point, number of points. The points of a tile are in the order of their rows.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tiling.atomic import atomic_file
from tiling.chunk_store import Chunk, ChunkStore
from tiling.errors import ChunkError
from tiling.formats.points import PointBatch
from tiling.tile_sorter import TileSorter

POINTS_AT_A_TIME = 1_000_000
"""Points that are read, or sorted by tile, at a time."""

_END = struct.Struct("<8s16sqqqqI")
"""Magic, key of the store, first row, row after the last, points, runs, checksum of the index."""
_MAGIC = b"PIECE 1\n"
_POINT_BYTES = 32
_RUN_BYTES = 24


class PointSource(Protocol):
    """What gives the points of a map: its files, or a copy of their coordinates."""

    def batches(self, max_points: int, rows: range) -> Iterator[tuple[int, PointBatch]]:
        """Yield points of a range of rows, in order; see `MapCollection.batches`."""


Integers = NDArray[np.int64]


def write_pieces(
    store: ChunkStore,
    source: PointSource,
    rows: range,
    part: int,
    most: int = POINTS_AT_A_TIME,
) -> int:
    """Sort a range of the map's rows by tile into one file.

    The file appears whole or not at all, and an earlier one of that part is replaced.

    Parameters
    ----------
    store : ChunkStore
    source : PointSource
        The map.
    rows : range
        Consecutive row numbers. The ranges of all parts together are all rows of the map.
    part : int
        Number of the range.
    most : int
        Points held in memory at a time. A point counts once for each tile that it belongs to.

    Returns
    -------
    int
        Points in the file.

    Raises
    ------
    RowRangeError
        When the map has no such rows.
    MapFormatError
        When a file of the map is not what its header announced.
    """
    sorter = TileSorter(store.layout, store.halo)
    runs = [np.empty((0, 3), np.int64)]
    written = 0
    path = store.piece_path(part)
    with atomic_file(path) as temporary, temporary.open("wb") as stream:
        # Half of them, as most points have some of them again in a halo.
        for _, batch in source.batches(max(most // 2, 1), rows):
            for points, counts in sorter.by_tile(batch.xyz, batch.first_row, most):
                stream.write(points.data)
                runs.append(_runs(counts, written))
                written += len(points)
        index = np.concatenate(runs).tobytes()
        stream.write(index)
        count = len(index) // _RUN_BYTES
        checksum = zlib.crc32(index)
        end = (_MAGIC, store.key, rows.start, rows.stop, written, count, checksum)
        stream.write(_END.pack(*end))
    return written


def read_tile(store: ChunkStore, tile: int) -> Chunk:
    """Gather the points of a tile from all pieces; see `tiling.chunks.assemble`."""
    runs = list(_runs_of_all(store).of(tile))
    points = np.empty((sum(count for _, _, count in runs), 4))
    done = 0
    for path, first, count in runs:
        with path.open("rb") as stream:
            stream.seek(first * _POINT_BYTES)
            found = stream.readinto(points[done : done + count].data)
        if found != count * _POINT_BYTES:
            raise ChunkError(path, f"{count} points of tile {tile}", "the end of the file")
        done += count
    marked = points[:, 3].copy().view(np.int64)
    core = marked >= 0
    core_count = int(store.layout.counts[tile])
    if int(core.sum()) != core_count:
        found_count = f"{int(core.sum())}: damaged pieces, or those of another map"
        expected = f"{core_count} points in the core of tile {tile}"
        raise ChunkError(store.folder / "pieces", expected, found_count)
    return Chunk(np.ascontiguousarray(points[:, :3]), np.where(core, marked, ~marked), core)


def _runs(counts: Integers, first: int) -> Integers:
    """Describe the runs of points sorted by tile, the first of which has a place in the file."""
    tiles = np.flatnonzero(counts)
    sizes = counts[tiles]
    return np.column_stack([tiles, first + np.cumsum(sizes) - sizes, sizes])


@dataclass(frozen=True, slots=True)
class _Piece:
    """What the end of a piece says: its rows, and where its index is."""

    path: Path
    rows: range
    index_start: int
    index_size: int
    checksum: int


@dataclass(frozen=True, slots=True)
class _Runs:
    """The runs of points of all pieces, by tile, and those of a tile in the rows' order.

    Attributes
    ----------
    paths : tuple of Path
        Of the pieces.
    tile, piece, first, count : (R,) int64 arrays
    """

    paths: tuple[Path, ...]
    tile: Integers
    piece: Integers
    first: Integers
    count: Integers

    def of(self, tile: int) -> Iterator[tuple[Path, int, int]]:
        """Yield file, first point and number of points of each run of a tile."""
        found = slice(*np.searchsorted(self.tile, [tile, tile + 1]))
        columns = (self.piece[found], self.first[found], self.count[found])
        for piece, first, count in zip(*(column.tolist() for column in columns), strict=True):
            yield self.paths[piece], first, count


def _runs_of_all(store: ChunkStore) -> _Runs:
    """Return the runs of all pieces; they are read once, for all tiles that a process does."""
    folder = store.folder / "pieces"
    changed = folder.stat().st_mtime_ns if folder.exists() else 0
    return _read_runs(folder, store.key, store.point_count, changed)


@lru_cache(maxsize=1)
def _read_runs(folder: Path, key: bytes, point_count: int, _changed: int) -> _Runs:
    pieces = _pieces(folder, key, point_count)
    parts = [np.empty((0, 3), np.int64)]
    for piece in pieces:
        with piece.path.open("rb") as stream:
            stream.seek(piece.index_start)
            data = stream.read(piece.index_size)
        if zlib.crc32(data) != piece.checksum:
            raise ChunkError(piece.path, "the index that was written", "another one")
        parts.append(np.frombuffer(data, np.int64).reshape(-1, 3))
    runs = np.concatenate(parts)
    numbers = np.repeat(np.arange(len(pieces)), [len(part) for part in parts[1:]])
    order = np.argsort(runs[:, 0], kind="stable")
    tile, first, count = runs[order].T.copy()
    paths = tuple(piece.path for piece in pieces)
    return _Runs(paths, tile, numbers[order], first, count)


def _pieces(folder: Path, key: bytes, point_count: int) -> list[_Piece]:
    """Return the pieces in the rows' order, having checked that they are all rows of the map."""
    paths = sorted(folder.glob("[!.]*.piece"))
    pieces = sorted((_read_end(path, key) for path in paths), key=_rows_of)
    row = 0
    for piece in pieces:
        if piece.rows.start != row:
            expected = f"a piece that begins with row {row}"
            raise ChunkError(piece.path, expected, f"one with row {piece.rows.start}")
        row = piece.rows.stop
    if row != point_count:
        raise ChunkError(folder, f"pieces of {point_count} points", f"pieces of {row}")
    return pieces


def _rows_of(piece: _Piece) -> tuple[int, int]:
    return piece.rows.start, piece.rows.stop


def _read_end(path: Path, key: bytes) -> _Piece:
    with path.open("rb") as stream:
        size = stream.seek(0, 2)
        stream.seek(max(size - _END.size, 0))
        end = stream.read(_END.size)
    if len(end) < _END.size or not end.startswith(_MAGIC):
        raise ChunkError(path, "a whole piece of a map", "a file without the end of one")
    _, found_key, start, stop, points, runs, checksum = _END.unpack(end)
    if found_key != key:
        raise ChunkError(path, "a piece of this map, cut like this", "one of another")
    index_start, index_size = points * _POINT_BYTES, runs * _RUN_BYTES
    whole = index_start + index_size + _END.size
    if size != whole:
        raise ChunkError(path, f"a piece of {whole} bytes", f"{size} bytes")
    return _Piece(path, range(start, stop), index_start, index_size, checksum)
