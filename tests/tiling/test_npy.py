import io
import warnings
import zipfile

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from tiling.errors import MapFormatError
from tiling.formats import open_map

NUMBERS = ["i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", "f2", "f4", "f8", "f16"]


def npy(array: np.ndarray, version=None) -> bytes:
    content = io.BytesIO()
    np.lib.format.write_array(content, array, version=version)
    return content.getvalue()


def raw(array: np.ndarray) -> bytes:
    """The bits of an array, which comparing values would not see in NaN or padding."""
    return np.asarray(array).tobytes("A")


@st.composite
def tables(draw):
    dtype = np.dtype(draw(st.sampled_from("<>")) + draw(st.sampled_from(NUMBERS)))
    shape = (draw(st.integers(0, 25)), draw(st.integers(3, 6)))
    content = draw(st.binary(min_size=0, max_size=64)) or b"\xff"
    size = shape[0] * shape[1] * dtype.itemsize
    table = np.frombuffer((content * (size // len(content) + 1))[:size], dtype).reshape(shape)
    return np.asfortranarray(table) if draw(st.booleans()) else table


def coordinates_of(table: np.ndarray) -> np.ndarray:
    with np.errstate(all="ignore"):
        return table[:, :3].astype(np.float64)


@settings(max_examples=80, deadline=None)
@given(tables(), st.integers(1, 30), st.sampled_from([(1, 0), (2, 0), (3, 0)]), st.data())
def test_tables_keep_every_bit(tmp_path_factory, rewrite, read_xyz, table, most, version, data):
    folder = tmp_path_factory.mktemp("npy")
    path = folder / "map.npy"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # NumPy advises against versions newer than need be
        path.write_bytes(npy(table, version))
    reader = open_map(path)
    np.testing.assert_array_equal(read_xyz(reader, most), coordinates_of(table))
    chosen = data.draw(hnp.arrays(bool, len(table)))
    copy = rewrite(reader, folder / "copy.npy", chosen, most)
    assert copy.read_bytes()[6] == version[0]
    kept = np.load(copy)
    assert kept.dtype == table.dtype
    assert kept.flags.f_contiguous >= table.flags.f_contiguous
    order = "F" if table.flags.f_contiguous else "C"
    expected = table[chosen].tobytes(order)
    assert copy.read_bytes()[-len(expected) or len(copy.read_bytes()) :] == expected
    assert kept.shape == (chosen.sum(), table.shape[1])


@pytest.mark.parametrize("most", [1, 7, 100])
def test_structured_arrays_keep_nested_fields_and_padding(tmp_path, rewrite, read_xyz, most):
    dtype = np.dtype(
        [
            ("stamp", "<M8[ns]"),
            ("z", ">f4"),
            ("y", "<i8"),
            ("label", "U3"),
            ("x", "<f8"),
            ("return", [("number", "u1"), ("echo", "<f2", (2, 2))]),
        ],
        align=True,
    )
    points = np.frombuffer(np.random.default_rng(1).bytes(40 * dtype.itemsize), dtype)
    path = tmp_path / "map.npy"
    path.write_bytes(npy(points))
    reader = open_map(path)
    expected = np.stack([points[name].astype(float) for name in "xyz"], axis=1)
    np.testing.assert_array_equal(read_xyz(reader, most), expected)
    assert [field.name for field in reader.description.fields] == list(dtype.names)
    chosen = np.arange(40) % 3 > 0
    copy = np.load(rewrite(reader, tmp_path / "copy.npy", chosen, most))
    assert copy.dtype == dtype
    rows = points.view(f"V{dtype.itemsize}")
    assert raw(copy) == raw(rows[chosen])


def test_a_header_by_python_2_is_read(tmp_path, read_xyz):
    content = npy(np.arange(12.0).reshape(4, 3)).replace(b"(4, 3), }  ", b"(4L, 3L), }")
    (tmp_path / "map.npy").write_bytes(content)
    assert read_xyz(open_map(tmp_path / "map.npy")).shape == (4, 3)


def test_bytes_after_the_array_are_noted(tmp_path, read_xyz):
    (tmp_path / "map.npy").write_bytes(npy(np.ones((4, 3))) + b"more")
    reader = open_map(tmp_path / "map.npy")
    assert read_xyz(reader).shape == (4, 3)
    assert reader.description.notes == ("The 4 bytes after the last point are left out.",)


def with_header(text: bytes) -> bytes:
    return b"\x93NUMPY\x01\x00" + len(text).to_bytes(2, "little") + text


OBJECTS = io.BytesIO()
np.save(OBJECTS, np.array([[1, 2, None]], dtype=object), allow_pickle=True)


@pytest.mark.parametrize(
    ("content", "expected", "found"),
    [
        (b"", ".npy form", "an empty file"),
        (b"version https://git-lfs.github.com/spec/v1\n", ".npy form", "git-LFS"),
        (b"\x93NUMPY\x09\x00", "version 1.0, 2.0 or 3.0", "9.0"),
        (b"\x93NUM", ".npy form", "begins with"),
        (OBJECTS.getvalue(), "plain values", "Python objects"),
        (npy(np.ones((5, 3)))[:-1], "120 bytes of values", "119 bytes"),
        (npy(np.ones((5, 2))), "(N, 3 or more) array", "float64 of shape (5, 2)"),
        (npy(np.ones((5, 3), complex)), "real numbers", "complex128"),
        (npy(np.ones(5, [("x", "f8"), ("y", "f8")])), "fields x, y and z", "of shape (5,)"),
        (with_header(b"{'descr': '<f8', 'fortran_order': False}"), "descr, fortran_order", "descr"),
        (with_header(b"__import__('os').abort()"), "descr, fortran_order", "__import__"),
        (with_header(b"(" * 9000), "descr, fortran_order", "((("),
        (with_header(b"-" * 9000 + b"1"), "descr, fortran_order", "---"),
        (with_header(b" " * 60000), "1 to 10000 bytes", "60000 bytes"),
        (
            with_header(b"{'descr': '<f8', 'fortran_order': False, 'shape': (10**17, 3)}"),
            "descr, fortran_order",
            "descr",
        ),
        (
            with_header(b"{'descr': '<f8', 'fortran_order': True, 'shape': (%d, 3)}" % 10**17),
            f"{24 * 10**17} bytes of values",
            "0 bytes",
        ),
        (
            with_header(b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 3)}"),
            "descr, fortran_order",
            "descr",
        ),
    ],
)
def test_broken_files_are_refused(tmp_path, content, expected, found):
    path = tmp_path / "map.npy"
    path.write_bytes(content)
    with pytest.raises(MapFormatError) as raised:
        open_map(path)
    assert expected in raised.value.expected
    assert found in raised.value.found


@pytest.mark.parametrize(
    "array",
    [
        np.arange(120.0).reshape(30, 4),
        np.asfortranarray(np.arange(120.0).reshape(30, 4)),
        np.ones(20, [("x", "f8"), ("y", ">f4"), ("z", "i2"), ("w", "u1", (3,))]),
    ],
)
def test_damaged_files_are_read_or_refused(tmp_path, survives, array):
    read, refused = survives(npy(array), tmp_path / "map.npy", 250)
    assert read > 25
    assert refused > 100


def npz(save=np.savez, /, **arrays) -> bytes:
    content = io.BytesIO()
    save(content, **arrays)
    return content.getvalue()


@settings(max_examples=40, deadline=None)
@given(
    tables(), st.booleans(), st.sampled_from([np.savez, np.savez_compressed]), st.integers(1, 30)
)
def test_archives_keep_every_bit(tmp_path_factory, rewrite, read_xyz, table, split, save, most):
    count = len(table)
    arrays = {name: table[:, n] for n, name in enumerate("xyz")} if split else {"points": table}
    random = np.random.default_rng(count)
    arrays |= {
        "normals": np.asfortranarray(random.normal(size=(count, 3))),
        "names": np.array(["a", "bc"] * count)[:count],
        "pixels": np.asfortranarray(random.integers(0, 9, (count, 2, 3))),
        "nothing": np.empty((count, 0)),
        "pose": random.normal(size=(count + 1, 4)),
        "scale": np.float32(0.5),
    }
    folder = tmp_path_factory.mktemp("npz")
    path = folder / "map.npz"
    path.write_bytes(npz(save, **arrays))
    reader = open_map(path)
    np.testing.assert_array_equal(read_xyz(reader, most), coordinates_of(table))
    chosen = random.random(count) < 0.5
    copy = rewrite(reader, folder / "copy.npz", chosen, most)
    with np.load(copy) as kept, zipfile.ZipFile(copy) as archive, zipfile.ZipFile(path) as source:
        assert kept.files == list(arrays)
        for name, array in arrays.items():
            expected = array[chosen] if np.shape(array)[:1] == (count,) else array
            assert kept[name].dtype == np.asarray(array).dtype
            assert kept[name].shape == expected.shape
            assert kept[name].tobytes() == expected.tobytes()
        assert archive.testzip() is None
        compressions = {entry.compress_type for entry in source.infolist()}
        assert {entry.compress_type for entry in archive.infolist()} == compressions
    assert [each.name for each in folder.iterdir() if each not in (path, copy)] == []


def test_other_entries_are_copied(tmp_path, rewrite):
    path = tmp_path / "map.npz"
    path.write_bytes(npz(arr_0=np.ones(9, [("x", "f8"), ("y", "f4"), ("z", "i2")])))
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("about.txt", "made by hand")
    copy = rewrite(open_map(path), tmp_path / "copy.npz", np.arange(9) > 4, 2)
    with zipfile.ZipFile(copy) as archive:
        assert archive.read("about.txt") == b"made by hand"
    assert len(np.load(copy)["arr_0"]) == 4


def test_python_objects_beside_the_points_are_copied_and_never_unpickled(tmp_path, rewrite):
    path = tmp_path / "map.npz"
    path.write_bytes(npz(points=np.ones((9, 3)), meta=np.array({"by": "hand"}, dtype=object)))
    with zipfile.ZipFile(path) as archive:
        pickled = archive.read("meta.npy")[:-1] + b"not a pickle any more"
    content = {"points": npy(np.ones((9, 3))), "meta": pickled}
    path.write_bytes(
        unsound(lambda to: [to.writestr(f"{name}.npy", each) for name, each in content.items()])
    )
    reader = open_map(path)
    (note,) = reader.description.notes
    assert "'meta' holds Python objects, which are never unpickled" in note
    with zipfile.ZipFile(rewrite(reader, tmp_path / "copy.npz", np.arange(9) > 4, 2)) as archive:
        assert archive.read("meta.npy") == pickled


@pytest.mark.parametrize(
    ("arrays", "taken"),
    [
        ({"pcd": np.ones((9, 3))}, "pcd"),
        ({"cloud": np.ones((9, 3)), "pose": np.eye(4)}, "cloud"),
        ({"cloud": np.ones((9, 4), "f4"), "ids": np.ones(9)}, "cloud"),
        ({"rgb": np.ones((9, 3), "u1"), "vertices": np.ones((9, 3))}, "vertices"),
        ({"table": np.ones(9, [("x", "f8"), ("y", "f8"), ("z", "f8")])}, "table"),
        ({"normals": np.ones((9, 3)), "vertices": np.ones((9, 3))}, None),
        ({"pose": np.eye(4), "other": np.eye(4)}, None),
    ],
)
def test_the_only_array_that_can_be_meant_is_taken(tmp_path, arrays, taken):
    path = tmp_path / "map.npz"
    path.write_bytes(npz(**arrays))
    if taken is None:
        with pytest.raises(MapFormatError, match="only one that can hold points"):
            open_map(path)
    else:
        assert open_map(path).description.notes == (f"The points are taken from array {taken!r}.",)
        assert open_map(path).description.point_count == 9


@pytest.mark.parametrize("archive", [False, True])
@pytest.mark.parametrize("named", [False, True])
def test_organised_arrays_are_read_row_by_row(tmp_path, read_xyz, rewrite, archive, named):
    points = np.random.default_rng(1).normal(size=(4, 5, 3))
    array = points
    if named:
        array = np.empty((4, 5), [("x", "f8"), ("y", "f8"), ("z", "f8")])
        for axis, name in enumerate("xyz"):
            array[name] = points[..., axis]
    path = tmp_path / ("map.npz" if archive else "map.npy")
    beside = np.arange(20, dtype="u2").reshape(4, 5)
    other = np.arange(4)
    path.write_bytes(npz(points=array, ring=beside, other=other) if archive else npy(array))
    reader = open_map(path)
    expected = "The organised cloud (4 x 5) becomes an unorganised one, a point a row."
    assert expected in reader.description.notes
    np.testing.assert_array_equal(read_xyz(reader, 7), points.reshape(-1, 3))
    chosen = np.arange(20) % 3 == 0
    copy = np.load(rewrite(reader, path.with_stem("copy"), chosen, 7))
    stored = copy["points"] if archive else copy
    assert stored.tobytes() == array.reshape(-1, *points.shape[2:] * (not named))[chosen].tobytes()
    if archive:
        np.testing.assert_array_equal(copy["ring"], beside.reshape(-1)[chosen])
        np.testing.assert_array_equal(copy["other"], other)


@pytest.mark.parametrize("shape", [(3, 40, 50), (40, 50, 2), (40, 50, 17), (2, 3, 4, 3)])
def test_arrays_of_other_shapes_are_refused(tmp_path, shape):
    (tmp_path / "map.npy").write_bytes(npy(np.zeros(shape)))
    with pytest.raises(MapFormatError, match="a point a row"):
        open_map(tmp_path / "map.npy")


@pytest.mark.parametrize("case", ["npz02_meta.npz", "npz06_key.npz", "npy03_organised.npy"])
def test_cases_are_read_with_a_note(shared_data, read_xyz, case):
    reader = open_map(shared_data / "cases" / case)
    assert len(reader.description.notes) == 1
    assert read_xyz(reader).shape == (6000, 3)


def lying(claimed_rows: int, claimed_size: int) -> bytes:
    """An archive whose one entry says that it holds far more than it does."""
    content = io.BytesIO()
    shape = b"(%d, 3), }" % claimed_rows
    header = npy(np.ones((1, 3)))[:128]
    header = header.replace(b"(1, 3), }".ljust(len(shape)), shape)
    with zipfile.ZipFile(content, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", header + bytes(240))
        archive.infolist()[0].file_size = claimed_size
    return content.getvalue()


def unsound(change) -> bytes:
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        change(archive)
    return content.getvalue()


def store(name, array, **options):
    return lambda archive: archive.writestr(name, npy(array), **options)


TRUNCATED = npz(np.savez_compressed, points=np.random.default_rng(0).normal(size=(50, 3)))


@pytest.mark.parametrize(
    ("content", "expected", "found"),
    [
        (b"", "ZIP archive", "an empty file"),
        (b"version https://git-lfs.github.com/spec/v1\n", "ZIP archive", "git-LFS"),
        (TRUNCATED[:-30], "a whole ZIP archive", "not a zip file"),
        (npz(points=np.ones((5, 2))), "(N, 3 or more) array", "'points' (float64 of shape (5, 2))"),
        (npz(x=np.ones(3), y=np.ones(3), z=np.ones(4)), "x, y and z", "'z' (float64"),
        (npz(x=np.ones(3), y=np.ones(3)), "x, y and z", "'x'"),
        (unsound(lambda archive: archive.writestr("a.txt", "text")), "x, y and z", "no arrays"),
        (npz(points=np.ones((2, 3)), extra=np.array([{}, {}])), "plain values", "Python objects"),
        (unsound(store("points.npy", np.ones((9, 3)), compress_type=zipfile.ZIP_LZMA)),
         "stored or deflated", "method 14"),
        (lying(10**9, 24 * 10**9 + 128), "24000000128 bytes", "bytes in a file of"),
        (lying(10**9, 368), "24000000000 bytes of array 'points'", "240 bytes"),
    ],
)  # fmt: skip
def test_broken_archives_are_refused(tmp_path, content, expected, found):
    path = tmp_path / "map.npz"
    path.write_bytes(content)
    with pytest.raises(MapFormatError) as raised:
        open_map(path)
    assert expected in raised.value.expected
    assert found in raised.value.found


def test_a_wrong_checksum_is_refused(tmp_path, read_xyz):
    content = bytearray(npz(points=np.ones((50, 3))))
    content[600] ^= 1
    (tmp_path / "map.npz").write_bytes(content)
    with pytest.raises(MapFormatError, match="CRC"):
        read_xyz(open_map(tmp_path / "map.npz"))


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_damaged_archives_are_read_or_refused(tmp_path, survives, save):
    arrays = {"points": np.ones((9, 3)), "ring": np.arange(9), "pose": np.eye(4)}
    _, refused = survives(npz(save, **arrays), tmp_path / "map.npz", 300)
    assert refused > 200
