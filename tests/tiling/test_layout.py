"""Every finite point lies in exactly one tile, and no tile holds too many."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.formats import PointBatch
from tiling.layout import NO_TILE, Layout, morton_order, quadtree
from tiling.survey import columns_of, count_within, distinct_columns, survey_batches


def occupancy_of(xyz):
    return survey_batches([PointBatch(0, xyz, None)]).occupancy


def cut(xyz, max_points):
    return quadtree(occupancy_of(xyz), max_points)


@settings(deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 400),
    st.integers(1, 100),
    st.sampled_from([0.3, 20.0, 1e6, 1e12]),
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
    overfull = layout.overfull(max_points)
    assert (layout.ends - layout.begins == 1)[overfull].all()
    columns = columns_of(xyz, layout.cell)
    for tile in layout:
        own = columns[tiles == tile.index]
        np.testing.assert_array_equal(own.min(axis=0), layout.begins[tile.index])
        np.testing.assert_array_equal(own.max(axis=0), layout.ends[tile.index] - 1)


def test_tiles_are_as_large_as_they_may_be():
    xyz = np.random.default_rng(0).uniform(0, 64, (20_000, 3))
    xyz[0] = 0
    layout = cut(xyz, 1_400)
    assert len(layout) == 16
    assert len(cut(xyz, 20_000)) == 1
    assert len(cut(xyz - 32, 20_000)) == 1
    assert len(cut(xyz - 1e6, 1_400)) == 16


def test_a_half_of_a_square_is_a_tile_where_it_is_small_enough():
    xyz = np.random.default_rng(0).uniform(0, 64, (20_000, 3))
    xyz[0] = 0
    layout = cut(xyz, 2_800)
    assert len(layout) == 8
    sides = layout.ends - layout.begins
    np.testing.assert_array_equal(sides * layout.cell, [[16.0, 32.0]] * 8)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 300), st.sampled_from([0.7, 30.0, 1e12]))
def test_points_in_boxes_are_counted_by_column(seed, size, extent):
    random = np.random.default_rng(seed)
    occupancy = occupancy_of(random.normal(size=(size, 3)) * extent)
    corners = np.sort(random.normal(size=(2, 20, 2)) * extent, axis=0)
    corners[0, :3] = -np.inf
    corners[1, 2:6, 1] = np.inf
    corners[1, 7] = corners[0, 7]
    corners[:, 8] = corners[::-1, 8]  # nothing is between limits the wrong way round
    middles = (occupancy.columns + 0.5) * occupancy.cell
    inside = ((middles[:, None] >= corners[0]) & (middles[:, None] < corners[1])).all(axis=2)
    expected = (occupancy.counts[:, None] * inside).sum(axis=0)
    np.testing.assert_array_equal(count_within(occupancy, *corners), expected)


def test_points_that_are_in_no_tile():
    xyz = np.array([[1.0, 2, 3], [np.nan, 0, 0], [0, 0, np.inf]])
    np.testing.assert_array_equal(cut(xyz, 5).tile_of(xyz), [0, NO_TILE, NO_TILE])
    assert len(cut(xyz[1:], 5)) == 0
    np.testing.assert_array_equal(cut(xyz[1:], 5).tile_of(xyz), [NO_TILE] * 3)
    elsewhere = np.array([[-9.0, 2, 0], [9, 2, 0], [1, -9, 0], [1, 9, 0]])
    np.testing.assert_array_equal(cut(xyz, 5).tile_of(elsewhere), [NO_TILE] * 4)


def test_tiles_near_a_box():
    xyz = np.random.default_rng(0).uniform(0, 64, (20_000, 3))
    xyz[0] = 0
    layout = cut(xyz, 1_400)
    low, high = np.array([20.0, 20]), np.array([28.0, 28])
    np.testing.assert_array_equal(layout.low[layout.near(low, high)], [[16.0, 16.0]])
    assert len(layout.near(np.full(2, -np.inf), np.full(2, np.inf))) == 16
    assert len(layout.near(np.array([31.0, 31]), np.array([33.0, 33]))) == 4
    assert len(layout.near(low - 3.5, high + 3.5)) == 1
    assert len(layout.near(low - 4.0, high + 4.0)) == 9


def test_neighbours_in_order_are_neighbours_in_place():
    xyz = np.random.default_rng(0).uniform(-64, 64, (40_000, 3))
    layout = cut(xyz, 300)
    steps = np.abs(np.diff(layout.low, axis=0)).max(axis=1)
    assert np.median(steps) <= 8


def test_a_layout_goes_through_json():
    layout = cut(np.random.default_rng(0).normal(size=(900, 3)) * 1e4, 100)
    back = Layout.from_json(layout.to_json())
    assert back.cell == layout.cell
    for name in ("origin", "begins", "ends", "counts"):
        np.testing.assert_array_equal(getattr(back, name), getattr(layout, name))
    empty = cut(np.empty((0, 3)), 1)
    assert len(Layout.from_json(empty.to_json())) == 0


@given(st.lists(st.tuples(*[st.integers(0, 2**42)] * 2), min_size=1, max_size=20))
def test_the_z_curve_takes_the_bits_in_turn(columns):
    def key(x, y):
        return "".join(a + b for a, b in zip(f"{x:050b}", f"{y:050b}", strict=True))

    order = morton_order(np.array(columns, dtype=np.int64))
    assert [key(*columns[place]) for place in order] == sorted(key(*each) for each in columns)


@settings(deadline=None, max_examples=200)
@given(st.integers(0, 2**32 - 1), st.integers(0, 300), st.sampled_from([1, 3, 40, 10**6, 2**60]))
def test_distinct_columns_are_those_that_come_in_order(seed, count, extent):
    columns = np.random.default_rng(seed).integers(-extent, extent, (count, 2))
    found, numbers = distinct_columns(columns)
    np.testing.assert_array_equal(found, np.unique(columns, axis=0))
    np.testing.assert_array_equal(found[numbers], columns)
