"""Distances between clouds, against all pairs and against cases counted by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahull.progress import SilentObserver
from pipeline.errors import EvaluationError
from pipeline.evaluation.cloud import Cloud, NearestPoint, look_up
from pipeline.evaluation.distances import ChamferDistance, DirectedChamfer, DistanceStatistics
from tiling.formats.collection import MapCollection


def all_pairs(first, second):
    return np.sqrt(((first[:, np.newaxis] - second) ** 2).sum(axis=2))


@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 60))
def test_the_nearest_point_is_that_of_all_pairs(seed, count, others):
    random = np.random.default_rng(seed)
    # On a coarse grid, so that many distances are equal and many are zero.
    points, queries = random.integers(0, 4, (count, 3)) * 0.5, random.integers(0, 4, (others, 3))
    distances, indices = NearestPoint(points).find(queries.astype(float))
    expected = all_pairs(queries, points)
    np.testing.assert_allclose(distances, expected.min(axis=1), rtol=1e-15)
    np.testing.assert_allclose(
        expected[np.arange(others), indices], expected.min(axis=1), rtol=1e-15
    )


def test_the_greatest_distance_asked_for_counts_itself():
    nearest = NearestPoint(np.zeros((1, 3)))
    queries = np.array([[0.25, 0, 0], [0.25 + 1e-15, 0, 0], [0, 0, 0]])
    np.testing.assert_array_equal(nearest.distances(queries, 0.25), [0.25, np.inf, 0])
    np.testing.assert_array_equal(nearest.distances(queries, 0.0), [np.inf, np.inf, 0])


def test_the_statistics_of_distances_counted_by_hand():
    found = DistanceStatistics.of(np.array([0.0, 1.0, 2.0, 5.0]))
    assert found.count == 4
    assert found.mean_absolute_error == 2
    assert found.variance == pytest.approx((4 + 1 + 0 + 9) / 4)
    assert found.root_mean_square_error == pytest.approx(np.sqrt((0 + 1 + 4 + 25) / 4))
    # Rank 0.9 * 3 = 2.7: seven tenths of the way from the third to the fourth.
    assert found.percentile_90 == pytest.approx(2 + 0.7 * 3)
    assert found.largest == 5


@given(st.integers(0, 2**32 - 1), st.integers(1, 200))
def test_the_statistics_are_the_sums_of_their_definitions(seed, count):
    distances = np.random.default_rng(seed).exponential(size=count)
    found = DistanceStatistics.of(distances)
    mean = sum(distances) / count
    assert found.mean_absolute_error == pytest.approx(mean)
    assert found.variance == pytest.approx(sum((d - mean) ** 2 for d in distances) / count)
    assert found.root_mean_square_error**2 == pytest.approx(found.variance + mean**2)
    ordered = sorted(distances)
    low = int(0.9 * (count - 1))
    part = 0.9 * (count - 1) - low
    above = ordered[min(low + 1, count - 1)]
    assert found.percentile_90 == pytest.approx(ordered[low] + part * (above - ordered[low]))


def test_chamfer_of_two_points_and_one():
    # From (0) and (3) to (1): 1 and 2; back from (1): 1.
    there = DirectedChamfer.of([np.array([1.0]), np.array([2.0])])
    back = DirectedChamfer.of([np.array([1.0])])
    found = ChamferDistance.of(there, back)
    assert (there.squared, there.unsquared) == (2.5, 1.5)
    assert (found.squared, found.unsquared) == (3.5, 2.5)
    assert (found.truth_to_cleaned.squared, found.truth_to_cleaned.unsquared) == (1, 1)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 50), st.integers(1, 50), st.integers(1, 5))
def test_chamfer_is_the_means_over_all_pairs(seed, count, others, pieces):
    random = np.random.default_rng(seed)
    cleaned, truth = random.normal(size=(count, 3)), random.normal(size=(others, 3))
    pairs = all_pairs(cleaned, truth)
    there, back = (
        DirectedChamfer.of(
            NearestPoint(goal).distances(part) for part in np.array_split(start, pieces)
        )
        for start, goal in ((cleaned, truth), (truth, cleaned))
    )
    found = ChamferDistance.of(there, back)
    squared = (pairs.min(axis=1) ** 2).mean() + (pairs.min(axis=0) ** 2).mean()
    assert found.squared == pytest.approx(squared)
    assert found.unsquared == pytest.approx(pairs.min(axis=1).mean() + pairs.min(axis=0).mean())
    assert found.cleaned_to_truth.squared == pytest.approx((pairs.min(axis=1) ** 2).mean())
    assert found.truth_to_cleaned.unsquared == pytest.approx(pairs.min(axis=0).mean())


@pytest.fixture
def cloud(tmp_path):
    points = np.arange(30.0).reshape(10, 3)
    points[[2, 7], 1] = np.nan, 1e151
    np.save(tmp_path / "a.npy", points[:4])
    np.save(tmp_path / "b.npy", points[4:])
    return Cloud(MapCollection([tmp_path / "a.npy", tmp_path / "b.npy"])), points


def test_a_cloud_has_the_finite_points_and_their_rows_in_the_whole_map(cloud):
    whole, points = cloud
    finite = [0, 1, 3, 4, 5, 6, 8, 9]
    np.testing.assert_array_equal(whole.points(), points[finite])
    assert [row for rows, _ in whole.batches() for row in rows] == finite
    chosen = whole.choose(np.arange(10) % 2 == 1)
    found, labels = chosen.labelled_points(np.arange(10, dtype=np.int8))
    np.testing.assert_array_equal(labels, [1, 3, 5, 9])
    np.testing.assert_array_equal(found, points[[1, 3, 5, 9]])


def test_a_cloud_without_points_is_refused_by_name(cloud):
    with pytest.raises(EvaluationError, match=r"a\.npy and 1 more: expected finite points"):
        cloud[0].choose(np.zeros(10, dtype=bool)).points()


class Counter(SilentObserver):
    total = done = 0

    def stage(self, name, total):
        self.total = total

    def advance(self, points):
        self.done += points


def test_looking_up_a_cloud_tells_of_every_row(cloud, monkeypatch):
    monkeypatch.setattr("pipeline.evaluation.cloud.BATCH", 3)
    whole, points = cloud
    counter = Counter()
    found = list(look_up(whole, NearestPoint(points[:1]), counter, "test"))
    assert (counter.done, counter.total) == (10, 10)
    distances = np.concatenate([batch for _, batch, _ in found])
    np.testing.assert_allclose(distances, all_pairs(whole.points(), points[:1])[:, 0])
    assert len(found) == 4
