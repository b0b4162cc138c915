"""Distances between clouds, against all pairs and against cases counted by hand."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.evaluation.distances import (
    ChamferDistance,
    DirectedChamfer,
    DistanceFile,
    DistanceStatistics,
)
from pipeline.evaluation.order_statistics import order_statistics


def all_pairs(first, second):
    return np.sqrt(((first[:, np.newaxis] - second) ** 2).sum(axis=2))


def test_the_statistics_of_distances_counted_by_hand():
    found = DistanceStatistics.of([np.array([0.0, 5.0]), np.array([2.0, 1.0])])
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
    found = DistanceStatistics.of(np.array_split(distances, 3))
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
        DirectedChamfer.of(np.array_split(distances, pieces))
        for distances in (pairs.min(axis=1), pairs.min(axis=0))
    )
    found = ChamferDistance.of(there, back)
    squared = (pairs.min(axis=1) ** 2).mean() + (pairs.min(axis=0) ** 2).mean()
    assert found.squared == pytest.approx(squared)
    assert found.unsquared == pytest.approx(pairs.min(axis=1).mean() + pairs.min(axis=0).mean())
    assert found.cleaned_to_truth.squared == pytest.approx((pairs.min(axis=1) ** 2).mean())
    assert found.truth_to_cleaned.unsquared == pytest.approx(pairs.min(axis=0).mean())


@given(st.integers(0, 2**32 - 1), st.integers(1, 300), st.integers(1, 9))
def test_no_figure_depends_on_order_or_batches(seed, count, pieces):
    random = np.random.default_rng(seed)
    distances = random.exponential(size=count) * 10.0 ** random.integers(-9, 9, count)
    batches = np.array_split(random.permutation(distances), pieces)
    assert DistanceStatistics.of(batches) == DistanceStatistics.of([distances])
    assert DirectedChamfer.of(batches) == DirectedChamfer.of([distances])


@given(
    st.lists(
        st.floats(min_value=0, allow_nan=False, allow_infinity=False)
        | st.sampled_from([0.0, -0.0, 5e-324, 1.0, 1 + 2**-52]),
        min_size=1,
        max_size=40,
    ),
    st.data(),
)
def test_the_number_of_a_rank_is_that_of_a_sort(numbers, data):
    rank = data.draw(st.integers(0, len(numbers) - 1))
    batches = np.array_split(np.array(numbers), 3)
    ordered = sorted(numbers)
    following = ordered[min(rank + 1, len(numbers) - 1)]
    assert order_statistics(batches, rank) == (ordered[rank], following)


def test_a_file_gives_distances_back_in_batches(tmp_path, monkeypatch):
    monkeypatch.setattr("pipeline.evaluation.distances._AT_A_TIME", 4)
    file = DistanceFile(tmp_path / "distances")
    assert list(file) == []
    file.append(np.arange(5.0))
    file.append(np.arange(5.0, 11))
    for _ in range(2):
        assert [batch.tolist() for batch in file] == [[0, 1, 2, 3], [4, 5, 6, 7], [8, 9, 10]]
    assert DistanceFile(tmp_path / "distances").remove() is None
    assert list(tmp_path.iterdir()) == []
