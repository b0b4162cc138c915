"""Points as plain text: heads and separators of all kinds, rows byte for byte."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.collection import find_map_files
from tiling.errors import MapFormatError
from tiling.formats import Field, open_map

BLANKS, LABEL = " ", Field("label", "uint8")
HEADS = {
    "none": "",
    "count": "{count}\n",
    "names": "x{s}y{s}z{s}name{s}n\n",
    "quoted": '"X"{s}"Y"{s}"Z"{s}"name"{s}"n"\r\n',
    "comments": "# by hand\n// 1 2 3\n\n",
    "CloudCompare": "//X{s}Y{s}Z{s}name{s}n\n{count}\n",
    "mark": "\ufeffx{s}y{s}z{s}name{s}n\n",
}
SEPARATORS = {"blank": " ", "tab": "\t", "comma": ",", "semicolon": ";", "wide": "  ", "odd": " , "}


def rows_of(points: np.ndarray, separator: str, end: str) -> list[str]:
    return [
        f"{x!r}{separator}{y!r}{separator}{z!r}{separator}tree{separator}00{n}{end}"
        for n, (x, y, z) in enumerate(points.tolist())
    ]


@pytest.mark.parametrize("suffix", [".xyz", ".txt", ".pts", ".asc", ".csv"])
@pytest.mark.parametrize("separator", SEPARATORS)
@pytest.mark.parametrize("head", HEADS)
def test_rows_come_back_byte_for_byte(tmp_path, read_xyz, rewrite, suffix, separator, head):
    points = np.random.default_rng(len(head)).normal(size=(50, 3))
    between = SEPARATORS[separator]
    rows = rows_of(points, between, "\r\n" if suffix == ".csv" else " \n")
    rows[-1] = rows[-1].rstrip()
    path = tmp_path / f"map{suffix}"
    start = HEADS[head].format(s=between, count=50)
    path.write_bytes((start + "".join(rows)).encode())
    reader = open_map(path)
    np.testing.assert_array_equal(read_xyz(reader, 7), points)
    assert reader.description.suffix == suffix
    names = [field.name for field in reader.description.fields]
    if head in ("names", "CloudCompare", "mark", "quoted"):
        assert names == (
            ["x", "y", "z", "name", "n"]
            if head in ("names", "mark")
            else ["X", "Y", "Z", "name", "n"]
        )
    else:
        assert names == ["x", "y", "z", "column 4", "column 5"]
    for chosen in (np.arange(50) % 3 == 0, np.zeros(50, bool), np.ones(50, bool)):
        copy = rewrite(reader, tmp_path / f"copy{suffix}", chosen, 7)
        expected = HEADS[head].format(s=between, count=chosen.sum())
        expected += "".join(row for row, kept in zip(rows, chosen, strict=True) if kept)
        assert copy.read_bytes() == expected.encode()
        assert open_map(copy).description.point_count == chosen.sum()


@pytest.mark.parametrize("separator", SEPARATORS)
@pytest.mark.parametrize("head", HEADS)
def test_further_values_stand_behind_the_others(tmp_path, read_xyz, separator, head):
    points = np.random.default_rng(1).normal(size=(9, 3))
    between = SEPARATORS[separator]
    path, target = tmp_path / "map.txt", tmp_path / "longer.txt"
    start = HEADS[head].format(s=between, count=9)
    path.write_bytes((start + "".join(rows_of(points, between, "\n"))).encode())
    reader = open_map(path)
    extended = reader.extended([LABEL, Field("density", "float64")])
    density = np.array([0.1, np.nan, np.inf, 1e300, 5, 6, 7, 8, 9])
    with extended.writer(target, 9) as writer:
        for batch in reader.batches(4):
            own = slice(batch.first_row, batch.first_row + len(batch.xyz))
            writer.write(extended.extend(batch, [np.arange(9)[own], density[own]]))
    longer = open_map(target)
    np.testing.assert_array_equal(read_xyz(longer), points)
    assert len(longer.description.fields) == 7
    if "{s}" in HEADS[head]:
        assert [field.name for field in longer.description.fields][-2:] == ["label", "density"]
    lines = target.read_text().splitlines()[-9:]
    words = [re.split(r"\s*[;,\t ]\s*", line) for line in lines]
    assert [int(each[-2]) for each in words] == list(range(9))
    np.testing.assert_array_equal([float(each[-1]) for each in words], density)


def test_coordinates_are_found_by_their_names(tmp_path, read_xyz):
    path = tmp_path / "map.csv"
    path.write_text("id of point,z,y,x\na,3,2,1\nb,6,5,4\n", encoding="utf-8")
    np.testing.assert_array_equal(read_xyz(open_map(path)), [[1, 2, 3], [4, 5, 6]])


def test_empty_values_and_trailing_separators_are_values(tmp_path, read_xyz):
    path = tmp_path / "map.txt"
    path.write_text("1;2;3;;\n4;5;6;7;\n", encoding="utf-8")
    assert len(open_map(path).description.fields) == 5
    np.testing.assert_array_equal(read_xyz(open_map(path)), [[1, 2, 3], [4, 5, 6]])


def test_comments_between_the_points_are_noted(tmp_path, read_xyz):
    path = tmp_path / "map.txt"
    path.write_text("1 2 3\n# a word\n\n4 5 6\n// the end\n", encoding="utf-8")
    reader = open_map(path)
    np.testing.assert_array_equal(read_xyz(reader), [[1, 2, 3], [4, 5, 6]])
    (note,) = reader.description.notes
    assert note == "The comments between and behind the points are left out."


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"Map of the hall\nmade by hand\n", "found 'Map of the hall' at line 1"),
        (b"1 2\n3 4\n", "found '1 2' at line 1"),
        (b"1,5 2,5 3,5\n", "found '1,5 2,5 3,5'"),
        (b"id,easting,northing\n1,2,3\n", "names with x, y and z, found 'id,easting,northing'"),
        (b"x,y,z\n1,2,3,4\n", "expected 4 different names, found x, y, z"),
        (b"3\n1 2 3\n4 5 6\n", "expected 3 points, as its head says, found 2"),
        (b"1 2 3 4\n5 6 7\n", "expected 4 values in a row, found 3 at line 2"),
        (b"1 2 3\n4 5 six\n", "expected a number, found 'six' at line 2, value 3"),
        (b"1;2;3\n4;;6\n", "expected a number, found '' at line 2, value 2"),
        (b"1 2 3\n" * 9 + b"4 5 6\x00 7\n", "3 values in a row"),
        (b"\0\0\0\0\1\2", "expected points as text"),
        ("1 2 3\n".encode("utf-16"), "expected points as text"),
        (b"\n" * 3000 + b"1 2 3\n", "expected a row of three numbers"),
        (b"1 2 3\n" + b"9" * 5_000_000, "a line of over"),
    ],
)
def test_text_that_is_no_map_is_refused_in_one_line(tmp_path, read_xyz, content, message):
    path = tmp_path / "map.txt"
    path.write_bytes(content)
    with pytest.raises(MapFormatError) as raised:
        read_xyz(open_map(path))
    assert message in str(raised.value)
    assert len(str(raised.value)) < 400


@settings(max_examples=60)
@given(st.integers(0, 60), st.integers(1, 9), st.integers(10, 200), st.booleans(), st.data())
def test_blocks_and_batches_of_any_size(tmp_path_factory, count, most, block, named, data):
    points = np.random.default_rng(count).normal(size=(count, 3))
    separator = data.draw(st.sampled_from(list(SEPARATORS.values())))
    path = tmp_path_factory.mktemp("text") / "map.txt"
    head = separator.join(["x", "y", "z", "name", "n"]) + "\n" if named else ""
    path.write_text(head + "".join(rows_of(points, separator, "\n")), encoding="utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tiling.formats.text_rows.BLOCK", block)
        reader = open_map(path)
        batches = list(reader.batches(most))
    assert sum(len(batch.xyz) for batch in batches) == count
    assert b"".join(batch.records.tobytes() for batch in batches).decode() == "".join(
        rows_of(points, separator, "\n")
    )
    found = np.concatenate([np.empty((0, 3)), *(batch.xyz for batch in batches)])
    np.testing.assert_array_equal(found, points)


def test_a_file_that_changed_is_counted_anew(tmp_path):
    path = tmp_path / "map.xyz"
    for count in (3, 5):
        path.write_text("1 2 3\n" * count, encoding="utf-8")
        assert open_map(path).description.point_count == count


def test_text_beside_maps_is_none(tmp_path):
    for name in ("poses.txt", "weights.bin", "table.csv", "2.pcd", "1.xyz"):
        (tmp_path / name).touch()
    names = [path.name for path in find_map_files([tmp_path])]
    assert names == ["1.xyz", "2.pcd"]
    assert [p.name for p in find_map_files([f"{tmp_path}/*.txt"])] == ["poses.txt"]


# Bare records


@pytest.mark.parametrize(("name", "values"), [("map.bin", 4), ("MAP.PCD.BIN", 5)])
def test_bare_records(tmp_path, read_xyz, rewrite, name, values):
    table = np.random.default_rng(0).normal(size=(50, values)).astype("<f4")
    table[3] = np.nan
    path = tmp_path / name
    path.write_bytes(table.tobytes())
    reader = open_map(path)
    np.testing.assert_array_equal(read_xyz(reader, 7), table[:, :3])
    chosen = np.arange(50) % 3 == 0
    copy = rewrite(reader, tmp_path / f"copy{reader.description.suffix}", chosen, 7)
    assert copy.read_bytes() == table[chosen].tobytes()
    with pytest.raises(MapFormatError, match="names for further fields"):
        reader.extended([LABEL])


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (bytes(17), "expected records of 16 bytes.*, found 17 bytes, 1 too many"),
        (b"LASF" + bytes(300), "found a LAS or LAZ file at byte 0"),
        (b"version https://git-lfs.github.com/spec/v1\n", "found a git-LFS pointer"),
    ],
)
def test_records_that_are_none_are_refused(tmp_path, content, message):
    (tmp_path / "map.bin").write_bytes(content)
    with pytest.raises(MapFormatError, match=message):
        open_map(tmp_path / "map.bin")


@pytest.mark.parametrize("case", ["xyz", "txt", "pts", "bin", "pcd.bin"])
def test_cases_are_read(shared_data, read_xyz, case):
    xyz = read_xyz(open_map(shared_data / "cases" / f"ask_map.{case}"))
    assert xyz.shape == (6000, 3)
    np.testing.assert_allclose(xyz[1], [1.2010, 7.9919, 2.4705], atol=1e-4)
