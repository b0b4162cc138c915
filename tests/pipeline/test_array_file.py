"""Arrays in a file: they come back as they were, and a damaged file is named."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays, scalar_dtypes

from pipeline.errors import WorkError
from pipeline.work.files import map_array, read_arrays, write_arrays

KINDS = scalar_dtypes().filter(lambda kind: kind.kind not in "Mm")


@settings(deadline=None, max_examples=60)
@given(
    written=st.dictionaries(
        st.text(min_size=1, max_size=5),
        arrays(KINDS, array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=5)),
        max_size=4,
    ),
    random=st.randoms(use_true_random=False),
    compress=st.booleans(),
)
def test_arrays_come_back_in_any_order(tmp_path_factory, written, random, compress):
    path = tmp_path_factory.mktemp("arrays") / "task.arrays"
    write_arrays(path, *([written] if compress else [{}, written]))
    names = random.sample(sorted(written), len(written))
    for name, found in zip(names, read_arrays(path, *names), strict=True):
        assert (found.dtype, found.shape) == (written[name].dtype, written[name].shape)
        assert found.tobytes() == written[name].tobytes()
        mapped = map_array(path, name)
        assert (mapped.dtype, mapped.shape) == (found.dtype, found.shape)
        assert mapped.tobytes() == found.tobytes()


def test_an_array_that_is_no_run_of_memory_comes_back(tmp_path):
    strided = np.arange(24.0).reshape(4, 6)[::2, 1::2]
    write_arrays(tmp_path / "task.arrays", {"strided": strided, "turned": strided.T})
    found, turned = read_arrays(tmp_path / "task.arrays", "strided", "turned")
    np.testing.assert_array_equal(found, strided)
    np.testing.assert_array_equal(turned, strided.T)


@pytest.mark.parametrize("order", ["C", "F"])
def test_what_repeats_is_compressed_and_comes_back_writable(tmp_path, order):
    path = tmp_path / "task.arrays"
    table = np.asarray(np.arange(30_000).reshape(-1, 3) // 300, order=order)
    write_arrays(path, {"table": table})
    assert path.stat().st_size < table.nbytes / 5
    for found in (*read_arrays(path, "table"), map_array(path, "table")):
        np.testing.assert_array_equal(found, table)
        assert found.flags.writeable and found.flags.c_contiguous


def test_what_is_not_compressed_is_mapped(tmp_path):
    path = tmp_path / "task.arrays"
    write_arrays(path, {"ones": np.ones(9)}, {"zeros": np.zeros(1000)})
    assert isinstance(map_array(path, "zeros").base, np.memmap)


def test_damage_within_what_is_compressed_is_named(tmp_path):
    path = tmp_path / "task.arrays"
    write_arrays(path, {"rows": np.arange(5000)})
    data = path.read_bytes()
    path.write_bytes(data[:-200] + bytes(200))
    with pytest.raises(WorkError, match=r"task\.arrays: expected arrays, found a damaged file"):
        read_arrays(path, "rows")


def test_a_head_that_counts_more_than_there_can_be_is_refused(tmp_path):
    path = tmp_path / "task.arrays"
    write_arrays(path, {"rows": np.zeros(100_000)})
    path.write_bytes(path.read_bytes().replace(b"(100000,), }" + b" " * 19, b"(%d,), }" % 10**24))
    with pytest.raises(WorkError, match="found a damaged file"):
        read_arrays(path, "rows")


@pytest.mark.parametrize(
    "damage", [lambda data: data[:-100], lambda data: b"x" + data, lambda _: b""]
)
def test_a_damaged_file_is_named(tmp_path, damage):
    path = tmp_path / "task.arrays"
    write_arrays(path, {"rows": np.arange(50)})
    path.write_bytes(damage(path.read_bytes()))
    with pytest.raises(WorkError, match=r"task\.arrays: expected the arrays rows, found a damaged"):
        read_arrays(path, "rows")
    with pytest.raises(WorkError, match=r"task\.arrays: expected the arrays rows, found a damaged"):
        map_array(path, "rows")


def test_an_array_that_was_not_kept_is_named(tmp_path):
    write_arrays(tmp_path / "task.arrays", {"rows": np.arange(5)})
    with pytest.raises(WorkError, match="expected the arrays xyz"):
        read_arrays(tmp_path / "task.arrays", "xyz")


@pytest.mark.parametrize(
    "described",
    [
        [["rows", "|O", [4], 0]],  # addresses of Python objects, to be followed
        [["rows", [["a", "|O"]], [4], 0]],
        [["rows", "<i8", [-1], 0]],
        [["rows", "<i8", [4], -64]],
        [["rows", "<i8", [4, 1 << 60], 0]],
        [["rows", "<i8", "44", 0]],
        [["rows", "<i8", [4.0], 0]],
        [["rows", None, [4], 0]],
        [["rows"]],
        {"rows": 1},
        {"rows": -1},
        {"rows": "8"},
        {"rows": 1 << 80},
        ["rows"],
        7,
    ],
    ids=str,
)
def test_a_file_that_describes_no_numbers_is_refused(tmp_path, described):
    path = tmp_path / "task.arrays"
    path.write_bytes(json.dumps(described).encode() + b"\n" + bytes(64))
    with pytest.raises(WorkError, match="found a damaged file"):
        read_arrays(path, "rows")
    with pytest.raises(WorkError, match="found a damaged file"):
        map_array(path, "rows")


def test_a_head_without_end_is_refused(tmp_path):
    path = tmp_path / "task.arrays"
    path.write_bytes(b"[" * 100_000 + b"\n")
    with pytest.raises(WorkError, match="found a damaged file"):
        read_arrays(path, "rows")
