"""Hull volumes of solids known from school, in every position."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from dynahull.reference import hull_volume

CUBE = np.array(list(product([0.0, 1.0], repeat=3)))
TETRAHEDRON = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


@pytest.mark.parametrize(
    ("solid", "volume"), [(CUBE, 1.0), (TETRAHEDRON, 1 / 6), (CUBE * [2, 3, 4], 24.0)]
)
def test_known_solids(solid, volume):
    assert hull_volume(solid) == pytest.approx(volume, rel=1e-14)


def test_points_inside_change_nothing():
    inside = np.random.default_rng(0).uniform(0.1, 0.9, (70, 3))
    assert hull_volume(np.vstack([CUBE, inside])) == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize(
    "flat",
    [
        np.zeros((10, 3)),
        np.outer(np.arange(10.0), [1, 2, 3]),
        np.random.default_rng(0).uniform(size=(75, 3)) * [1, 1, 0],
        TETRAHEDRON[:3],
        np.vstack([CUBE[:3], CUBE[:3]]),
    ],
    ids=["identical", "collinear", "coplanar", "three points", "duplicates of three"],
)
@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_flat_neighbourhoods_have_no_volume_in_any_position(flat, turn):
    turned = Rotation.from_rotvec([turn, turn / 2, turn / 3]).apply(flat)
    assert hull_volume(turned) == 0.0


@given(st.floats(1e-4, 1.0), st.floats(1e-3, 1e3), st.integers(0, 2**32 - 1))
def test_agrees_with_qhull_on_plates_of_any_thickness(thickness, size, seed):
    points = np.random.default_rng(seed).normal(size=(75, 3)) * [size, size, size * thickness]
    expected = ConvexHull(points - points[0], qhull_options="Qt").volume
    assert hull_volume(points) == pytest.approx(expected, rel=1e-9)


@given(st.floats(1e-8, 1e-3), st.floats(1e-8, 1e-3))
def test_slivers_are_measured_where_qhull_gives_up(width, thickness):
    box = CUBE * [1.0, width, thickness]
    assert hull_volume(box) == pytest.approx(width * thickness, rel=1e-6)
