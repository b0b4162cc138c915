"""Distances between clouds, against all pairs and against cases counted by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.evaluation.distances import (
    ChamferDistance,
    DirectedChamfer,
    DistanceStatistics,
)


def all_pairs(first, second):
    return np.sqrt(((first[:, np.newaxis] - second) ** 2).sum(axis=2))


def test_the_statistics_of_distances_counted_by_hand():
    found = DistanceStatistics.of(np.array([0.0, 5.0, 2.0, 1.0]))
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
    found = DistanceStatistics.of(distances.copy())
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
    there = DirectedChamfer.of(np.array([1.0, 2.0]))
    back = DirectedChamfer.of(np.array([1.0]))
    found = ChamferDistance.of(there, back)
    assert (there.squared, there.unsquared) == (2.5, 1.5)
    assert (found.squared, found.unsquared) == (3.5, 2.5)
    assert (found.truth_to_cleaned.squared, found.truth_to_cleaned.unsquared) == (1, 1)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 50), st.integers(1, 50))
def test_chamfer_is_the_means_over_all_pairs(seed, count, others):
    random = np.random.default_rng(seed)
    cleaned, truth = random.normal(size=(count, 3)), random.normal(size=(others, 3))
    pairs = all_pairs(cleaned, truth)
    there, back = (
        DirectedChamfer.of(distances) for distances in (pairs.min(axis=1), pairs.min(axis=0))
    )
    found = ChamferDistance.of(there, back)
    squared = (pairs.min(axis=1) ** 2).mean() + (pairs.min(axis=0) ** 2).mean()
    assert found.squared == pytest.approx(squared)
    assert found.unsquared == pytest.approx(pairs.min(axis=1).mean() + pairs.min(axis=0).mean())
    assert found.cleaned_to_truth.squared == pytest.approx((pairs.min(axis=1) ** 2).mean())
    assert found.truth_to_cleaned.unsquared == pytest.approx(pairs.min(axis=0).mean())


@given(st.integers(0, 2**32 - 1), st.integers(1, 300))
def test_no_figure_depends_on_order(seed, count):
    random = np.random.default_rng(seed)
    distances = random.exponential(size=count) * 10.0 ** random.integers(-9, 9, count)
    shuffled = random.permutation(distances)
    assert DistanceStatistics.of(shuffled) == DistanceStatistics.of(distances)
    assert DirectedChamfer.of(shuffled) == DirectedChamfer.of(distances)
