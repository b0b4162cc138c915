"""What a map is said to be."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.info import count_duplicates, inspect_map


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
