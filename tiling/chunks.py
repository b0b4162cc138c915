"""The map cut into tiles on disk: for each tile a chunk of its own points and of those around."""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import date
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from tiling.collection import MapCollection
from tiling.errors import ChunkError, GridError
from tiling.formats.parquet_tables import open_parquet, xyz_of
from tiling.formats.points import COORDINATES, only_finite
from tiling.grid import Grid
from tiling.layout import Layout
from tiling.output_file import atomic_file, create_file
from tiling.survey import Survey

ChunkFormat = Literal["parquet", "las", "laz"]

_STORE_FILE = "store.json"


@dataclass(frozen=True, slots=True)
class Chunk:
    """Points of a tile and around it, in the order of their rows."""

    xyz: NDArray[np.float64]
    """(n, 3): as the map has them, to the last bit."""
    rows: NDArray[np.int64]
    """(n,): row numbers in the whole map."""
    core: NDArray[np.bool_]
    """(n,): whether the point lies in the tile's core; otherwise in its halo."""

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "Chunk":
        """Return some of the points."""
        if chosen.dtype == np.bool_:
            chosen = np.flatnonzero(chosen)
        # Whole rows are taken several times faster than by an index in brackets.
        return Chunk(self.xyz.take(chosen, axis=0), self.rows.take(chosen), self.core.take(chosen))


@dataclass(frozen=True, eq=False)
class ChunkStore:
    """A folder for the chunks of one map, cut in one way."""

    folder: Path
    layout: Layout
    halo: float
    """Width of the halo around each core, metres."""
    point_count: int
    """Points of the map, finite or not."""
    format: ChunkFormat = "parquet"
    grid: Grid | None = None
    """Of the coordinates; needed for LAS, see `tiling.chunks.grid_of`."""
    max_points: int = 1
    """What a core may hold, unless it is a single column."""

    def __post_init__(self) -> None:
        if self.format != "parquet" and self.grid is None:
            raise ValueError(f"chunks of format {self.format} need a grid")

    def make(self) -> None:
        """Make the folder for chunks."""
        (self.folder / "chunks").mkdir(parents=True, exist_ok=True)

    def save(self) -> None:
        """Make the folder, and write what `open` reads."""
        self.make()
        stored = {
            "halo": self.halo,
            "point_count": self.point_count,
            "format": self.format,
            "grid": self.grid and [self.grid.scales, self.grid.offsets],
            "max_points": self.max_points,
            "layout": self.layout.to_json(),
        }
        with atomic_file(self.folder / _STORE_FILE) as temporary:
            temporary.write_text(json.dumps(stored), encoding="utf-8")

    @classmethod
    def open(cls, folder: Path) -> "ChunkStore":
        """Open the store of a folder; a `ChunkError` says that there is none."""
        path = folder / _STORE_FILE
        try:
            stored = json.loads(path.read_text(encoding="utf-8"))
        except (FileNotFoundError, ValueError):
            raise ChunkError(path, "a folder of chunks", "no description of one") from None
        layout, grid = Layout.from_json(stored.pop("layout")), stored.pop("grid")
        return cls(folder, layout, grid=grid and Grid(*map(tuple, grid)), **stored)

    def chunk_path(self, tile: int) -> Path:
        """Return the file of a tile."""
        return self.folder / "chunks" / f"{tile:06d}.{self.format}"

    def describe(self, tile: int) -> str:
        """Return a tile's index, its core, and the width of its halo, as JSON."""
        place = self.layout[tile]
        low, high = place.low.tolist(), place.high.tolist()
        return json.dumps({"tile": tile, "low": low, "high": high, "halo": self.halo})


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


def read_rows(store: ChunkStore, tile: int) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return `rows` and `core` of a tile's chunk; of Parquet no more is read than these."""
    if store.format != "parquet":
        chunk = read_chunk(store, tile)
        return chunk.rows, chunk.core
    with open_parquet(store.chunk_path(tile)) as file:
        table = file.read(["row", "core"], use_threads=False)
    return table.column("row").to_numpy(), table.column("core").to_numpy()


def _write_parquet(path: Path, chunk: Chunk, store: ChunkStore, tile: int) -> None:
    """Write a chunk; the tile's bounds and its halo are in the metadata of the schema."""
    columns = dict(zip(COORDINATES, chunk.xyz.T, strict=True))
    table = pa.table({**columns, "row": chunk.rows, "core": chunk.core})
    table = table.replace_schema_metadata({"tile": store.describe(tile)})
    split = dict.fromkeys(COORDINATES, "BYTE_STREAM_SPLIT") | {"row": "DELTA_BINARY_PACKED"}
    # Coordinates hardly repeat, so dictionaries only cost time.
    with create_file(path) as file:
        pq.write_table(
            table,
            file,
            row_group_size=max(len(chunk), 1),
            use_dictionary=False,
            write_statistics=False,
            # Little slower than lz4 on the coordinates of a scanner, and a quarter smaller.
            compression="zstd",
            compression_level=1,
            column_encoding=split,
        )


def _read_parquet(path: Path) -> Chunk:
    chunk = _chunk_in_parquet(path)
    pool = pa.default_memory_pool()
    if pool.backend_name != "system":
        # It keeps what it freed: as much again as the chunk, all the time that it is worked on.
        pool.release_unused()
    return chunk


def _chunk_in_parquet(path: Path) -> Chunk:
    with open_parquet(path) as file:
        table = file.read(use_threads=False)
    rows, core = table.column("row").to_numpy().copy(), table.column("core").to_numpy()
    return Chunk(xyz_of(table), rows, core)


def _write_las(path: Path, chunk: Chunk, store: ChunkStore, tile: int) -> None:
    """Write a chunk; the tile's bounds and its halo are in a VLR."""
    laspy: Any = import_module("laspy")  # takes long to import
    assert store.grid is not None  # so says ChunkStore
    held = store.grid.holds(chunk.xyz)
    if not held.all():
        raise GridError(str(store.chunk_path(tile)), chunk.xyz[~held][0])
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.global_encoding.wkt = True  # as LAS asks of this point format: PDAL complains without
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
    laspy: Any = import_module("laspy")
    with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as file:
        points = file.read()
        integers = np.column_stack([points.X, points.Y, points.Z])
        xyz = integers * file.header.scales + file.header.offsets
    rows = np.asarray(points.row).astype(np.int64)
    return Chunk(xyz, rows, np.asarray(points.core).astype(bool))


_SCALES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 2.0**-4, 2.0**-8, 2.0**-12, 2.0**-16, 2.0**-20)
"""Tried where the map has no grid of its own: decimals, and fractions of voxel grids."""


def grid_of(collection: MapCollection, survey: Survey) -> Grid:
    """Find a grid that gives every finite coordinate of a map, which was surveyed, back.

    It is the map's own if it is LAS on one grid; any other map is read until no grid is left.

    Raises
    ------
    GridError
        When there is none.
    """
    own = list(dict.fromkeys(reader.description.grid for reader in collection.readers))
    if collection.metres is not None or collection.is_moved:
        own = [None]  # what was multiplied or turned is on it no more
    if len(own) == 1 and own[0] is not None:
        return own[0]
    candidates = [*(grid for grid in own if grid is not None), *_grids_within(survey)]
    lost = survey.maximum
    for _, batch in collection.batches():
        xyz = only_finite(batch.xyz)
        for grid in list(candidates):
            off = np.flatnonzero(~grid.holds(xyz))
            if len(off):
                candidates.remove(grid)
                lost = xyz[off[0]]
        if not candidates:
            raise GridError(collection.name, lost)
    return candidates[0]


def _grids_within(survey: Survey) -> Iterator[Grid]:
    """Yield the grids whose integers of 32 bits reach over the map."""
    if not survey.finite_count:
        yield Grid((_SCALES[1],) * 3, (0.0,) * 3)
        return
    ends = np.array([survey.minimum, survey.maximum])
    middle = np.floor(ends[0] / 2 + ends[1] / 2)
    for scale in _SCALES:
        for x, y, z in ([0.0] * 3, middle.tolist()):
            grid = Grid((scale,) * 3, (x, y, z))
            if grid.reaches(ends):
                yield grid
                break
