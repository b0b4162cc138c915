"""The least dense points of a cluster, against a plain sort and the paper's loop."""

from fractions import Fraction
from math import floor

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynahull.removal import STEPS_PER_SPREAD, remove_least_dense

densities = st.lists(
    st.one_of(st.floats(0.01, 1e6), st.sampled_from([1.0, 2.0, np.inf])), min_size=1, max_size=200
)
percentages = st.fractions(0, 100, max_denominator=1000)


def sorted_by_density(density, rows):
    """The plain version: sort everything, take the first."""
    return np.lexsort((rows, density))


@given(densities, percentages, st.randoms(use_true_random=False))
def test_rank_removes_exactly_the_share_of_lowest_density(values, percentage, random):
    density = np.array(values)
    rows = np.array(random.sample(range(1000), len(values)))
    finite = int(np.isfinite(density).sum())
    count = min(floor(percentage * len(values) / 100), finite)
    expected = np.zeros(len(values), bool)
    expected[sorted_by_density(density, rows)[:count]] = True

    removal = remove_least_dense(density, rows, percentage, "rank")

    np.testing.assert_array_equal(removal.dynamic, expected)
    if count:
        assert removal.threshold == density[expected].max()
    else:
        assert removal.threshold is None


def test_equally_dense_points_go_by_row_number():
    rows = np.array([40, 10, 30, 20])
    removal = remove_least_dense(np.ones(4), rows, Fraction(50), "rank")
    np.testing.assert_array_equal(removal.dynamic, [False, True, False, True])


@pytest.mark.parametrize("threshold", ["rank", "stepped"])
def test_infinitely_dense_points_are_kept_whatever_the_percentage(threshold):
    density = np.array([1.0, np.inf, 2.0, np.inf, 3.0])
    removal = remove_least_dense(density, np.arange(5), Fraction(100), threshold)
    np.testing.assert_array_equal(removal.dynamic, np.isfinite(density))


@pytest.mark.parametrize("threshold", ["rank", "stepped"])
def test_unscored_points_are_kept(threshold):
    removal = remove_least_dense(np.full(3, np.nan), np.arange(3), Fraction(100), threshold)
    assert not removal.dynamic.any()
    assert removal.threshold is None


def stepped_by_loop(density, percentage):
    """Algorithm 1 as the paper words it: raise the threshold until the share is reached."""
    finite = np.sort(density[np.isfinite(density)])
    last = len(finite) - 1
    spread = finite[3 * last // 4] - finite[last // 4] or finite[-1] - finite[0]
    step = spread / STEPS_PER_SPREAD
    number = 0
    while True:
        removed = density < number * step
        if removed.sum() >= min(percentage * len(density) / 100, len(finite)):
            return removed
        number += 1


@given(st.lists(st.floats(1, 100), min_size=4, max_size=60), percentages)
def test_stepped_is_the_loop_of_the_paper(values, percentage):
    density = np.array([*values, 1.0, 100.0])
    if len(np.unique(density)) == 1:
        return
    removal = remove_least_dense(density, np.arange(len(density)), percentage, "stepped")
    spread = np.ptp(density)
    quartiles = np.sort(density)[[(len(density) - 1) // 4, 3 * (len(density) - 1) // 4]]
    if 0 < np.ptp(quartiles) < spread * 1e-3:
        return  # the plain loop would take millions of steps
    np.testing.assert_array_equal(removal.dynamic, stepped_by_loop(density, percentage))


def test_stepped_takes_the_whole_step_and_so_may_exceed_the_share():
    density = np.concatenate([np.full(10, 1.0), np.linspace(50, 100, 90)])
    rank = remove_least_dense(density, np.arange(100), Fraction(5), "rank")
    stepped = remove_least_dense(density, np.arange(100), Fraction(5), "stepped")
    assert rank.dynamic.sum() == 5
    assert stepped.dynamic.sum() == 10
    assert stepped.threshold > 1.0


def test_stepped_finds_nothing_where_all_densities_are_equal():
    removal = remove_least_dense(np.ones(50), np.arange(50), Fraction(20), "stepped")
    assert not removal.dynamic.any()


def test_stepped_ends_where_steps_are_finer_than_rounding():
    density = np.array([1e20, 1e20, 1e20, 1e20 + 2**20, 1.0, 2.0])
    removal = remove_least_dense(density, np.arange(6), Fraction(100), "stepped")
    assert removal.dynamic.all()
