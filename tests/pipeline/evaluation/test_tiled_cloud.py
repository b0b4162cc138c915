"""Clouds in tiles: every finite point once, with its row, and the nearest whatever the tiles."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dynahull.clustering import random_rank
from dynahull.observer import SilentObserver
from pipeline.errors import EvaluationError
from pipeline.evaluation.distances import draw_sample
from pipeline.evaluation.tiled_cloud import (
    CloudSource,
    check_points,
    find_nearest,
    look_up,
    voxel_cells,
)
from pipeline.evaluation.truth import RowReader, RowValues, Truth
from tests.pipeline.evaluation.clouds import cut, source_of
from tiling.collection import MapCollection

anew = settings(
    deadline=None, max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
STATIC, DYNAMIC, UNKNOWN = Truth


def all_of(cloud, column):
    return np.concatenate([getattr(cloud, column)(tile) for tile in cloud.tiles()])


def scattered(random, count):
    """Points on a grid, so that many are as near as others, some far away and some not finite."""
    xyz = random.integers(0, 12, (count, 3)) * 0.1 + random.integers(0, 2, (count, 1)) * 40
    xyz[random.random(count) < 0.05, 1] = np.nan
    xyz[0] = 1
    return xyz


@anew
@given(st.integers(0, 2**32 - 1), st.integers(1, 200), st.integers(1, 50))
def test_every_chosen_finite_point_is_in_one_tile(tmp_path, seed, count, most):
    random = np.random.default_rng(seed)
    xyz, chosen = scattered(random, count), random.random(count) < 0.8
    labels, removed = random.integers(0, 3, count).astype(np.int8), random.random(count) < 0.5
    chosen[0] = True
    source = source_of(tmp_path / "map.npy", xyz, labels, removed, chosen)
    cloud = cut(tmp_path / "cut", most, 0.3, map=source)["map"]
    wanted = np.flatnonzero(chosen & np.isfinite(xyz).all(axis=1))
    order = np.argsort(all_of(cloud, "rows"))
    np.testing.assert_array_equal(all_of(cloud, "rows")[order], wanted)
    np.testing.assert_array_equal(all_of(cloud, "xyz")[order], xyz[wanted])
    np.testing.assert_array_equal(all_of(cloud, "labels")[order], labels[wanted])
    np.testing.assert_array_equal(all_of(cloud, "removed")[order], removed[wanted])
    assert len(cloud) == len(wanted)
    # No voxel is in two tiles, and the box of each tile is that of its points.
    tiles = [set(map(tuple, voxel_cells(cloud.xyz(tile), 0.3))) for tile in cloud.tiles()]
    assert sum(map(len, tiles)) == len(set().union(*tiles))
    for tile in cloud.tiles():
        np.testing.assert_array_equal(cloud.low[tile], cloud.xyz(tile).min(axis=0))
        np.testing.assert_array_equal(cloud.high[tile], cloud.xyz(tile).max(axis=0))
    static = cloud.choose(STATIC)
    assert len(static) == np.count_nonzero(labels[wanted] == STATIC)
    if len(static):
        assert set(all_of(static, "rows")) == set(wanted[labels[wanted] == STATIC])


@anew
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 150),
    st.integers(1, 150),
    st.sampled_from([0.0, 0.1, 1.0, np.inf]),
)
def test_the_nearest_point_is_that_of_all_pairs_in_any_tiles(
    tmp_path, seed, count, others, at_most
):
    random = np.random.default_rng(seed)
    xyz, places = scattered(random, count), scattered(random, others) + random.choice([0, 0.05, 90])
    labels = random.integers(0, 3, count).astype(np.int8)
    for most in (5, 40, 1000):
        clouds = cut(
            tmp_path / "cut", most,
            map=source_of(tmp_path / "map.npy", xyz, labels),
            places=source_of(tmp_path / "places.npy", places),
        )  # fmt: skip
        finite = np.isfinite(xyz).all(axis=1)
        for tile, nearest in look_up(
            clouds["places"], clouds["map"], SilentObserver(), "test", at_most
        ):
            apart = clouds["places"].xyz(tile)[:, np.newaxis] - xyz[finite]
            squared = (apart[..., 0] ** 2 + apart[..., 1] ** 2) + apart[..., 2] ** 2
            least = squared.min(axis=1)
            tied = np.where(squared == least[:, np.newaxis], labels[finite], UNKNOWN).min(axis=1)
            near = np.sqrt(least) <= at_most
            np.testing.assert_array_equal(nearest.distances, np.where(near, np.sqrt(least), np.inf))
            np.testing.assert_array_equal(nearest.labels, np.where(near, tied, UNKNOWN))


def test_the_greatest_distance_asked_for_counts_itself(tmp_path):
    cloud = cut(tmp_path / "cut", map=source_of(tmp_path / "map.npy", np.zeros((1, 3))))["map"]
    places = np.array([[0.25, 0, 0], [0.25 + 1e-15, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(find_nearest(places, cloud, 0.25).distances, [0.25, np.inf, 0])
    np.testing.assert_array_equal(find_nearest(places, cloud, 0.0).distances, [np.inf, np.inf, 0])


def test_several_files_are_one_cloud_and_progress_counts_every_row(tmp_path):
    points = np.arange(30.0).reshape(10, 3)
    points[[2, 7], 1] = np.nan, 1e151
    np.save(tmp_path / "a.npy", points[:4])
    np.save(tmp_path / "b.npy", points[4:])
    source = CloudSource(MapCollection([tmp_path / "a.npy", tmp_path / "b.npy"]))
    cloud = cut(tmp_path / "cut", map=source)["map"]
    np.testing.assert_array_equal(all_of(cloud, "rows"), [0, 1, 3, 4, 5, 6, 8, 9])
    with pytest.raises(EvaluationError, match=r"a\.npy and 1 more: expected finite points among"):
        check_points(cloud.choose(DYNAMIC), " among those")


def test_labels_and_removals_can_be_set(tmp_path):
    source = source_of(tmp_path / "map.npy", np.arange(9.0).reshape(3, 3))
    cloud = cut(tmp_path / "cut", map=source)["map"]
    (tile,) = cloud.tiles()
    dynamic = cloud.choose(DYNAMIC)
    assert len(dynamic) == 0
    cloud.relabel(tile, np.array([STATIC, DYNAMIC, UNKNOWN]))
    cloud.mark_removed(tile, np.array([False, True, True]))
    assert len(dynamic) == 1
    assert dynamic.removed(tile).tolist() == [True]
    assert cloud.choose(STATIC, UNKNOWN).rows(tile).tolist() == [0, 2]


@anew
@given(st.integers(0, 2**32 - 1), st.integers(1, 900), st.integers(1, 40), st.integers(1, 300))
def test_a_sample_is_that_of_an_array_in_the_order_of_the_rows(tmp_path, seed, count, size, most):
    random = np.random.default_rng(seed)
    xyz, labels = scattered(random, count), random.integers(0, 2, count).astype(np.int8)
    labels[0] = STATIC
    clouds = cut(tmp_path / "cut", most, map=source_of(tmp_path / "map.npy", xyz, labels))
    rows = np.flatnonzero(np.isfinite(xyz).all(axis=1) & (labels == STATIC))
    drawn = np.sort(rows[np.argsort(random_rank(rows, 17))[:size]])
    found = draw_sample(clouds["map"].choose(STATIC), size, seed=4, stream=1)
    np.testing.assert_array_equal(found, xyz[drawn])


def test_values_are_read_as_many_as_are_asked_for():
    reader = RowReader(RowValues(lambda: iter(np.split(np.arange(10), [3, 3, 4]))), "map.npy")
    assert [reader.take(count).tolist() for count in (2, 0, 4, 4)] == [
        [0, 1], [], [2, 3, 4, 5], [6, 7, 8, 9],
    ]  # fmt: skip
    with pytest.raises(EvaluationError, match=r"map\.npy: expected a value .*, found 1 too few"):
        reader.take(1)
