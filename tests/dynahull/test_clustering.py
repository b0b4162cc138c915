"""Clusters do not depend on how the points are cut, ordered or moved."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynahull import clustering
from dynahull.clustering import Clusters, fit_clusters, sample_rows
from dynahull.parameters import ClusteringParameters


def blobs(count=4, size=300, seed=0):
    random = np.random.default_rng(seed)
    centres = np.arange(count)[:, None] * [20.0, 0, 0]
    return np.concatenate([centre + random.normal(size=(size, 3)) for centre in centres])


def test_finds_the_obvious_clusters():
    points = blobs()
    clusters = fit_clusters(points, ClusteringParameters(count=4))
    nearest = clusters.nearest(points)
    assert sorted(np.bincount(nearest)) == [300, 300, 300, 300]
    for start in range(0, 1200, 300):
        assert len(np.unique(nearest[start : start + 300])) == 1


def test_the_same_seed_gives_the_same_centroids():
    parameters = ClusteringParameters(count=3, seed=7)
    first, second = (fit_clusters(blobs(), parameters).centroids for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_far_coordinates_lose_no_digits():
    shift = np.array([5e5, 6e6, 100.0])
    near = fit_clusters(blobs(), ClusteringParameters(count=4)).centroids
    far = fit_clusters(blobs() + shift, ClusteringParameters(count=4)).centroids - shift
    np.testing.assert_allclose(far[np.argsort(far[:, 0])], near[np.argsort(near[:, 0])], atol=1e-6)


def test_a_point_belongs_to_its_nearest_centroid_and_to_the_first_of_two():
    clusters = Clusters(np.array([[0.0, 0, 0], [2, 0, 0], [2, 0, 0]]))
    np.testing.assert_array_equal(
        clusters.nearest(np.array([[0.4, 0, 0], [1, 5, 5], [1.6, 0, 0]])), [0, 0, 1]
    )


@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(0, 3_000), st.integers(2, 4))
def test_assignment_is_the_nearest_by_any_number_of_threads(seed, count, size, threads):
    random = np.random.default_rng(seed)
    # whole numbers: many points have several nearest centroids
    clusters = Clusters(random.integers(-3, 4, (count, 3)).astype(float))
    points = random.integers(-3, 4, (size, 3)).astype(float)
    squared = ((points[:, None] - clusters.centroids) ** 2).sum(axis=2)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(clustering, "_SMALLEST_RANGE", 100)
        patch.setattr(clustering, "_ASSIGNMENT_BATCH", 37)
        for number in (1, threads):
            nearest = clusters.nearest(points, threads=number)
            np.testing.assert_array_equal(nearest, np.argmin(squared, axis=1))


@given(st.integers(1, 7))
def test_assignment_is_the_same_in_any_batch(pieces):
    points = blobs(size=50) + 1e6
    clusters = fit_clusters(points, ClusteringParameters(count=4))
    whole = clusters.nearest(points)
    parts = [clusters.nearest(part) for part in np.array_split(points, pieces)]
    np.testing.assert_array_equal(np.concatenate(parts), whole)


@pytest.mark.parametrize(("distinct", "expected"), [(0, 0), (1, 1), (3, 3), (9, 5)])
def test_no_more_clusters_than_distinct_points(distinct, expected):
    points = np.repeat(np.arange(distinct)[:, None] * [1.0, 2, 3], 4, axis=0)
    assert len(fit_clusters(points, ClusteringParameters(count=5)).centroids) == expected


@pytest.mark.parametrize("total", [20_000, 10_000_000], ids=["by share", "the lowest thousand"])
def test_the_sample_of_a_map_is_the_same_however_its_rows_are_cut(total):
    parameters = ClusteringParameters(sample=4_000, seed=3)
    rows = np.arange(10_000)
    whole = rows[sample_rows(rows, total, parameters)]
    assert len(whole) == pytest.approx(2_000 if total == 20_000 else 1_000, rel=0.1)
    shuffled = np.random.default_rng(0).permutation(rows)
    for cuts in ([1, 2, 7_000], [500], list(range(100, 10_000, 100))):
        pieces = np.split(shuffled, cuts)
        gathered = np.concatenate(
            [piece[sample_rows(piece, total, parameters)] for piece in pieces]
        )
        again = gathered[sample_rows(gathered, total, parameters)]
        np.testing.assert_array_equal(again, whole)


def test_a_small_map_is_sampled_whole():
    parameters = ClusteringParameters(sample=4_000)
    for size in (0, 1, 999, 1_000, 4_000):
        rows = np.arange(size)
        np.testing.assert_array_equal(sample_rows(rows, size, parameters), rows)


def test_another_seed_draws_another_sample_and_all_parts_of_the_map_are_in_it():
    rows = np.arange(40_000)
    first, second = (
        sample_rows(rows, 40_000, ClusteringParameters(sample=4_000, seed=seed)) for seed in (0, 1)
    )
    assert len(np.intersect1d(first, second)) < 800
    assert np.histogram(first, bins=10, range=(0, 40_000))[0].min() > 300
