"""The plain neighbours against brute force, ties and all."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynahull.reference import nearest_neighbours


def by_brute_force(points, rows, k):
    found = []
    for centre in points:
        difference = points - centre
        squared = (difference**2)[:, 0] + (difference**2)[:, 1] + (difference**2)[:, 2]
        found.append(np.lexsort((rows, squared))[:k])
    return np.array(found)


@pytest.mark.parametrize("shift", [0.0, 6e6])
def test_on_scattered_points(shift):
    points = np.random.default_rng(0).normal(size=(300, 3)) + shift
    rows = np.arange(300)
    np.testing.assert_array_equal(
        nearest_neighbours(points, rows, 20), by_brute_force(points, rows, 20)
    )


@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_ties_are_broken_by_row_number(k, seed):
    random = np.random.default_rng(seed)
    points = random.integers(0, 3, (60, 3)) * 0.01
    rows = random.permutation(1000)[:60]
    np.testing.assert_array_equal(
        nearest_neighbours(points, rows, k), by_brute_force(points, rows, k)
    )


def test_the_point_itself_is_its_first_neighbour():
    points = np.random.default_rng(1).normal(size=(50, 3))
    np.testing.assert_array_equal(nearest_neighbours(points, np.arange(50), 5)[:, 0], np.arange(50))


def test_fewer_points_than_k_are_all_neighbours():
    points = np.random.default_rng(2).normal(size=(6, 3))
    assert nearest_neighbours(points, np.arange(6), 75).shape == (6, 6)
    assert nearest_neighbours(np.empty((0, 3)), np.arange(0), 75).shape == (0, 0)
