"""Every finite point lies in exactly one tile, and no tile holds too many."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.formats import PointBatch
from tiling.layout import NO_TILE, quadtree
from tiling.survey import survey


def cut(xyz, max_points):
    return quadtree(survey([PointBatch(0, xyz, None)]).occupancy, max_points)


@settings(deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 400),
    st.integers(1, 100),
    st.sampled_from([0.3, 20.0, 1e6]),
    st.sampled_from([0.0, -3e5, 6e6]),
    st.booleans(),
)
def test_every_point_lies_in_the_core_of_its_one_tile(
    seed, size, max_points, extent, shift, gridded
):
    random = np.random.default_rng(seed)
    xyz = random.normal(size=(size, 3)) * extent + shift
    if gridded:
        xyz = np.round(xyz * 4) / 4  # on the borders of the columns
    layout = cut(xyz, max_points)
    tiles = layout.tile_of(xyz)
    flat = xyz[:, None, :2]
    inside = ((flat >= layout.low) & (flat < layout.high)).all(axis=2)
    np.testing.assert_array_equal(inside.sum(axis=1), 1)
    np.testing.assert_array_equal(inside.argmax(axis=1), tiles)
    np.testing.assert_array_equal(np.bincount(tiles, minlength=len(layout)), layout.counts)
    assert (layout.counts > 0).all()
    assert (layout.counts[layout.levels > 0] <= max_points).all()


def test_tiles_are_as_large_as_they_may_be():
    xyz = np.random.default_rng(0).uniform(0, 64, (20_000, 3))
    layout = cut(xyz, 1_400)
    assert len(layout) == 16
    assert len(cut(xyz, 20_000)) == 1
    assert len(cut(xyz - 32, 20_000)) == 4


def test_points_that_are_not_finite_lie_in_no_tile():
    xyz = np.array([[1.0, 2, 3], [np.nan, 0, 0], [0, 0, np.inf]])
    np.testing.assert_array_equal(cut(xyz, 5).tile_of(xyz), [0, NO_TILE, NO_TILE])
    assert len(cut(xyz[1:], 5)) == 0


def test_tiles_near_a_box():
    xyz = np.random.default_rng(0).uniform(0, 64, (20_000, 3))
    layout = cut(xyz, 1_400)
    inside = layout.near(np.array([20.0, 20]), np.array([28.0, 28]))
    np.testing.assert_array_equal(layout.low[inside], [[16.0, 16.0]])
    assert len(layout.near(np.full(2, -np.inf), np.full(2, np.inf))) == 16
    assert len(layout.near(np.array([31.0, 31]), np.array([33.0, 33]))) == 4


def test_neighbours_in_order_are_neighbours_in_place():
    xyz = np.random.default_rng(0).uniform(-64, 64, (40_000, 3))
    layout = cut(xyz, 300)
    steps = np.abs(np.diff(layout.low, axis=0)).max(axis=1)
    assert np.median(steps) <= 8
