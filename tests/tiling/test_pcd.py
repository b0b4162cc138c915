"""PCD in and out: every field bit for bit, in bounded batches; what is broken is refused."""

import os
import struct
import tracemalloc
from itertools import accumulate, pairwise

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from tiling.errors import MapFormatError, PointCountError
from tiling.formats import open_map
from tiling.formats.pcd.reader import PcdReader

HEADER = """# .PCD v0.7 - a comment
VERSION 0.7
FIELDS x y z _ rgb _
SIZE 4 4 4 1 4 2
TYPE F F F U F I
COUNT 1 1 1 3 1 2
WIDTH {0}
HEIGHT 1
VIEWPOINT 0 0 0.10 1 0 0 0
POINTS {0}
DATA {1}
"""
WIDTHS = (4, 4, 4, 3, 4, 4)
ENCODINGS = ("ascii", "binary", "binary_compressed")
CODES = {"I": "bhiq", "U": "BHIQ", "F": "..fd"}


def literal_lzf(data):
    parts = (data[start : start + 32] for start in range(0, len(data), 32))
    return b"".join(bytes([len(part) - 1]) + part for part in parts)


def columns(records, widths):
    starts = list(accumulate(widths, initial=0))
    return b"".join(record[a:b] for a, b in pairwise(starts) for record in records)


def body(records, encoding, codes, widths):
    """Encode records, given as bytes, without the code under test."""
    if encoding == "ascii":
        rows = (struct.unpack("<" + codes, record) for record in records)
        return b"".join(" ".join(map(repr, row)).encode() + b"\n" for row in rows)
    if encoding == "binary":
        return b"".join(records)
    packed = literal_lzf(columns(records, widths))
    return struct.pack("<II", len(packed), sum(widths) * len(records)) + packed


def example(count, encoding):
    rows = [(i, -i / 3, i * 1e6, 1, 2, 3, 1e-40, -7, i) for i in range(count)]
    records = [struct.pack("<fffBBBfhh", *row) for row in rows]
    return HEADER.format(count, encoding).encode() + body(records, encoding, "fffBBBfhh", WIDTHS)


def example_file(folder, count=5, encoding="binary", old=b"", new=b""):
    content = example(count, encoding)
    assert old in content
    path = folder / "map.pcd"
    path.write_bytes(content.replace(old, new, 1))
    return path


def read_all(path, max_points=1000):
    """Read a map; return its coordinates."""
    reader = PcdReader(path)
    parts = [np.empty((0, 3))]
    for batch in reader.batches(max_points):
        assert batch.first_row == sum(map(len, parts))
        assert 0 < len(batch.xyz) == len(batch.records) <= max_points
        parts.append(batch.xyz)
    xyz = np.concatenate(parts)
    assert len(xyz) == reader.description.point_count
    return xyz


def copy_chosen(reader, path, chosen, max_points):
    with reader.writer(path, int(chosen.sum())) as writer:
        for batch in reader.batches(max_points):
            mask = chosen[batch.first_row : batch.first_row + len(batch.xyz)]
            writer.write(batch.select(mask))


@st.composite
def clouds(draw):
    kinds = st.one_of(
        st.tuples(st.sampled_from("IU"), st.sampled_from([1, 2, 4, 8])),
        st.tuples(st.just("F"), st.sampled_from([4, 8])),
    )
    names = st.sampled_from(["_", "rgb", "intensity", "x1"])
    others = draw(st.lists(st.tuples(names, kinds, st.integers(1, 5)), max_size=4))
    axes = [(axis, draw(kinds), 1) for axis in "xyz"]
    fields = draw(st.permutations(others + axes))
    size = sum(kind[1] * count for _, kind, count in fields)
    records = draw(st.lists(st.binary(min_size=size, max_size=size), max_size=12))
    chosen = draw(st.lists(st.booleans(), min_size=len(records), max_size=len(records)))
    return fields, records, np.array(chosen, dtype=bool)


def cloud_header(fields, count, encoding):
    rows = [("FIELDS", [name for name, _, _ in fields])]
    rows.append(("SIZE", [kind[1] for _, kind, _ in fields]))
    rows.append(("TYPE", [kind[0] for _, kind, _ in fields]))
    rows.append(("COUNT", [count for _, _, count in fields]))
    rows += [("WIDTH", [count]), ("HEIGHT", [1]), ("POINTS", [count]), ("DATA", [encoding])]
    return "".join(f"{name} {' '.join(map(str, values))}\n" for name, values in rows).encode()


@pytest.mark.parametrize("encoding", ENCODINGS)
@given(cloud=clouds(), max_points=st.integers(1, 13))
@settings(
    deadline=None,
    max_examples=60,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
def test_every_field_of_every_chosen_point_survives(tmp_path, encoding, cloud, max_points):
    fields, records, chosen = cloud
    codes = "".join(CODES[kind][size.bit_length() - 1] * count for _, (kind, size), count in fields)
    widths = [kind[1] * count for _, kind, count in fields]
    source, target, again = (tmp_path / name for name in ("in.pcd", "out.pcd", "again.pcd"))
    source.write_bytes(
        cloud_header(fields, len(records), encoding) + body(records, encoding, codes, widths)
    )
    copy_chosen(PcdReader(source), target, chosen, max_points)

    kept = [record for record, keep in zip(records, chosen, strict=True) if keep]
    header = cloud_header(fields, len(kept), encoding)
    written = target.read_bytes()
    assert written.startswith(header)
    if encoding != "binary_compressed":
        assert written == header + body(kept, encoding, codes, widths)
    else:
        got = [batch.records.tobytes() for batch in PcdReader(target).batches(max_points)]
        assert b"".join(got) == b"".join(kept)

    places = [[name for name, _, count in fields for _ in range(count)].index(a) for a in "xyz"]
    rows = [struct.unpack("<" + codes, record) for record in kept]
    expected = np.array([[float(row[p]) for p in places] for row in rows]).reshape(-1, 3)
    np.testing.assert_array_equal(read_all(target, max_points), expected)
    copy_chosen(PcdReader(target), again, np.ones(len(kept), dtype=bool), 5)
    assert again.read_bytes() == written


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_description(tmp_path, encoding):
    description = open_map(example_file(tmp_path, 7, encoding)).description
    assert description.format == f"PCD {encoding}"
    assert (description.suffix, description.point_count, description.notes) == (".pcd", 7, ())
    fields = [(field.name, field.dtype, field.count) for field in description.fields]
    assert fields[2:] == [
        ("z", "float32", 1),
        ("_", "uint8", 3),
        ("rgb", "float32", 1),
        ("_", "int16", 2),
    ]


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_organised_cloud_becomes_unorganised(tmp_path, encoding):
    path = example_file(tmp_path, 6, encoding, b"WIDTH 6\nHEIGHT 1\n", b"WIDTH 2\nHEIGHT  3 \n")
    reader = PcdReader(path)
    assert "2 x 3" in reader.description.notes[0]
    copy_chosen(reader, tmp_path / "out.pcd", np.arange(6) != 2, 4)
    written = (tmp_path / "out.pcd").read_bytes()
    assert b"WIDTH 5\nHEIGHT  1 \nVIEWPOINT 0 0 0.10 1 0 0 0\nPOINTS 5\n" in written
    assert read_all(tmp_path / "out.pcd")[:, 0].tolist() == [0, 1, 3, 4, 5]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        (b"POINTS 5\n", b""),
        (b"WIDTH 5\nHEIGHT 1\n", b""),
        (b"WIDTH 5\nHEIGHT 1\n", b"WIDTH 0\nHEIGHT 0\n"),
        (b"HEIGHT 1\n", b""),
        (b"HEIGHT 1\n", b"HEIGHT 0\n"),
        (b"VIEWPOINT 0 0 0.10 1 0 0 0\n", b""),
        (b"VERSION 0.7\n", b"VERSION .5\n\n# more\n"),
        (b"FIELDS x y z", b"COLUMNS x y z"),
        (b"FIELDS x y z", b"  FIELDS\tX  Y Z"),
        (b"\nTYPE F F F U", b"\r\nTYPE f f f u"),
    ],
)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_headers_that_peers_read(tmp_path, old, new, encoding):
    path = example_file(tmp_path, 5, encoding, old, new)
    assert read_all(path, 2)[:, 0].tolist() == [0, 1, 2, 3, 4]
    copy_chosen(PcdReader(path), tmp_path / "out.pcd", np.arange(5) > 2, 2)
    assert read_all(tmp_path / "out.pcd", 2)[:, 0].tolist() == [3, 4]


@pytest.mark.parametrize("old", ["SIZE 4 4 4\n", "TYPE F F F\n", "COUNT 1 1 1\n"])
def test_float32_is_what_old_headers_leave_unsaid(tmp_path, old):
    header = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 1\nDATA binary\n"
    path = tmp_path / "map.pcd"
    path.write_bytes(header.replace(old, "").encode() + struct.pack("<3f", 1, 2, 3))
    assert read_all(path).tolist() == [[1, 2, 3]]


@pytest.mark.parametrize("encoding", ["binary", "binary_compressed"])
def test_bytes_after_the_data_are_passed_over(tmp_path, encoding):
    path = example_file(tmp_path, 5, encoding)
    path.write_bytes(path.read_bytes() + bytes(4000))
    assert read_all(path)[:, 0].tolist() == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("padded", [True, False])
def test_compressed_data_with_padding_or_without(tmp_path, padded):
    record = struct.pack("<fBBBff", 1, 7, 8, 9, 2, 3)
    stored = record if padded else record[:4] + record[7:]
    packed = literal_lzf(stored)
    sizes = struct.pack("<II", len(packed), len(stored))
    fields = [("x", "F4", 1), ("_", "U1", 3), ("y", "F4", 1), ("z", "F4", 1)]
    fields = [(name, (kind[0], int(kind[1])), count) for name, kind, count in fields]
    path = tmp_path / "map.pcd"
    path.write_bytes(cloud_header(fields, 1, "binary_compressed") + sizes + packed)
    assert read_all(path).tolist() == [[1, 2, 3]]
    copy_chosen(PcdReader(path), tmp_path / "out.pcd", np.ones(1, dtype=bool), 1)
    assert read_all(tmp_path / "out.pcd").tolist() == [[1, 2, 3]]
    (batch,) = PcdReader(tmp_path / "out.pcd").batches()
    assert batch.records.tobytes() == stored


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_an_empty_cloud(tmp_path, encoding):
    path = example_file(tmp_path, 0, encoding)
    assert list(PcdReader(path).batches()) == []
    copy_chosen(PcdReader(path), tmp_path / "out.pcd", np.zeros(0, dtype=bool), 5)
    assert read_all(tmp_path / "out.pcd").shape == (0, 3)


def test_a_last_row_without_a_line_ending_may_be_followed_by_others(tmp_path):
    path = example_file(tmp_path, 3, "ascii")
    path.write_bytes(path.read_bytes().rstrip())
    reader = PcdReader(path)
    batches = list(reader.batches(1))
    with reader.writer(tmp_path / "out.pcd", 3) as writer:
        for batch in reversed(batches):
            writer.write(batch.records)
    assert read_all(tmp_path / "out.pcd")[:, 0].tolist() == [2, 1, 0]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (b"POINTS 5", b"POINTS 6", "POINTS 5 = WIDTH x HEIGHT, found 6 at line 10"),
        (b"POINTS 5", b"POINTS -5", "a whole number after POINTS, found '-5' at line 10"),
        (b"POINTS 5", b"POINTS five", "a whole number after POINTS, found 'five'"),
        (b"POINTS 5", b"POINTS", "values after POINTS, found none at line 10"),
        (b"WIDTH 5", b"WIDTH 5 6", "one value of WIDTH, found 2 at line 7"),
        (b"WIDTH 5", b"WIDTH " + b"9" * 5000, "a whole number after WIDTH, found '9+"),
        (b"WIDTH 5\nHEIGHT 1", b"HEIGHT 1", "POINTS 0 = WIDTH x HEIGHT, found 5"),
        (b"FIELDS x y z", b"FIELDS x y w", "x, y and z among FIELDS, found x y w"),
        (b"FIELDS x y z _ rgb _\n", b"", "a FIELDS line before DATA, found none"),
        (b"SIZE 4 4 4 1", b"SIZE 4 4 4", "6 values of SIZE, .* found 5 at line 4"),
        (b"SIZE 4 4 4 1", b"SIZE 4 4 4 3", "TYPE I or U of SIZE .* found U of 3"),
        (b"TYPE F F F U", b"TYPE F F Q U", "TYPE I or U .* found Q of 4 at line 5"),
        (b"COUNT 1 1 1 3", b"COUNT 1 1 1 0", "a COUNT of 1 or more, found 0 at line 6"),
        (b"COUNT 1 1 1 3", b"COUNT 1 1 2 3", "a COUNT of 1 for z, found 2"),
        (b"COUNT 1 1 1 3", b"COUNT 1 1 1 99999999999", "points of at most 16777216 bytes"),
        (b"VIEWPOINT 0 0 0.10 1 0 0 0", b"VIEWPOINT 0 0", "7 numbers in VIEWPOINT"),
        (b"VIEWPOINT 0 0 0.10 1 0 0 0", b"VIEWPOINT a 0 0 1 0 0 0", "7 numbers in VIEWPOINT"),
        (b"VERSION 0.7", b"POINTS 5", "one POINTS line, found a second one at line 10"),
        (b"VERSION 0.7", b"VERSIONS 0.7", "a keyword of a PCD header, found 'VERSIONS' at line 2"),
        (b"DATA ", b"DATA z", "DATA ascii, binary or binary_compressed, found 'z"),
        (b"DATA ", b"#", "expected .* PCD header"),
    ],
)
@pytest.mark.parametrize("encoding", ENCODINGS)
def test_broken_headers_are_refused(tmp_path, old, new, message, encoding):
    with pytest.raises(MapFormatError, match=message) as caught:
        PcdReader(example_file(tmp_path, 5, encoding, old, new))
    assert str(caught.value).startswith(str(tmp_path / "map.pcd"))
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "found an empty file"),
        (bytes(range(256)) * 20, "a keyword of a PCD header"),
        (bytes(5000), "a keyword of a PCD header"),
        (b"#" * (2 << 20), "a DATA line, found none in the first"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:0\n", "a Git LFS pointer"),
        (b"VERSION 0.7\n", "found the end of the file at line 2"),
    ],
)
def test_what_is_no_pcd_at_all_is_refused(tmp_path, content, message):
    path = tmp_path / "map.pcd"
    path.write_bytes(content)
    with pytest.raises(MapFormatError, match=message):
        PcdReader(path)


@pytest.mark.parametrize("encoding", ENCODINGS)
@pytest.mark.parametrize("count", [6, 10**9, 2**32, 10**17])
def test_a_count_that_the_file_cannot_hold_is_not_believed(tmp_path, encoding, count):
    path = example_file(tmp_path, 5, encoding)
    text = b"%d" % count
    content = path.read_bytes().replace(b"WIDTH 5", b"WIDTH " + text)
    path.write_bytes(content.replace(b"POINTS 5", b"POINTS " + text))
    with pytest.raises(MapFormatError, match="expected"):
        read_all(path)


@pytest.mark.parametrize(
    ("sizes", "message"),
    [
        ((0, 115), "compressed data for 115 bytes, found only 0"),
        ((10**6, 115), "1000000 compressed bytes"),
        ((2**32 - 1, 2**32 - 1), "compressed bytes"),
        ((119, 116), "115 uncompressed bytes, found 116"),
        ((118, 115), "cut short"),
    ],
)
def test_compressed_sizes_that_lie_are_refused(tmp_path, sizes, message):
    path = example_file(tmp_path, 5, "binary_compressed")
    content = bytearray(path.read_bytes())
    start = content.index(b"DATA binary_compressed\n") + len(b"DATA binary_compressed\n")
    assert struct.unpack_from("<II", content, start) == (119, 115)
    struct.pack_into("<II", content, start, *sizes)
    path.write_bytes(content)
    with pytest.raises(MapFormatError, match=message):
        read_all(path)


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_every_truncation_is_refused_or_read_in_full(tmp_path, encoding):
    content = example(5, encoding)
    path = tmp_path / "map.pcd"
    read_in_full = []
    for size in range(len(content)):
        path.write_bytes(content[:size])
        try:
            read_in_full.append(len(read_all(path)))
        except MapFormatError as error:
            assert str(error).startswith(f"{path}: expected ")
    # Only an ascii file can end in the midst of its last number and remain a good one.
    assert read_in_full == ([5] if encoding == "ascii" else [])


def descriptors():
    return len(os.listdir("/proc/self/fd"))  # noqa: PTH208 - the names themselves vanish


def full_disk():
    return os.fdopen(os.open("/dev/full", os.O_RDWR), "r+b", 0)


def test_a_full_folder_for_temporary_files_is_named(tmp_path, monkeypatch):
    path = example_file(tmp_path, 50, "binary_compressed")
    records = next(PcdReader(path).batches(50)).records
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "spool"))
    monkeypatch.setattr("tiling.formats.pcd.compressed.TemporaryFile", lambda **_: full_disk())
    with pytest.raises(OSError, match=r"No space left on device: '.*spool \(temporary files\)'"):
        read_all(path)
    with (
        pytest.raises(OSError, match=r"No space left on device: '.*spool \(temporary files\)'"),
        PcdReader(path).writer(tmp_path / "out.pcd", 50) as writer,
    ):
        writer.write(records)


@pytest.mark.linux_only
def test_temporary_files_go_whatever_happens(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "spool"))
    (tmp_path / "spool").mkdir()
    path = example_file(tmp_path, 50, "binary_compressed")
    reader = PcdReader(path)
    before = descriptors()

    batches = reader.batches(10)
    next(batches)
    assert descriptors() == before + 2
    batches.close()
    assert descriptors() == before

    with pytest.raises(PointCountError), reader.writer(tmp_path / "out.pcd", 3) as writer:
        writer.write(next(reader.batches(2)).records)
    assert descriptors() == before

    content = bytearray(path.read_bytes())
    content[content.index(b"compressed\n") + len(b"compressed\n") + 8] = 0xFF
    path.write_bytes(content)
    with pytest.raises(MapFormatError, match="a copy of bytes before the first"):
        read_all(path)
    assert descriptors() == before
    assert list((tmp_path / "spool").iterdir()) == []


@pytest.mark.parametrize("encoding", ENCODINGS)
def test_memory_does_not_grow_with_the_file(tmp_path, encoding):
    count = 1_000_000
    text = b"1.25 2.5 -3.75 4.125 5\n"
    data = np.tile(np.arange(5, dtype="<f4"), count).tobytes()
    if encoding == "ascii":
        data = text * count
    if encoding == "binary_compressed":
        data = struct.pack("<II", len(data) // 32 * 33, len(data)) + literal_lzf(data)
    path = tmp_path / "map.pcd"
    fields = [(name, ("F", 4), 1) for name in ("x", "y", "z", "intensity", "t")]
    path.write_bytes(cloud_header(fields, count, encoding) + data)
    size = len(data)
    del data
    reader = PcdReader(path)
    next(reader.batches(1))
    chosen = np.ones(count, dtype=bool)
    tracemalloc.start()
    copy_chosen(reader, tmp_path / "out.pcd", chosen, 10_000)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert size >= 20_000_000
    # A block of text takes 2 MiB, and as much again where it is joined, parsed and written.
    assert peak < (12_000_000 if encoding == "ascii" else 8_000_000)
