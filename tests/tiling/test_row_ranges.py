"""Any ranges that together are a map give what one pass gives, in every format."""

import io
import itertools
from collections.abc import Callable
from pathlib import Path

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.collection import MapCollection
from tiling.errors import MapFormatError, RowRangeError
from tiling.formats import MapReader, open_map

COUNT = 700
XYZ = np.random.default_rng(5).normal(size=(COUNT, 3)).round(3)
NUMBER = np.arange(COUNT, dtype="<u4")
TABLE = np.empty(COUNT, dtype=[("x", "<f8"), ("y", "<f8"), ("z", "<f8"), ("n", "<u4")])
for _axis, _name in enumerate("xyz"):
    TABLE[_name] = XYZ[:, _axis]
TABLE["n"] = NUMBER
ROWS_OF_TEXT = "".join(f"{x} {y} {z} {n}\n" for x, y, z, n in TABLE).encode()


def pcd(encoding: str, data: bytes) -> bytes:
    header = (
        f"VERSION 0.7\nFIELDS x y z n\nSIZE 8 8 8 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"
        f"WIDTH {COUNT}\nHEIGHT 1\nPOINTS {COUNT}\nDATA {encoding}\n"
    )
    return header.encode() + data


def ply(encoding: str, data: bytes, before: bytes = b"", element: str = "") -> bytes:
    header = (
        f"ply\nformat {encoding} 1.0\n{element}element vertex {COUNT}\nproperty double x\n"
        "property double y\nproperty double z\nproperty uint n\nend_header\n"
    )
    return header.encode() + before + data


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def npz(save: Callable) -> bytes:
    stream = io.BytesIO()
    save(stream, xyz=XYZ, n=NUMBER)
    return stream.getvalue()


def parquet(rows_in_a_group: int) -> bytes:
    stream = io.BytesIO()
    table = pa.table({name: TABLE[name] for name in TABLE.dtype.names})
    pq.write_table(table, stream, row_group_size=rows_in_a_group)
    return stream.getvalue()


def parquet_of_points() -> bytes:
    stream = io.BytesIO()
    points = pa.FixedSizeListArray.from_arrays(XYZ.reshape(-1), 3)
    pq.write_table(pa.table({"xyz": points, "n": NUMBER}), stream, row_group_size=64)
    return stream.getvalue()


def bare(values: int) -> bytes:
    return np.hstack([XYZ, *[NUMBER[:, None]] * (values - 3)]).astype("<f4").tobytes()


def las(compress: bool, point_format: int) -> bytes:
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales = [0.001] * 3
    cloud = laspy.LasData(header)
    cloud.xyz = XYZ
    cloud.intensity = NUMBER
    stream = io.BytesIO()
    cloud.write(stream, do_compress=compress, laz_backend=laspy.LazBackend.Lazrs)
    return stream.getvalue()


LIST_BEFORE = "element strip 1\nproperty list uchar uchar i\n"
FIXED_BEFORE = "element view 2\nproperty uchar i\n"
PACKED_COLUMNS = b"".join(TABLE[name].tobytes() for name in TABLE.dtype.names)
LITERALS = b"".join(
    bytes([len(part) - 1]) + part
    for part in (PACKED_COLUMNS[at : at + 32] for at in range(0, len(PACKED_COLUMNS), 32))
)
SIZES = np.array([len(LITERALS), len(PACKED_COLUMNS)], dtype="<u4").tobytes()

MAPS = {
    "ascii.pcd": (pcd("ascii", ROWS_OF_TEXT), False),
    "binary.pcd": (pcd("binary", TABLE.tobytes()), True),
    "compressed.pcd": (pcd("binary_compressed", SIZES + LITERALS), False),
    "text.ply": (ply("ascii", ROWS_OF_TEXT), False),
    "binary.ply": (ply("binary_little_endian", TABLE.tobytes()), True),
    "after.ply": (
        ply("binary_little_endian", TABLE.tobytes(), b"\1\2", FIXED_BEFORE),
        True,
    ),
    "list.ply": (
        ply("binary_little_endian", TABLE.tobytes(), b"\2\1\2", LIST_BEFORE),
        False,
    ),
    "table.npy": (npy(TABLE), True),
    "array.npy": (npy(XYZ), True),
    "fortran.npy": (npy(np.asfortranarray(XYZ)), True),
    "stored.npz": (npz(np.savez), False),
    "deflated.npz": (npz(np.savez_compressed), False),
    "groups.parquet": (parquet(64), True),
    "one.parquet": (parquet(COUNT), True),
    "points.parquet": (parquet_of_points(), True),
    "organised.npy": (npy(XYZ.reshape(7, 100, 3)), True),
    "kitti.bin": (bare(4), True),
    "nuscenes.pcd.bin": (bare(5), True),
    "counted.pts": (f"{COUNT}\n".encode() + ROWS_OF_TEXT, False),
    "named.csv": (b"x,y,z,n\n" + ROWS_OF_TEXT.replace(b" ", b","), False),
    "plain.las": (las(False, 3), True),
    "layers.laz": (las(True, 6), True),
    "points.laz": (las(True, 3), True),
}


def content(reader: MapReader, max_points: int, rows: range | None = None) -> tuple:
    """Return row numbers, coordinates, classes and the records, as bytes or text."""
    numbers, xyz, classes, records = [], [np.empty((0, 3))], [], []
    for batch in reader.batches(max_points, rows):
        assert 0 < len(batch.xyz) <= max_points
        numbers += range(batch.first_row, batch.first_row + len(batch.xyz))
        xyz.append(batch.xyz)
        classes += [] if batch.classification is None else batch.classification.tolist()
        kept = batch.select(np.ones(len(batch.xyz), dtype=bool))
        records.append(str(kept.to_pydict()) if isinstance(kept, pa.Table) else kept.tobytes())
    # Only tables are cut otherwise by cutting batches otherwise.
    whole = records if any(isinstance(each, str) for each in records) else b"".join(records)
    return numbers, np.concatenate(xyz).tobytes(), classes, whole


@pytest.fixture(scope="module")
def readers(tmp_path_factory) -> dict[str, MapReader]:
    folder = tmp_path_factory.mktemp("maps")
    opened = {}
    for name, (data, _) in MAPS.items():
        (folder / name).write_bytes(data)
        opened[name] = open_map(folder / name)
    return opened


@pytest.mark.parametrize("name", MAPS)
@settings(deadline=None, max_examples=8)
@given(cuts=st.lists(st.integers(0, COUNT), max_size=4), most=st.sampled_from([11, 37, 1000]))
def test_ranges_together_are_the_map(readers, name, cuts, most):
    reader = readers[name]
    numbers, xyz, classes, records = content(reader, 1000)
    assert numbers == list(range(COUNT))
    ends = [0, *sorted(cuts), COUNT]
    ranges = [range(start, stop) for start, stop in itertools.pairwise(ends)]
    parts = [content(reader, most, rows) for rows in ranges]
    assert [number for part in parts for number in part[0]] == numbers
    assert b"".join(part[1] for part in parts) == xyz
    assert [each for part in parts for each in part[2]] == classes
    if isinstance(records, bytes):
        assert b"".join(part[3] for part in parts if part[0]) == records
    else:
        expected = [
            str(pq.read_table(reader.description.path)[a:b].to_pydict())
            for rows in ranges
            for a, b in batch_ends(reader, most, rows)
        ]
        assert [table for part in parts for table in part[3]] == expected


def batch_ends(reader: MapReader, most: int, rows: range) -> list[tuple[int, int]]:
    batches = reader.batches(most, rows)
    return [(batch.first_row, batch.first_row + len(batch.xyz)) for batch in batches]


@pytest.mark.parametrize("name", MAPS)
def test_seekable_formats_say_so(readers, name):
    assert readers[name].seekable == MAPS[name][1]


@pytest.mark.parametrize("rows", [range(-1, 5), range(0, 10, 2), range(5, COUNT + 1), range(9, 3)])
def test_rows_that_are_not_there_are_refused(readers, rows):
    with pytest.raises(RowRangeError, match="expected consecutive rows from 0 to 700"):
        readers["array.npy"].batches(100, rows)


@pytest.mark.parametrize("name", ["binary.pcd", "binary.ply", "array.npy", "plain.las"])
def test_a_range_reads_nothing_after_it(tmp_path, name):
    (tmp_path / name).write_bytes(MAPS[name][0])
    reader = open_map(tmp_path / name)
    with (tmp_path / name).open("r+b") as file:
        file.truncate(len(MAPS[name][0]) // 2)
    numbers, xyz, _, _ = content(reader, 100, range(100, 200))
    assert numbers == list(range(100, 200))
    assert xyz == content(open_written(tmp_path, name), 100, range(100, 200))[1]
    with pytest.raises(MapFormatError):
        content(reader, 100, range(500, 600))


def open_written(folder: Path, name: str) -> MapReader:
    whole = folder / f"whole{Path(name).suffix}"
    whole.write_bytes(MAPS[name][0])
    return open_map(whole)


@pytest.mark.parametrize("point_format", [3, 7])
@pytest.mark.parametrize("varied", [False, True])
def test_compressed_chunks_are_begun_at(tmp_path, point_format, varied):
    lazrs = pytest.importorskip("lazrs")
    count = 120_003
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    cloud = laspy.LasData(header)
    random = np.random.default_rng(3)
    cloud.X, cloud.Y, cloud.Z = random.integers(-9999, 9999, (3, count))
    path = tmp_path / "map.laz"
    cloud.write(path, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    if varied:
        rewrite_with_varied_chunks(lazrs, path, cloud)
    reader = open_map(path)
    whole = np.concatenate([batch.records for batch in reader.batches()])
    for start, stop in [(0, 1), (49_999, 50_001), (50_000, 100_000), (118_000, count), (7, 7)]:
        parts = [batch.records for batch in reader.batches(20_000, range(start, stop))]
        found = np.concatenate([whole[:0], *parts])
        np.testing.assert_array_equal(found, whole[start:stop])


def rewrite_with_varied_chunks(lazrs, path: Path, cloud: laspy.LasData) -> None:
    """Compress the points anew, in chunks of various sizes."""
    content = path.read_bytes()
    start = int.from_bytes(content[96:100], "little")
    block = bytearray(content[:start])
    vlr = lazrs.LazVlr.new_for_compression(cloud.header.point_format.id, 0, True)
    old = bytes(open_map(path)._compression.data)
    at = block.find(old)
    block[at : at + len(old)] = bytes(vlr.record_data())
    stream = io.BytesIO()
    stream.write(block)
    compressor = lazrs.LasZipCompressor(stream, vlr)
    records = cloud.points.array.view(np.uint8).reshape(len(cloud.points), -1)
    done = 0
    for size in [40_000, 13, 30_000, 49_990, 1]:
        compressor.compress_many(np.ascontiguousarray(records[done : done + size]).reshape(-1))
        compressor.finish_current_chunk()
        done += size
    compressor.compress_many(np.ascontiguousarray(records[done:]).reshape(-1))
    compressor.done()
    path.write_bytes(stream.getvalue())


def test_a_chunk_table_that_is_wrong_only_costs_time(tmp_path):
    count = 120_003
    cloud = laspy.LasData(laspy.LasHeader(point_format=3, version="1.4"))
    cloud.X = np.arange(count)
    path = tmp_path / "map.laz"
    cloud.write(path, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    assert open_map(path).seekable
    start = int.from_bytes(path.read_bytes()[96:100], "little")
    with path.open("r+b") as file:
        file.seek(start)
        file.write(bytes(8))
    reader = open_map(path)
    assert not reader.seekable
    (batch,) = reader.batches(100, range(110_000, 110_050))
    np.testing.assert_array_equal(
        batch.records[:, :4].copy().view("<i4")[:, 0], batch.first_row + np.arange(50)
    )


def test_ranges_of_a_collection(readers):
    names = ["ascii.pcd", "binary.pcd", "stored.npz", "layers.laz"]
    collection = MapCollection([readers[name].description.path for name in names])
    whole = np.concatenate([batch.xyz for _, batch in collection.batches(90)])
    for rows in [range(0), range(650, 1500), range(1399, 1401), range(2800)]:
        found = [np.empty((0, 3))]
        row = rows.start
        for file, batch in collection.batches(300, rows):
            assert batch.first_row == row
            assert collection.first_rows[file] <= row
            row += len(batch.xyz)
            found.append(batch.xyz)
        assert row == rows.stop
        np.testing.assert_array_equal(np.concatenate(found), whole[rows.start : rows.stop])
    with pytest.raises(RowRangeError):
        next(collection.batches(10, range(2801)))


@pytest.mark.parametrize("most", [1, 300, 700, 1400, 10_000])
def test_a_collection_is_cut_where_its_files_can_be_read_from(readers, most):
    names = ["ascii.pcd", "binary.pcd", "stored.npz", "layers.laz"]
    collection = MapCollection([readers[name].description.path for name in names])
    ranges = collection.row_ranges(most)
    assert [row for rows in ranges for row in rows] == list(range(2800))
    assert all(rows for rows in ranges)
    for rows in ranges:
        assert len(rows) <= max(most, COUNT)
        for file in (0, 2):
            assert not file * COUNT < rows.start < (file + 1) * COUNT


@pytest.mark.parametrize("name", MAPS)
def test_a_file_after_another_is_read_as_if_it_were_alone(name, tmp_path):
    path = tmp_path / name
    path.write_bytes(MAPS[name][0])
    np.save(tmp_path / "before.npy", XYZ)
    collection = MapCollection([tmp_path / "before.npy", path])
    expected = content(open_map(path), 100)
    found = [batch for file, batch in collection.batches(100) if file == 1]
    assert found[0].first_row == COUNT
    assert np.concatenate([batch.xyz for batch in found]).tobytes() == expected[1]
    part = [batch for _, batch in collection.batches(100, range(COUNT + 33, 2 * COUNT - 7))]
    assert np.concatenate([batch.xyz for batch in part]).tobytes() == expected[1][24 * 33 : -24 * 7]
