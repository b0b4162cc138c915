"""Parts written in any order, by whatever process, make the file that one writer makes."""

import itertools
import pickle
import struct
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import laspy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.errors import PartsError, PointCountError
from tiling.formats import MapReader, open_map
from tiling.formats.parts import PartSummary, PartWriter

COUNT = 500
TABLE = np.empty(COUNT, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("n", "<u2")])
_RANDOM = np.random.default_rng(11)
for _name in "xyz":
    TABLE[_name] = _RANDOM.normal(size=COUNT)
TABLE["n"] = np.arange(COUNT)
XYZ = np.stack([TABLE[name] for name in "xyz"], axis=1)


def pcd() -> bytes:
    return (
        b"VERSION 0.7\nFIELDS x y z n\nSIZE 4 4 4 2\nTYPE F F F U\nCOUNT 1 1 1 1\n"
        b"WIDTH %d\nHEIGHT 1\nPOINTS %d\nDATA binary\n" % (COUNT, COUNT)
    ) + TABLE.tobytes()


def ply(order: str, vertices: bytes) -> bytes:
    """Return a file with elements of known and unknown size before and after the vertices."""
    header = (
        f"ply\nformat binary_{order}_endian 1.0\nelement camera 2\nproperty uchar i\n"
        f"element strip 1\nproperty list uchar uchar i\nelement vertex {COUNT}\n"
        "property float x\nproperty float y\nproperty float z\nproperty ushort n\n"
        "element face 1\nproperty list uchar uchar vertex_indices\n"
        "element note 2\nproperty list uchar uchar text\nend_header\n"
    )
    before, after = b"\1\2" + b"\3abc", b"\3\0\1\2" + b"\2hi\0"
    return header.encode() + before + vertices + after


def save_las(path: Path, version: str, point_format: int) -> None:
    """Write a file with VLRs, extra bytes, EVLRs, and points of many returns and times."""
    header = laspy.LasHeader(version=version, point_format=point_format)
    header.scales, header.offsets = np.array([0.01, -0.02, 0.001]), np.array([5e5, -4e6, 0.1])
    header.add_extra_dim(laspy.ExtraBytesParams("colour of the day", "3u1"))
    header.vlrs.append(laspy.VLR("someone", 77, "a record of theirs", b"\x01\x02\x00\xff"))
    header.extra_vlr_bytes = b"before points"
    length = header.point_format.size
    raw = np.random.default_rng(2).integers(0, 256, (COUNT, length), dtype=np.uint8)
    las = laspy.LasData(header)
    array = np.frombuffer(raw.tobytes(), header.point_format.dtype()).copy()
    las.points = laspy.ScaleAwarePointRecord(
        array, header.point_format, header.scales, header.offsets
    )
    if version == "1.4":
        evlrs = [laspy.VLR("someone", number, "a long record", b"long" * 99) for number in (1, 2)]
        las.evlrs = laspy.vlrs.vlrlist.VLRList(evlrs)
    las.write(path)


def as_las_1_5(path: Path) -> None:
    """Turn a file of LAS 1.4 into one of 1.5, whose header is 18 bytes longer."""
    data = bytearray(path.read_bytes())
    for at, size in ((94, 2), (96, 4), (235, 8)):
        number = int.from_bytes(data[at : at + size], "little") + 18
        data[at : at + size] = number.to_bytes(size, "little")
    data[25] = 5
    data[375:375] = bytes(18)
    path.write_bytes(data)


@pytest.fixture(scope="module")
def readers(tmp_path_factory) -> dict[str, MapReader]:
    folder = tmp_path_factory.mktemp("maps")
    (folder / "binary.pcd").write_bytes(pcd())
    (folder / "little.ply").write_bytes(ply("little", TABLE.tobytes()))
    big = TABLE.astype([(name, TABLE.dtype[name].newbyteorder(">")) for name in TABLE.dtype.names])
    (folder / "big.ply").write_bytes(ply("big", big.tobytes()))
    (folder / "kitti.bin").write_bytes(np.hstack([XYZ, XYZ[:, :1]]).astype("<f4").tobytes())
    np.save(folder / "table.npy", TABLE)
    np.save(folder / "rows.npy", XYZ)
    np.save(folder / "columns.npy", np.asfortranarray(XYZ))
    save_las(folder / "las_1_2.las", "1.2", 3)
    save_las(folder / "las_1_4.las", "1.4", 7)
    save_las(folder / "las_1_5.las", "1.4", 6)
    as_las_1_5(folder / "las_1_5.las")
    return {path.name: open_map(path) for path in folder.iterdir()}


NAMES = [
    *("binary.pcd", "little.ply", "big.ply", "table.npy", "rows.npy", "columns.npy"),
    "kitti.bin",
    *("las_1_2.las", "las_1_4.las", "las_1_5.las"),
]


def bytes_of_plain_writer(reader: MapReader, path: Path, chosen: np.ndarray) -> bytes:
    with reader.writer(path, int(chosen.sum())) as writer:
        for batch in reader.batches(97):
            rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
            writer.write(batch.select(chosen[rows]))
    return path.read_bytes()


def write_part(
    parts: PartWriter, reader: MapReader, chosen: np.ndarray, rows: range
) -> PartSummary:
    with parts.open_part(int(chosen[: rows.start].sum())) as part:
        for batch in reader.batches(61, rows):
            here = slice(batch.first_row, batch.first_row + len(batch.xyz))
            part.write(batch.select(chosen[here]))
    return part.summary


def write_in_parts(reader: MapReader, path: Path, chosen: np.ndarray, ranges: list[range]) -> bytes:
    """Write the ranges in the order given, each with a copy as another process has it."""
    parts = reader.part_writer(path, int(chosen.sum()))
    parts.create()
    summaries = []
    for rows in ranges:
        summary = write_part(pickle.loads(pickle.dumps(parts)), reader, chosen, rows)
        summaries.append(pickle.loads(pickle.dumps(summary)))
    pickle.loads(pickle.dumps(parts)).finish(summaries)
    return path.read_bytes()


@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=12)
@given(
    cuts=st.lists(st.integers(0, COUNT), max_size=5),
    order=st.randoms(use_true_random=False),
    share=st.sampled_from([0.0, 0.1, 0.6, 1.0]),
)
def test_parts_make_the_file_of_the_plain_writer(
    readers, tmp_path_factory, name, cuts, order, share
):
    reader = readers[name]
    assert reader.writes_parts
    chosen = np.random.default_rng(len(cuts)).random(COUNT) < share
    ranges = [range(*pair) for pair in itertools.pairwise([0, *sorted(cuts), COUNT])]
    order.shuffle(ranges)
    folder = tmp_path_factory.mktemp("out")
    expected = bytes_of_plain_writer(reader, folder / f"plain{name[-4:]}", chosen)
    assert write_in_parts(reader, folder / f"parts{name[-4:]}", chosen, ranges) == expected


def test_bounds_of_gps_times_are_those_of_all_parts(readers, tmp_path):
    reader = readers["las_1_5.las"]
    (batch,) = reader.batches()
    times = np.ascontiguousarray(batch.records[:, 22:30]).view("<f8")
    times = times[np.isfinite(times)]
    everything = np.ones(COUNT, dtype=bool)
    for cuts in ([0, COUNT], [0, 100, 300, COUNT]):
        ranges = [range(*pair) for pair in itertools.pairwise(cuts)]
        data = write_in_parts(reader, tmp_path / "out.las", everything, ranges)
        assert struct.unpack_from("<2d", data, 375) == (times.max(), times.min())


def test_processes_fill_one_file(readers, tmp_path):
    reader = readers["las_1_4.las"]
    chosen = np.arange(COUNT) % 3 > 0
    expected = bytes_of_plain_writer(reader, tmp_path / "plain.las", chosen)
    parts = reader.part_writer(tmp_path / "parts.las", int(chosen.sum()))
    parts.create()
    ranges = [range(0, 180), range(180, COUNT)]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        arguments = zip(*[(parts, reader, chosen, rows) for rows in ranges], strict=True)
        parts.finish(pool.map(write_part, *arguments))
    assert parts.path.read_bytes() == expected


def test_real_files_are_written_in_parts(shared_data, tmp_path):
    folders = [shared_data / "formats", shared_data / "ground"]
    kinds = (".las", ".ply", ".pcd")
    written = 0
    for path in sorted(p for f in folders for p in f.iterdir() if p.suffix in kinds):
        try:
            reader = open_map(path)
        except Exception:
            continue
        if not reader.writes_parts:
            continue
        count = reader.description.point_count
        chosen = np.random.default_rng(1).random(count) < 0.5
        ranges = [
            range(2 * count // 3, count),
            range(count // 3),
            range(count // 3, 2 * count // 3),
        ]
        expected = bytes_of_plain_writer(reader, tmp_path / f"plain{path.suffix}", chosen)
        found = write_in_parts(reader, tmp_path / f"parts{path.suffix}", chosen, ranges)
        assert found == expected, path.name
        written += 1
    assert written > 30


def test_parts_that_are_not_all_points_once_are_refused(readers, tmp_path):
    parts = readers["binary.pcd"].part_writer(tmp_path / "out.pcd", 10)
    parts.create()
    with pytest.raises(PointCountError, match="begins with point 4, found one that begins with 5"):
        parts.finish([PartSummary(5, 5), PartSummary(0, 4)])
    with pytest.raises(PointCountError, match="begins with point 6, found one that begins with 4"):
        parts.finish([PartSummary(0, 6), PartSummary(4, 6)])
    with pytest.raises(PointCountError, match="created for 10 points, given 9"):
        parts.finish([PartSummary(0, 9)])


def test_a_part_beyond_the_end_is_refused(readers, tmp_path):
    reader = readers["las_1_4.las"]
    parts = reader.part_writer(tmp_path / "out.las", 10)
    parts.create()
    size = parts.path.stat().st_size
    (batch,) = reader.batches(6, range(6))
    with pytest.raises(PointCountError, match="found 11"):
        parts.open_part(11)
    with parts.open_part(5) as part, pytest.raises(PointCountError, match="given 11"):
        part.write(batch.records)
    assert parts.path.stat().st_size == size


def test_a_file_has_its_full_size_from_the_beginning(readers, tmp_path):
    for name in NAMES:
        chosen = np.arange(COUNT) % 2 > 0
        expected = bytes_of_plain_writer(readers[name], tmp_path / f"plain_{name}", chosen)
        parts = readers[name].part_writer(tmp_path / name, int(chosen.sum()))
        parts.create()
        assert parts.path.stat().st_size == len(expected)


def test_formats_without_places_say_so(tmp_path):
    path = tmp_path / "map.pcd"
    path.write_text("FIELDS x y z\nWIDTH 1\nHEIGHT 1\nDATA ascii\n1 2 3\n", encoding="utf-8")
    reader = open_map(path)
    assert not reader.writes_parts
    with pytest.raises(PartsError, match="records of one size, found PCD ascii"):
        reader.part_writer(tmp_path / "out.pcd", 1)
