import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tiling.errors import MapFormatError, PointCountError
from tiling.formats import open_map

TYPES = {
    "i1": ("char", "int8"),
    "u1": ("uchar", "uint8"),
    "i2": ("short", "int16"),
    "u2": ("ushort", "uint16"),
    "i4": ("int", "int32"),
    "u4": ("uint", "uint32"),
    "f4": ("float", "float32"),
    "f8": ("double", "float64"),
}
FORMATS = {"<": "binary_little_endian", ">": "binary_big_endian"}
BINARY_ROWS = b"".join(
    struct.pack(f"<fB{n}idd", n, n, *range(n), n + 0.5, -n) for n in (2, 0, 5, 1)
)
BINARY_WITH_LISTS = (
    b"ply\nformat binary_little_endian 1.0\nelement camera 2\nproperty list uchar short view\n"
    b"element vertex 4\nproperty float x\nproperty list uchar int seen\nproperty double y\n"
    b"property double z\nelement face 1\nproperty list uchar int vertex_indices\n"
    b"element sensor 1\nproperty ushort id\nend_header\n"
    + struct.pack("<B2hB", 2, 7, 8, 0)
    + BINARY_ROWS
    + struct.pack("<B3iH", 3, 0, 1, 2, 513)
)
TEXT_WITH_ALL = (
    b"ply\ncomment first\nformat ascii 1.0\nobj_info made by hand\nelement sensor 1\n"
    b"property int id\nelement vertex 3 \nproperty float x\nproperty double y\ncomment inner\n"
    b"property int z\nproperty list uchar int seen\nelement edge 1\nproperty int vertex1\n"
    b"property int vertex2\ncomment between\nelement note 2\nproperty list int float values\n"
    b"end_header\n42\n0.1 0.1000 7 0\n\n 1e0\t+2.50  -3 2 8 9 \n nan inf 0 1 5\n0 1\n0\n2 1.0 2\n"
)


def ply_of(points: np.ndarray, order: str, spelling: int) -> bytes:
    lines = [f"ply\nformat {FORMATS[order]} 1.0\nelement vertex {len(points)}"]
    for name in points.dtype.names:
        lines.append(f"property {TYPES[points.dtype[name].str[1:]][spelling]} {name}")
    return ("\n".join(lines) + "\nend_header\n").encode() + points.tobytes()


@st.composite
def binary_points(draw):
    order = draw(st.sampled_from("<>"))
    names = draw(st.permutations(["x", "y", "z", "intensity", "ring"]))
    dtype = np.dtype([(name, order + draw(st.sampled_from(list(TYPES)))) for name in names])
    count = draw(st.integers(0, 30))
    raw = draw(hnp.arrays(np.uint8, count * dtype.itemsize))
    return order, np.frombuffer(raw.tobytes(), dtype)


@settings(max_examples=60, deadline=None)
@given(binary_points(), st.integers(0, 1), st.integers(1, 40), st.data())
def test_binary_keeps_every_bit(tmp_path_factory, rewrite, read_xyz, cloud, spelling, most, data):
    order, points = cloud
    folder = tmp_path_factory.mktemp("ply")
    path = folder / "map.ply"
    path.write_bytes(ply_of(points, order, spelling))
    reader = open_map(path)
    with np.errstate(all="ignore"):
        expected = np.stack([points[name].astype(float) for name in "xyz"], axis=1)
    np.testing.assert_array_equal(read_xyz(reader, most), expected.reshape(-1, 3))
    chosen = data.draw(hnp.arrays(bool, len(points)))
    copy = rewrite(reader, folder / "copy.ply", chosen, most)
    assert copy.read_bytes() == ply_of(points[chosen], order, spelling)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(*[st.floats(width=32) | st.integers(-9, 9)] * 3), max_size=20),
    st.sampled_from(["\n", "\r\n", "\r"]),
    st.integers(1, 9),
    st.data(),
)
def test_text_keeps_every_digit(tmp_path_factory, rewrite, read_xyz, rows, line_end, most, data):
    folder = tmp_path_factory.mktemp("ply")
    blanks = st.sampled_from([" ", "  ", "\t", " \t "])
    texts = ["".join(f"{data.draw(blanks)}{number}" for number in row) for row in rows]

    def text(rows):
        head = f"ply|format ascii 1.0|element vertex {len(rows)}|property float x"
        head += "|property float y|property double z|end_header|"
        return (head + "".join(f"{row}|" for row in rows)).replace("|", line_end).encode()

    path = folder / "map.ply"
    path.write_bytes(text(texts))
    reader = open_map(path)
    expected = np.array(rows, dtype=float).reshape(-1, 3)
    np.testing.assert_array_equal(read_xyz(reader, most), expected)
    chosen = data.draw(hnp.arrays(bool, len(rows)))
    copy = rewrite(reader, folder / "copy.ply", chosen, most)
    kept = [row for row, keep in zip(texts, chosen, strict=True) if keep]
    assert copy.read_bytes() == text(kept)


@pytest.mark.parametrize("most", [1, 2, 100])
def test_text_with_lists_and_other_elements(tmp_path, rewrite, read_xyz, most):
    path = tmp_path / "map.ply"
    path.write_bytes(TEXT_WITH_ALL)
    reader = open_map(path)
    xyz = read_xyz(reader, most)
    # The type the header declares says what number the text stands for.
    expected = [[np.float64(np.float32(0.1)), 0.1, 7], [1, 2.5, -3], [np.nan, np.inf, 0]]
    np.testing.assert_array_equal(xyz, expected)
    (note,) = reader.description.notes
    assert "1 records of element 'edge'" in note
    copy = rewrite(reader, tmp_path / "copy.ply", np.array([True, False, True]), most)
    assert copy.read_bytes() == (
        b"ply\ncomment first\nformat ascii 1.0\nobj_info made by hand\nelement sensor 1\n"
        b"property int id\nelement vertex 2 \nproperty float x\nproperty double y\ncomment inner\n"
        b"property int z\nproperty list uchar int seen\n"
        b"comment between\nelement note 2\nproperty list int float values\n"
        b"end_header\n42\n0.1 0.1000 7 0\n nan inf 0 1 5\n0\n2 1.0 2\n"
    )


@pytest.mark.parametrize("most", [1, 3, 100])
def test_binary_with_lists_and_other_elements(tmp_path, rewrite, read_xyz, most):
    path = tmp_path / "map.ply"
    path.write_bytes(BINARY_WITH_LISTS)
    reader = open_map(path)
    xyz = read_xyz(reader, most)
    np.testing.assert_array_equal(xyz, [[n, n + 0.5, -n] for n in (2, 0, 5, 1)])
    copy = rewrite(reader, tmp_path / "copy.ply", np.array([True, False, True, False]), most)
    header, _, body = copy.read_bytes().partition(b"end_header\n")
    assert b"element vertex 2\n" in header
    assert b"face" not in header
    assert b"vertex_indices" not in header
    rows = b"".join(struct.pack(f"<fB{n}idd", n, n, *range(n), n + 0.5, -n) for n in (2, 5))
    assert body == struct.pack("<B2hB", 2, 7, 8, 0) + rows + struct.pack("<H", 513)


def test_long_lists_cross_the_blocks_of_reading(tmp_path, rewrite, read_xyz):
    lengths = [300_000, 0, 3, 700_000, 1]
    header = (
        b"ply\nformat binary_big_endian 1.0\nelement vertex 5\nproperty list int int seen\n"
        b"property double x\nproperty double y\nproperty double z\nend_header\n"
    )
    body = b"".join(
        struct.pack(">i", n) + bytes(4 * n) + struct.pack(">3d", n, 1, 2) for n in lengths
    )
    path = tmp_path / "map.ply"
    path.write_bytes(header + body)
    reader = open_map(path)
    np.testing.assert_array_equal(read_xyz(reader, 2)[:, 0], lengths)
    copy = rewrite(reader, tmp_path / "copy.ply", np.ones(5, bool), 2)
    assert copy.read_bytes() == path.read_bytes()


def test_an_element_without_records_is_kept(tmp_path, rewrite):
    content = (
        b"ply\nformat ascii 1.0\nelement vertex 0\nproperty float x\nproperty float y\n"
        b"property float z\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n"
    )
    path = tmp_path / "map.ply"
    path.write_bytes(content)
    reader = open_map(path)
    assert reader.description.notes == ()
    copy = rewrite(reader, tmp_path / "copy.ply", np.zeros(0, bool), 5)
    assert copy.read_bytes() == content


def text_map(rows: str, count: int = 2, extra: str = "") -> bytes:
    head = f"ply\nformat ascii 1.0\nelement vertex {count}\nproperty float x\nproperty float y\n"
    return (head + f"property float z\n{extra}end_header\n{rows}").encode()


@pytest.mark.parametrize(
    ("content", "expected", "found", "place"),
    [
        (b"", "a PLY file", "an empty file", "byte 0"),
        (b"version https://git-lfs.github.com/spec/v1\n", "a PLY file", "git-LFS", "byte 0"),
        (b"LASF" + bytes(300), "a PLY file", "LAS", "byte 0"),
        (b"ply\nformat ascii 1.0\nelement vertex 3\n", "end_header", "none", "line 4"),
        (b"ply\nformat ascii 2.0\n", "version 1.0", "'ascii 2.0'", "line 2"),
        (b"ply\nelement vertex 3\n", "the format", "none", "line 2"),
        (b"ply\nformat ascii 1.0\nelement vertex -3\n", "count", "-3", "line 3"),
        (b"ply\nformat ascii 1.0\nelement vertex 1\nproperty real x\n", "type", "'real'", "line 4"),
        (b"ply\nformat ascii 1.0\nend_header\n", "'vertex'", "none", "line 3"),
        (b"ply\nformat ascii 1.0\nvertices 3\n", "keyword", "'vertices'", "line 3"),
        (text_map("1 2 3\n4 5 6\n", extra="property int x\n"), "once", "second 'x'", "line 7"),
        (text_map("1 2 3\n4 5 \n"), "3 values", "2", "line 9"),
        (text_map("1 2 3\n\n4 5 6 7\n"), "3 values", "4", "line 10"),
        (text_map("1 2 3\n4 five 6\n"), "a number", "'five'", "line 9"),
        (text_map("1 2 3\n4 1_0 6\n"), "a number", "'1_0'", "line 9"),
        (text_map("1.25 2.25 3.25\n"), "all 2 records", "the end of the file", "line 9"),
        (text_map("1 2 3\n", count=10**17), "at least", "6 bytes", "byte 117"),
        (BINARY_WITH_LISTS[:-1], "records of 'sensor'", "a file of", "byte"),
        (BINARY_WITH_LISTS[:-20], "at least", "a file of", "byte"),
    ],
)
def test_broken_files_are_refused(tmp_path, read_xyz, content, expected, found, place):
    path = tmp_path / "map.ply"
    path.write_bytes(content)
    with pytest.raises(MapFormatError) as raised:
        read_xyz(open_map(path))
    assert expected in raised.value.expected
    assert found in raised.value.found
    assert place in raised.value.at
    assert str(path) in str(raised.value)


def test_a_list_longer_than_the_file_is_refused(tmp_path, read_xyz):
    header, separator, body = BINARY_WITH_LISTS.partition(b"end_header\n")
    header = header.replace(b"list uchar int seen", b"list uint int seen ")
    path = tmp_path / "map.ply"
    path.write_bytes(header + separator + body + bytes(12))
    with pytest.raises(MapFormatError, match="found a file of"):
        read_xyz(open_map(path))


def test_a_list_of_negative_length_is_refused(tmp_path, read_xyz):
    path = tmp_path / "map.ply"
    path.write_bytes(
        BINARY_WITH_LISTS.replace(b"list uchar short", b"list char short").replace(
            b"end_header\n\x02", b"end_header\n\xfe"
        )
    )
    with pytest.raises(MapFormatError, match="the length of a list, found -2"):
        read_xyz(open_map(path))


def test_a_writer_counts_its_points(tmp_path):
    path = tmp_path / "map.ply"
    path.write_bytes(text_map("1 2 3\n4 5 6\n"))
    reader = open_map(path)
    (batch,) = reader.batches()
    with pytest.raises(PointCountError), reader.writer(tmp_path / "copy.ply", 1) as writer:
        writer.write(batch.records)
    with pytest.raises(PointCountError), reader.writer(tmp_path / "copy.ply", 3) as writer:
        writer.write(batch.records)


@pytest.mark.parametrize("content", [TEXT_WITH_ALL, BINARY_WITH_LISTS])
def test_damaged_files_are_read_or_refused(tmp_path, survives, content):
    read, refused = survives(content, tmp_path / "map.ply", 300)
    assert read > 5
    assert refused > 150


REAL_FILES = {
    "loaders-gl__cube_att.ply": 24,
    "pdal-test__issue_2421.ply": 1,
    "pdal-test__simple_binary.ply": 3,
    "pdal-test__simple_text.ply": 3,
    "pdal-test__text_extradim.ply": 1,
}


@pytest.mark.parametrize("name", REAL_FILES)
def test_real_files(shared_data: Path, tmp_path, rewrite, read_xyz, survives, name):
    path = shared_data / "formats" / name
    reader = open_map(path)
    assert len(read_xyz(reader)) == REAL_FILES[name]
    everything = np.ones(REAL_FILES[name], bool)
    copy = rewrite(reader, tmp_path / "copy.ply", everything, 2)
    np.testing.assert_array_equal(read_xyz(open_map(copy)), read_xyz(reader))
    if not reader.description.notes:
        assert copy.read_bytes().split() == path.read_bytes().split()
    survives(path.read_bytes(), tmp_path / "map.ply", 50)


def test_the_cube_is_read_as_its_text_says(shared_data: Path, read_xyz):
    path = shared_data / "formats" / "loaders-gl__cube_att.ply"
    rows = path.read_text().split("end_header\n")[1].splitlines()[:24]
    expected = [[float(word) for word in row.split()[:3]] for row in rows]
    np.testing.assert_array_equal(read_xyz(open_map(path)), expected)


def test_a_real_file_without_z_is_refused(shared_data: Path):
    with pytest.raises(MapFormatError, match="expected vertex properties x, y and z, found x, y"):
        open_map(shared_data / "formats" / "pdal-test__sized_dims.ply")
