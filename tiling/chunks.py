"""The map cut into tiles on disk: for each tile a chunk of its own points and of those around."""

from datetime import date
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from tiling.atomic import atomic_file
from tiling.chunk_store import Chunk, ChunkStore
from tiling.errors import ChunkError, GridError
from tiling.formats.parquet_file import open_parquet
from tiling.output_file import create_file

_COLUMNS = ("x", "y", "z")
_CREATED = date(1970, 1, 1)
"""Of every chunk of LAS: the same points give the same bytes on any day."""


def write_chunk(store: ChunkStore, tile: int, chunk: Chunk) -> None:
    """Write the chunk of a tile.

    Its bytes depend on the points and the store alone. It appears whole or not at all.

    Raises
    ------
    GridError
        When the chunk is LAS, and a point is not on the store's grid.
    """
    with atomic_file(store.chunk_path(tile)) as temporary:
        (_write_parquet if store.format == "parquet" else _write_las)(temporary, chunk, store, tile)


def read_chunk(store: ChunkStore, tile: int) -> Chunk:
    """Read the chunk of a tile.

    Raises
    ------
    ChunkError
        When it is missing or damaged.
    """
    path = store.chunk_path(tile)
    expected = f"the chunk of tile {tile}"
    if not path.is_file():
        raise ChunkError(path, expected, "no such file")
    try:
        chunk = (_read_parquet if store.format == "parquet" else _read_las)(path)
    except Exception as error:  # of pyarrow, laspy or lazrs, and each has many
        raise ChunkError(path, expected, " ".join(str(error).split())[:200]) from error
    core_count = int(store.layout.counts[tile])
    if int(chunk.core.sum()) != core_count:
        found = f"{int(chunk.core.sum())}"
        raise ChunkError(path, f"{core_count} points in the core of tile {tile}", found)
    return chunk


def read_core_rows(store: ChunkStore, tile: int) -> NDArray[np.int64]:
    """Return the row numbers of a tile's core; of Parquet no more is read than these."""
    if store.format != "parquet":
        chunk = read_chunk(store, tile)
        return chunk.rows[chunk.core]
    with open_parquet(store.chunk_path(tile)) as file:
        table = file.read(["row", "core"], use_threads=False)
    return np.asarray(table.column("row").filter(table.column("core")))


def _write_parquet(path: Path, chunk: Chunk, store: ChunkStore, tile: int) -> None:
    """Write a chunk; the tile's bounds and its halo are in the metadata of the schema."""
    columns = {name: chunk.xyz[:, axis] for axis, name in enumerate(_COLUMNS)}
    table = pa.table({**columns, "row": chunk.rows, "core": chunk.core})
    table = table.replace_schema_metadata({"tile": store.describe(tile)})
    split = dict.fromkeys(_COLUMNS, "BYTE_STREAM_SPLIT") | {"row": "DELTA_BINARY_PACKED"}
    # Coordinates hardly repeat, so dictionaries only cost time.
    with create_file(path) as file:
        pq.write_table(
            table,
            file,
            row_group_size=max(len(chunk), 1),
            use_dictionary=False,
            write_statistics=False,
            # Fast, as chunks are read several times, and small whatever the coordinates.
            compression="lz4",
            column_encoding=split,
        )


def _read_parquet(path: Path) -> Chunk:
    chunk = _chunk_in_parquet(path)
    # Arrow keeps what it freed: as much again as the chunk, all the time that it is worked on.
    pa.default_memory_pool().release_unused()
    return chunk


def _chunk_in_parquet(path: Path) -> Chunk:
    with open_parquet(path) as file:
        table = file.read(use_threads=False)
    xyz = np.empty((table.num_rows, 3))
    for axis, name in enumerate(_COLUMNS):
        xyz[:, axis] = table.column(name).to_numpy()
    return Chunk(xyz, table.column("row").to_numpy().copy(), table.column("core").to_numpy())


def _write_las(path: Path, chunk: Chunk, store: ChunkStore, tile: int) -> None:
    """Write a chunk; the tile's bounds and its halo are in a VLR."""
    laspy: Any = import_module("laspy")  # takes long to import
    assert store.grid is not None  # so says ChunkStore
    held = store.grid.holds(chunk.xyz)
    if not held.all():
        raise GridError(str(store.chunk_path(tile)), chunk.xyz[~held][0])
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.creation_date = _CREATED
    header.scales, header.offsets = np.array(store.grid.scales), np.array(store.grid.offsets)
    header.add_extra_dims(
        [
            laspy.ExtraBytesParams("row", np.uint64, "row number in the map"),
            laspy.ExtraBytesParams("core", np.uint8, "1 in the core, 0 in the halo"),
        ]
    )
    data = store.describe(tile).encode()
    header.vlrs.append(laspy.VLR("tiling", 1, "tile and halo, as JSON", data))
    points = laspy.LasData(header, laspy.ScaleAwarePointRecord.zeros(len(chunk), header=header))
    integers = store.grid.integers(chunk.xyz)
    points.X, points.Y, points.Z = integers.T
    points.row, points.core = chunk.rows, chunk.core
    # The file is opened here because laspy goes by its suffix, and a temporary one has another.
    with create_file(path) as file:
        points.write(file, do_compress=store.format == "laz", laz_backend=laspy.LazBackend.Lazrs)


def _read_las(path: Path) -> Chunk:
    """Read a chunk."""
    laspy: Any = import_module("laspy")
    with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as file:
        points = file.read()
        integers = np.column_stack([points.X, points.Y, points.Z])
        xyz = integers * file.header.scales + file.header.offsets
    rows = np.asarray(points.row).astype(np.int64)
    return Chunk(xyz, rows, np.asarray(points.core).astype(bool))
