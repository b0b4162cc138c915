"""The Earth Mover's Distance, against the best of all assignments."""

import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from pipeline.errors import MissingPackageError, PlanError
from pipeline.evaluation.distances import check_transport, draw_sample, transport_cost
from tests.pipeline.evaluation.clouds import cut, source_of


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.sampled_from(["euclidean", "sqeuclidean"]))
def test_between_equal_numbers_of_points_it_is_the_best_assignment(seed, count, cost):
    random = np.random.default_rng(seed)
    # As far from the origin as maps in UTM coordinates are.
    first, second = random.normal(size=(2, count, 3)) + [5e5, 6.7e6, 50]
    costs = cdist(first, second, cost)
    best = costs[linear_sum_assignment(costs)].mean()
    # POT squares coordinates about the sample's centre: digits of 1e-16 * 10 m^2, then a root.
    assert transport_cost(first, second, cost) == pytest.approx(best, rel=1e-6, abs=1e-6)


def test_one_heap_onto_two_places():
    one, two = np.zeros((1, 3)), np.array([[1.0, 0, 0], [0, 3, 0]])
    assert transport_cost(one, two, "euclidean") == pytest.approx((1 + 3) / 2)
    assert transport_cost(one, two, "sqeuclidean") == pytest.approx((1 + 9) / 2)


def test_a_sample_is_without_replacement_seeded_and_uniform(tmp_path):
    points = np.arange(300.0).reshape(100, 3)
    cloud = cut(tmp_path / "cut", 30, map=source_of(tmp_path / "map.npy", points))["map"]
    sample = draw_sample(cloud, 30, seed=4, stream=0)
    assert len(np.unique(sample, axis=0)) == 30
    assert set(map(tuple, sample)) <= set(map(tuple, points))
    np.testing.assert_array_equal(sample, draw_sample(cloud, 30, seed=4, stream=0))
    assert not np.array_equal(sample, draw_sample(cloud, 30, seed=5, stream=0))
    assert not np.array_equal(sample, draw_sample(cloud, 30, seed=4, stream=1))
    counts = sum(
        np.isin(np.arange(100), draw_sample(cloud, 30, seed, 0)[:, 0] / 3) for seed in range(400)
    )
    # Binomial of 400 draws of 0.3: mean 120, deviation 9.2; five deviations.
    assert counts.min() > 74
    assert counts.max() < 166


def test_a_small_map_is_its_own_sample(tmp_path):
    points = np.random.default_rng(0).normal(size=(7, 3))
    cloud = cut(tmp_path / "cut", map=source_of(tmp_path / "map.npy", points))["map"]
    np.testing.assert_array_equal(draw_sample(cloud, 7, 0, 0), points)


def test_samples_too_large_for_the_memory_are_refused_before_the_work(monkeypatch):
    monkeypatch.setattr("pipeline.evaluation.distances.available_memory", lambda: 1 << 30)
    check_transport(100_000, 5_000, 5_000)
    with pytest.raises(PlanError, match=r"--emd-points 100000: .* 5,060 and 5,060 .* 1\.0 GiB: c"):
        check_transport(100_000, 5_060, 5_060)
    # Two samples of the truth are moved onto each other, too; what the maps lack is not drawn.
    with pytest.raises(PlanError, match=r"of 10 and 80,000 points would take 250\.3 GiB"):
        check_transport(80_000, 10, 90_000)


def test_without_pot_one_line_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "ot", None)
    with pytest.raises(MissingPackageError, match="needs POT: pip install"):
        transport_cost(np.zeros((1, 3)), np.zeros((1, 3)), "euclidean")
