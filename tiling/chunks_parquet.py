"""Chunks in Parquet: columns x, y, z, row and core."""

from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from tiling.chunk_store import Chunk, ChunkStore
from tiling.output_file import create_file
from tiling.parquet_file import open_parquet

_COLUMNS = ("x", "y", "z")


def write(path: Path, chunk: Chunk, store: ChunkStore, tile: int) -> None:
    """Write a chunk; the tile's bounds and its halo are in the metadata of the schema."""
    columns = {name: chunk.xyz[:, axis] for axis, name in enumerate(_COLUMNS)}
    table = pa.table({**columns, "row": chunk.rows, "core": chunk.core})
    table = table.replace_schema_metadata({"tile": store.describe(tile)})
    # Coordinates hardly repeat, so dictionaries only cost time.
    with create_file(path) as file:
        pq.write_table(
            table,
            file,
            row_group_size=max(len(chunk), 1),
            use_dictionary=False,
            write_statistics=False,
            compression=store.compression,
            compression_level=1 if store.compression == "zstd" else None,
        )


def read(path: Path) -> Chunk:
    """Read a chunk."""
    chunk = _read(path)
    # Arrow keeps what it freed: as much again as the chunk, all the time that it is worked on.
    pa.default_memory_pool().release_unused()
    return chunk


def _read(path: Path) -> Chunk:
    with open_parquet(path) as file:
        table = file.read(use_threads=False)
    xyz = np.empty((table.num_rows, 3))
    for axis, name in enumerate(_COLUMNS):
        xyz[:, axis] = table.column(name).to_numpy()
    return Chunk(xyz, table.column("row").to_numpy().copy(), table.column("core").to_numpy())
