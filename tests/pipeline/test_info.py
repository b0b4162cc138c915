"""What a map is said to be."""

import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline import info
from pipeline.info import DuplicateCounter, inspect_map
from tiling.errors import MapFormatError


def count_duplicates(batches):
    with DuplicateCounter(sum(map(len, batches))) as counter:
        for batch in batches:
            counter.add(batch)
        return counter.total()


@given(st.integers(0, 2**32 - 1), st.integers(1, 5))
def test_duplicates_are_the_points_that_unique_drops(seed, pieces):
    points = np.random.default_rng(seed).integers(-2, 3, (80, 3)) * 0.5
    batches = np.array_split(points, pieces)
    assert count_duplicates(batches) == 80 - len(np.unique(points, axis=0))


def test_the_two_zeros_are_one_place():
    assert count_duplicates([np.array([[0.0, 1, 2], [-0.0, 1, 2]])]) == 1
    assert count_duplicates([]) == 0


def test_a_map_of_several_files(tmp_path):
    np.save(tmp_path / "a.npy", np.array([[0.0, 0, 0], [1, 2, 3]]))
    np.save(tmp_path / "b.npy", np.array([[1.0, 2, 3], [np.inf, 0, 0]]))
    info = inspect_map([tmp_path])
    assert (info.points, info.non_finite, info.duplicates) == (4, 1, 1)
    assert info.minimum == (0, 0, 0)
    assert info.maximum == pytest.approx((1, 2, 3))
    assert "4 in 2 files" in info.to_text()


def test_a_map_without_a_finite_point(tmp_path):
    np.save(tmp_path / "a.npy", np.full((3, 3), np.nan))
    info = inspect_map([tmp_path / "a.npy"])
    assert info.minimum is None
    assert "non-finite  3" in info.to_text()


@pytest.mark.parametrize("held", [7, 40])
def test_duplicates_are_the_same_through_files(monkeypatch, held):
    points = np.random.default_rng(held).integers(-2, 3, (400, 3)) * 0.5
    batches = np.array_split(points, 9)
    in_memory = count_duplicates(batches)
    monkeypatch.setattr(info, "_IN_MEMORY", held)
    assert count_duplicates(batches) == in_memory == 400 - len(np.unique(points, axis=0))


def test_a_bomb_of_one_point_takes_no_memory(tmp_path):
    np.savez_compressed(tmp_path / "bomb.npz", points=np.zeros((8_000_000, 3)))
    assert (tmp_path / "bomb.npz").stat().st_size < 1_000_000
    tracemalloc.start()
    try:
        info = inspect_map([tmp_path / "bomb.npz"])
        assert tracemalloc.get_traced_memory()[1] < 150e6
    finally:
        tracemalloc.stop()
    assert info.duplicates == info.points - 1


def test_coordinates_too_coarse_are_noted(shared_data, tmp_path):
    info = inspect_map([shared_data / "cases/pcd11_utm_float32.pcd"])
    assert "steps of 0.5 m (float32" in info.to_text()
    far = np.array([[6.6e6, 1.0, 2.0]]) + np.random.default_rng(0).uniform(0, 9, (500, 3))
    np.save(tmp_path / "exact.npy", far)
    np.save(tmp_path / "rounded.npy", far.astype(np.float32))
    far[5:] -= (6.6e6, 0, 0)
    np.save(tmp_path / "strays.npy", far.astype(np.float32))
    assert inspect_map([tmp_path / "exact.npy"]).notes == []
    assert inspect_map([tmp_path / "strays.npy"]).notes == []
    (note,) = inspect_map([tmp_path / "rounded.npy"]).notes
    assert note.startswith("The file keeps x in steps of 0.5 m")


def test_names_from_a_file_stay_short_and_printable(tmp_path):
    fields = [(axis, "f8") for axis in "xyz"] + [("\x1b[31m" + "n" * 900, "f4")]
    fields += [(f"c{number}", "u1") for number in range(300)]
    np.save(tmp_path / "a.npy", np.zeros(5, fields))
    text = inspect_map([tmp_path / "a.npy"]).to_text()
    assert "\x1b" not in text
    assert "and 204 more" in text
    assert max(map(len, text.splitlines())) < 2000


def test_an_array_on_its_side_is_refused(shared_data):
    with pytest.raises(MapFormatError, match=r"shape \(3, 6000\)"):
        inspect_map([shared_data / "cases/npy01_3xN.npy"])
