"""Small seeded attacks: whatever becomes of a file's bytes, it is read in full or refused.

Each format's file is damaged in many ways: bits flipped, bytes put in, taken out, doubled, cut off,
and numbers of the header made others. It ends in a success that gives as many points as the file
then counts, or in one short line; never in a traceback, a screen of text or a heap of memory.
"""

import io
import random
import tempfile
import tracemalloc
from decimal import Decimal
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from benchmarks.mutations import mutated
from tests.tiling.test_leftover import COUNT, MAKERS, POINTS
from tiling.collection import MapCollection
from tiling.errors import TilingError
from tiling.formats import open_map

TIMES = 60
MOST_BYTES = 200e6


def parquet(row_groups: int) -> bytes:
    file = io.BytesIO()
    table = pa.table(dict(zip("xyz", POINTS.T, strict=True)))
    pq.write_table(table, file, row_group_size=COUNT // row_groups, store_schema=False)
    return file.getvalue()


def text(separator: str, head: str) -> bytes:
    return (head + "".join(f"{separator.join(map(repr, row))}\n" for row in ROWS)).encode()


def of_points() -> bytes:
    file = io.BytesIO()
    points = pa.FixedSizeListArray.from_arrays(POINTS.reshape(-1), 3)
    pq.write_table(pa.table({"xyz": points, "price": [Decimal("1.5")] * COUNT}), file)
    return file.getvalue()


def e57() -> bytes:
    pytest.importorskip("pye57", reason="pye57 is not installed (extra e57)")
    from tests.tiling.test_e57 import write_e57  # noqa: PLC0415 - needs pye57

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.e57"
        write_e57(path, (30, 10), picture=1000)
        return path.read_bytes()


def npz_with_objects() -> bytes:
    file = io.BytesIO()
    np.savez(file, cloud=POINTS, meta=np.array({"by": "hand"}, dtype=object))
    return file.getvalue()


def as_npy(array: np.ndarray) -> bytes:
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


ROWS = [[*row, number] for number, row in enumerate(POINTS.tolist())]
FILES = {
    **{name: make(COUNT) for name, make in MAKERS.items()},
    "map.parquet": parquet(1),
    "groups.parquet": parquet(2),
    "points.parquet": of_points(),
    "organised.npy": as_npy(POINTS.reshape(8, 5, 3)),
    "objects.npz": npz_with_objects(),
    "map.xyz": text(" ", ""),
    "map.pts": text("\t", f"{COUNT}\n"),
    "map.csv": text(",", "x,y,z,n\n"),
    "map.bin": POINTS[:, [0, 1, 2, 2]].astype("<f4").tobytes(),
    "map.e57": None,  # made where pye57 is installed
}


@pytest.mark.parametrize("name", FILES)
def test_a_damaged_file_is_read_in_full_or_refused(tmp_path, name):
    content = e57() if name == "map.e57" else FILES[name]
    path = tmp_path / name
    chance = random.Random(name)
    tracemalloc.start()
    try:
        for _ in range(TIMES):
            path.write_bytes(mutated(content, chance))
            try:
                collection = MapCollection([path])
                found = sum(len(batch.xyz) for _, batch in collection.batches(7))
                assert found == collection.point_count
                assert all(len(note) < 400 for note in open_map(path).description.notes)
            except TilingError as error:
                message = str(error)
                assert len(message) < 400, message
                assert message.isprintable(), message
        assert tracemalloc.get_traced_memory()[1] < MOST_BYTES
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("file", ["npz__*", "parquet__*7d*", "parquet__*db*", "ply__*"])
def test_attacks_are_refused_in_one_short_line(shared_data, file):
    (path,) = (shared_data / "cases/attack").glob(file)
    with pytest.raises(TilingError) as raised:
        sum(len(batch.xyz) for _, batch in MapCollection([path]).batches())
    assert len(str(raised.value)) < 400
    assert str(raised.value).isprintable()


def test_names_of_files_cannot_write_to_a_terminal(tmp_path):
    path = tmp_path / "map\x1b]0;title\x07\n\u202e.pcd"
    path.write_bytes(b"\x1b[31mno map")
    with pytest.raises(TilingError) as raised:
        open_map(path)
    assert str(raised.value).isprintable()
