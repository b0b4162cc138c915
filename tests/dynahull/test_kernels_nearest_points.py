"""The nearest points of places, against all pairs, however the points are shared out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahull.kernels.closest import NO_RANK
from dynahull.kernels.nearest_points import NearestSearch


def of_all_pairs(places, points, ranks, squared_bound):
    """Return squared distance and rank of each place's nearest point: the plain version."""
    x, y, z = (points[:, axis] - places[:, axis, np.newaxis] for axis in range(3))
    squared = (x * x + y * y) + z * z
    nearest = np.minimum(squared.min(axis=1), squared_bound)
    tied = np.where(squared == nearest[:, np.newaxis], ranks, NO_RANK)
    return nearest, tied.min(axis=1)


@settings(deadline=None, max_examples=60)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 400),
    st.integers(1, 60),
    st.integers(1, 5),
    st.sampled_from([0.0, 0.25, 2.0, np.inf]),
    st.sampled_from([0.0, 6.7e6, 1e20]),
)
def test_the_nearest_is_that_of_all_pairs(seed, count, others, parts, bound, far):
    random = np.random.default_rng(seed)
    # Tenths: many ties, and many that are ties but for rounding; often many points in one place.
    points = random.integers(0, random.integers(1, 9), (count, 3)) * 0.1 + far
    places = random.integers(0, 9, (others, 3)) * 0.05 + far
    ranks = random.integers(0, 3, count)
    search = NearestSearch(places, bound, threads=2)
    for part in np.array_split(random.permutation(count), parts):
        search.offer(points[part], ranks[part])
    squared, rank = of_all_pairs(places, points, ranks, bound)
    np.testing.assert_array_equal(search.squared, squared)
    np.testing.assert_array_equal(search.rank, rank)


def test_only_the_chosen_places_choose():
    search = NearestSearch(np.zeros((3, 3)))
    search.offer(np.ones((1, 3)), np.array([7]), np.array([1]))
    assert search.rank.tolist() == [NO_RANK, 7, NO_RANK]
    np.testing.assert_array_equal(search.squared, [np.inf, 3, np.inf])
    search.offer(np.empty((0, 3)), np.empty(0, np.int64))
    assert search.rank.tolist() == [NO_RANK, 7, NO_RANK]


@pytest.mark.parametrize("threads", [1, 3])
def test_many_places_are_shared_out(threads):
    random = np.random.default_rng(0)
    points, places = random.uniform(size=(3000, 3)), random.uniform(size=(50_000, 3))
    search = NearestSearch(places, threads=threads)
    search.offer(points, np.arange(3000))
    some = random.integers(0, len(places), 200)
    squared, rank = of_all_pairs(places[some], points, np.arange(3000), np.inf)
    np.testing.assert_array_equal(search.squared[some], squared)
    np.testing.assert_array_equal(search.rank[some], rank)
