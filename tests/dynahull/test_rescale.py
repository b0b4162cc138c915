"""Eq. 1, on numbers worked out by hand."""

from fractions import Fraction
from math import floor

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynahull.removal import removal_count, removal_percentages


def test_rescales_linearly_between_the_smallest_and_the_largest_cluster():
    assert removal_percentages([100, 200, 300], 5, 20) == (5, Fraction(25, 2), 20)


def test_equal_counts_all_get_the_minimum():
    assert removal_percentages([70, 70, 70], 5, 20) == (5, 5, 5)


def test_one_cluster_gets_the_minimum():
    assert removal_percentages([12_345], 5, 20) == (5,)


def test_an_empty_cluster_is_not_the_smallest():
    assert removal_percentages([0, 100, 300], 5, 20) == (0, 5, 20)


def test_no_clusters():
    assert removal_percentages([], 5, 20) == ()
    assert removal_percentages([0, 0], 5, 20) == (0, 0)


@pytest.mark.parametrize(
    ("percent", "count", "expected"), [(5, 100, 5), (5, 119, 5), (20, 14, 2), (0.1, 1000, 1)]
)
def test_the_count_is_rounded_down(percent, count, expected):
    (percentage,) = removal_percentages([count], percent, 100)
    assert removal_count(percentage, count) == expected


def test_the_count_is_exact_where_floating_point_is_not():
    (percentage,) = removal_percentages([100], 29, 100)
    assert floor(0.29 * 100) == 28
    assert removal_count(percentage, 100) == 29


@given(
    st.lists(st.integers(1, 10**9), min_size=2, max_size=20),
    st.floats(0, 50),
    st.floats(50, 100),
)
def test_agrees_with_the_formula_of_the_paper(counts, low, high):
    smallest, largest = min(counts), max(counts)
    if smallest == largest:
        return
    for count, percentage in zip(counts, removal_percentages(counts, low, high), strict=True):
        expected = (count - smallest) / (largest - smallest) * (high - low) + low
        assert float(percentage) == pytest.approx(expected, rel=1e-12, abs=1e-12)
        assert low - 1e-12 <= percentage <= high + 1e-12
