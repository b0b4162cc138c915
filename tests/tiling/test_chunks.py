"""Chunks hold each point once in a core and wherever else it is near, to the last bit."""

import json
import pickle
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from unittest import mock

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.chunks import Chunk, ChunkStore, read_chunk, read_rows, write_chunk
from tiling.collection import MapCollection
from tiling.errors import ChunkError, GridError
from tiling.formats import PointBatch
from tiling.grid import Grid
from tiling.layout import quadtree
from tiling.pieces import gathered, sort_by_tile
from tiling.survey import survey, survey_batches

GRID = Grid((2.0**-6,) * 3, (0.0,) * 3)
FORMATS = ("parquet", "las", "laz")


def collection_of(folder: Path, xyz: np.ndarray) -> MapCollection:
    paths = [folder / "first.npy", folder / "second.npy"]
    np.save(paths[0], xyz[: len(xyz) // 3])
    np.save(paths[1], xyz[len(xyz) // 3 :])
    return MapCollection(paths)


def store_of(folder, collection, max_points, halo, kind="parquet"):
    layout = quadtree(survey(collection).occupancy, max_points)
    store = ChunkStore(folder, layout, halo, collection.point_count, kind, GRID)
    store.save()
    return store


HELD_BY_A_CHUNK = """
import sys
from pathlib import Path
from tiling.chunks import _read_parquet

def held():
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("RssAnon"))

_read_parquet(Path(sys.argv[1]))  # what the first of all leaves behind is not of a chunk
before = held()
again = _read_parquet(Path(sys.argv[2]))
print(held() - before)
"""


def gathered_from(pieces, store, tile):
    runs = [
        points[first : first + count]
        for points, runs in pieces
        for of_tile, first, count in runs.tolist()
        if of_tile == tile
    ]
    return gathered(store, tile, runs)


def fill(store, collection, cuts=(), backwards=False):
    ends = [0, *sorted(cuts), collection.point_count]
    parts = [range(start, stop) for start, stop in pairwise(ends)]
    tiles = list(range(len(store.layout)))
    pieces = [sort_by_tile(store, collection, rows) for rows in parts]
    for tile in reversed(tiles) if backwards else tiles:
        given = gathered_from(pieces, store, tile)
        write_chunk(store, tile, given)
        kept = read_chunk(store, tile)
        for name in ("xyz", "rows", "core"):
            assert getattr(given, name).tobytes() == getattr(kept, name).tobytes()


def chunk_bytes(store):
    return [store.chunk_path(tile).read_bytes() for tile in range(len(store.layout))]


def points(seed, size, extent, shift):
    """Points on a grid, so that many lie on borders and on one another."""
    random = np.random.default_rng(seed)
    xyz = np.round(random.normal(size=(size, 3)) * extent * 64) / 64 + shift
    xyz[random.random(size) < 0.05] = np.nan
    return xyz


@settings(deadline=None, max_examples=40)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 300),
    st.sampled_from([0.5, 5.0, 300.0]),
    st.sampled_from([0.0, -4e5]),
    st.integers(5, 200),
    st.sampled_from([0.0, 0.25, 1.3, 40.0]),
    st.lists(st.integers(0, 1), max_size=3),
    st.sampled_from([3, 50, 10**6]),
    st.sampled_from(FORMATS),
)
def test_chunks_hold_core_and_halo_whatever_the_parts(
    tmp_path_factory, seed, size, extent, shift, max_points, halo, cuts, most, kind
):
    folder = tmp_path_factory.mktemp("map")
    xyz = points(seed, size, extent, shift)
    collection = collection_of(folder, xyz)
    store = store_of(folder / "once", collection, max_points, halo, kind)
    fill(store, collection)
    tiles = store.layout.tile_of(xyz)
    finite = np.isfinite(xyz).all(axis=1)
    seen = np.zeros(size, int)
    for tile in range(len(store.layout)):
        chunk = read_chunk(store, tile)
        rows, core = read_rows(store, tile)
        np.testing.assert_array_equal(rows, chunk.rows)
        np.testing.assert_array_equal(core, chunk.core)
        low, high = store.layout.low[tile] - halo, store.layout.high[tile] + halo
        inside = finite & (xyz[:, :2] >= low).all(axis=1) & (xyz[:, :2] < high).all(axis=1)
        np.testing.assert_array_equal(chunk.rows, np.flatnonzero(inside))
        np.testing.assert_array_equal(chunk.xyz, xyz[inside])
        np.testing.assert_array_equal(chunk.core, tiles[inside] == tile)
        assert (chunk.xyz.dtype, chunk.rows.dtype, chunk.core.dtype) == (float, np.int64, bool)
        seen[chunk.rows[chunk.core]] += 1
    np.testing.assert_array_equal(seen, finite)

    again = store_of(folder / "again", collection, max_points, halo, kind)
    random = np.random.default_rng(seed)
    with mock.patch("tiling.pieces.DEFAULT_BATCH", most):
        fill(again, collection, random.integers(0, size + 1, len(cuts)), backwards=True)
    assert chunk_bytes(again) == chunk_bytes(store)


@pytest.fixture
def filled(tmp_path):
    """A map of 400 points, a store of it, and its pieces of 150 rows."""
    xyz = points(1, 400, 5.0, 0.0)
    collection = collection_of(tmp_path, xyz)
    store = store_of(tmp_path / "store", collection, 60, 0.5)
    fill(store, collection, [150, 300])
    return xyz, collection, store


def test_a_store_opens_again_and_travels_to_other_processes(filled):
    _, _, store = filled
    for other in (ChunkStore.open(store.folder), pickle.loads(pickle.dumps(store))):
        assert (other.halo, other.format) == (store.halo, store.format)
        assert other.layout.to_json() == store.layout.to_json()
        assert (other.point_count, other.grid) == (store.point_count, store.grid)
        assert read_chunk(other, 0).rows.tolist() == read_chunk(store, 0).rows.tolist()
    with pytest.raises(ChunkError, match=r"store\.json: expected a folder of chunks"):
        ChunkStore.open(store.folder / "chunks")


def test_las_chunks_need_a_grid(filled):
    _, _, store = filled
    with pytest.raises(ValueError, match="need a grid"):
        ChunkStore(store.folder, store.layout, 0.5, 400, "las")


def test_a_chunk_that_lacks_points_is_refused_in_one_line(filled):
    _, collection, store = filled
    parts = [sort_by_tile(store, collection, rows) for rows in (range(150), range(300, 400))]
    with pytest.raises(ChunkError, match=r"expected \d+ points in the core of tile 2, found \d+"):
        gathered_from(parts, store, 2)


@pytest.mark.parametrize("kind", FORMATS)
def test_chunks_that_are_missing_or_damaged_are_refused_in_one_line(filled, tmp_path, kind):
    _, collection, _ = filled
    store = store_of(tmp_path / kind, collection, 60, 0.5, kind)
    with pytest.raises(ChunkError, match="expected the chunk of tile 3, found no such file"):
        read_chunk(store, 3)
    fill(store, collection)
    path = store.chunk_path(3)
    content = path.read_bytes()
    for size in (0, 10, len(content) // 2, len(content) - 40):
        path.write_bytes(content[:size])
        with pytest.raises(ChunkError) as raised:
            read_chunk(store, 3)
        assert str(raised.value).startswith(f"{path}: expected ")
        assert "\n" not in str(raised.value)
    path.write_bytes(store.chunk_path(2).read_bytes())
    with pytest.raises(ChunkError):
        read_chunk(store, 3)


def test_parquet_chunks_are_tables_for_other_tools(filled):
    _, _, store = filled
    table = pq.read_table(store.chunk_path(1))
    assert [str(field.type) for field in table.schema] == ["double"] * 3 + ["int64", "bool"]
    assert table.schema.names == ["x", "y", "z", "row", "core"]
    described = json.loads(table.schema.metadata[b"tile"])
    place = store.layout[1]
    assert described == {
        "tile": 1,
        "low": place.low.tolist(),
        "high": place.high.tolist(),
        "halo": 0.5,
    }


@pytest.mark.parametrize("kind", ["las", "laz"])
def test_las_chunks_are_maps_for_other_tools(filled, tmp_path, kind):
    xyz, collection, _ = filled
    store = store_of(tmp_path / kind, collection, 60, 0.5, kind)
    fill(store, collection)
    found = laspy.read(store.chunk_path(1))
    assert found.header.global_encoding.wkt  # LAS 1.4 R15, table 4: point formats 6 to 10
    np.testing.assert_array_equal(found.xyz, xyz[found.row.astype(int)])
    np.testing.assert_array_equal(
        found.row[found.core == 1], np.flatnonzero(store.layout.tile_of(xyz) == 1)
    )
    np.testing.assert_array_equal(found.header.scales, GRID.scales)
    np.testing.assert_array_equal(found.header.mins, found.xyz.min(axis=0))
    (record,) = found.header.vlrs.get_by_id("tiling", [1])
    assert json.loads(record.record_data)["halo"] == 0.5
    assert MapCollection([store.chunk_path(1)]).point_count == len(found.xyz)


def test_las_chunks_of_points_off_the_grid_are_refused(tmp_path):
    xyz = np.random.default_rng(0).normal(size=(50, 3))
    collection = collection_of(tmp_path, xyz)
    store = store_of(tmp_path / "store", collection, 100, 0.5, "las")
    chunk = gathered_from([sort_by_tile(store, collection, range(50))], store, 0)
    with pytest.raises(GridError, match=r"000000\.las: expected coordinates that LAS gives back"):
        write_chunk(store, 0, chunk)
    assert list(store.chunk_path(0).parent.iterdir()) == []


@pytest.mark.linux_only
def test_a_chunk_that_was_read_takes_no_more_than_its_points(tmp_path):
    paths = []
    for count in (10, 1_000_000):
        xyz = np.random.default_rng(0).uniform(size=(count, 3))
        occupancy = survey_batches([PointBatch(0, xyz, None)]).occupancy
        store = ChunkStore(tmp_path / f"{count}", quadtree(occupancy, 2_000_000), 0.0, count)
        store.make()
        write_chunk(store, 0, Chunk(xyz, np.arange(count), np.ones(count, np.bool_)))
        paths.append(str(store.chunk_path(0)))
    program = [sys.executable, "-c", HELD_BY_A_CHUNK, *paths]
    done = subprocess.run(program, capture_output=True, check=True)
    points = 33 * 1_000_000 / 1024  # KiB
    assert 0.9 * points < int(done.stdout) < 1.5 * points
