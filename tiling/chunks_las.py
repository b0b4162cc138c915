"""Chunks in LAS or LAZ 1.4, point format 6, with extra dimensions row and core.

Coordinates are on the map's grid, on which each has been checked to come back as it is.
"""

from datetime import date
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from tiling.chunk_store import Chunk, ChunkStore
from tiling.errors import GridError
from tiling.output_file import create_file

# It has no types that a checker can use.
laspy: Any = import_module("laspy")

_CREATED = date(1970, 1, 1)
"""Of every chunk: the same points give the same bytes on any day."""


def write(path: Path, chunk: Chunk, store: ChunkStore, tile: int) -> None:
    """Write a chunk; the tile's bounds and its halo are in a VLR."""
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


def read(path: Path) -> Chunk:
    """Read a chunk."""
    with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as file:
        points = file.read()
        integers = np.column_stack([points.X, points.Y, points.Z])
        xyz = integers * file.header.scales + file.header.offsets
    rows = np.asarray(points.row).astype(np.int64)
    return Chunk(xyz, rows, np.asarray(points.core).astype(bool))
