"""The exact judge, on bodies whose volume is known and against Qhull."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import ConvexHull

from tests.dynahull.exact_hull import exact_hull_volume


def test_a_lattice_cube_is_exact() -> None:
    grid = np.stack(np.meshgrid(*[np.arange(4.0)] * 3), -1).reshape(-1, 3)
    assert exact_hull_volume(grid) == 27


def test_duplicates_change_nothing() -> None:
    corners = np.vstack([np.zeros(3), np.eye(3) * 3])
    assert exact_hull_volume(np.repeat(corners, 5, axis=0)) == 4.5


@pytest.mark.parametrize("count", [1, 3, 30])
def test_flat_points_have_no_volume(count: int) -> None:
    points = np.random.default_rng(0).random((count, 3))
    points[:, 2] = 0.1
    assert exact_hull_volume(points) == 0


def test_a_sliver_that_doubles_cannot_measure() -> None:
    tiny = 2.0**-500
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [2, 1, tiny]])
    assert exact_hull_volume(points) == tiny / 6


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_it_agrees_with_qhull(seed: int) -> None:
    points = np.random.default_rng(seed).normal(size=(40, 3))
    assert exact_hull_volume(points) == pytest.approx(ConvexHull(points).volume, rel=1e-12)
