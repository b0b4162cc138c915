"""Counts of right and wrong decisions, against loops over the points."""

from math import sqrt

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pipeline.evaluation.scoring import Confusion, DynamicMapAccuracy, Tally, harmonic_mean
from pipeline.evaluation.truth import Truth

STATIC, DYNAMIC, UNKNOWN = (np.int8(each) for each in (Truth.STATIC, Truth.DYNAMIC, Truth.UNKNOWN))
points = st.lists(
    st.tuples(st.sampled_from([STATIC, DYNAMIC, UNKNOWN]), st.booleans()), max_size=60
)


def columns(pairs):
    return (
        np.array([pair[0] for pair in pairs], dtype=np.int8),
        np.array([pair[1] for pair in pairs], dtype=bool),
    )


def test_ten_points_counted_by_hand():
    # Of 5 static points 2 are removed, of 3 that moved 2 are; 2 are not labelled.
    labels = np.array([0, 0, 0, 0, 0, 1, 1, 1, 2, 2], dtype=np.int8)
    removed = np.array([1, 1, 0, 0, 0, 1, 1, 0, 1, 0], dtype=bool)
    found = Confusion.of(Tally().add(labels, removed))
    assert (found.true_positives, found.false_positives) == (2, 2)
    assert (found.false_negatives, found.true_negatives) == (1, 3)
    assert found.false_positive_percent == pytest.approx(40)
    assert found.false_negative_percent == pytest.approx(100 / 3)
    assert found.false_positive_percent_of_all == pytest.approx(25)
    assert found.false_negative_percent_of_all == pytest.approx(12.5)
    assert found.precision == pytest.approx(50)
    assert found.recall == pytest.approx(200 / 3)
    assert found.f1 == pytest.approx(2 * 50 * (200 / 3) / (50 + 200 / 3))


@given(points)
def test_the_counts_are_those_of_a_loop(pairs):
    tally = Tally()
    for part in np.array_split(np.arange(len(pairs)), 3):
        labels, removed = columns(pairs)
        tally.add(labels[part], removed[part])
    found = Confusion.of(tally)
    assert found.true_positives == pairs.count((DYNAMIC, True))
    assert found.false_positives == pairs.count((STATIC, True))
    assert found.false_negatives == pairs.count((DYNAMIC, False))
    assert found.true_negatives == pairs.count((STATIC, False))
    moved = found.true_positives + found.false_negatives
    assert (found.recall is None) == (moved == 0)
    if moved:
        assert found.recall + found.false_negative_percent == pytest.approx(100)


def test_shares_of_nothing_are_undefined():
    found = Confusion.of(Tally().add(np.array([0], dtype=np.int8), np.array([False])))
    assert found.precision is None
    assert found.recall is None
    assert found.f1 is None
    assert found.false_positive_percent == 0
    assert harmonic_mean(0.0, 0.0) == 0


def test_the_benchmark_s_accuracies_counted_by_hand():
    # 3 of 4 static points are matched, 4 of 5 that moved are not.
    labels = np.array([0, 0, 0, 0, 1, 1, 1, 1, 1, 2], dtype=np.int8)
    matched = np.array([1, 1, 1, 0, 1, 0, 0, 0, 0, 1], dtype=bool)
    found = DynamicMapAccuracy.of(Tally().add(labels, matched), 0.05)
    assert found.static_accuracy == 75
    assert found.dynamic_accuracy == 80
    assert found.associated_accuracy == pytest.approx(sqrt(75 * 80))
    assert found.harmonic_accuracy == pytest.approx(2 * 75 * 80 / 155)


@given(points)
def test_the_benchmark_s_accuracies_are_those_of_a_loop(pairs):
    found = DynamicMapAccuracy.of(Tally().add(*columns(pairs)), 0.05)
    kept = [matched for label, matched in pairs if label == STATIC]
    gone = [not matched for label, matched in pairs if label == DYNAMIC]
    if not kept or not gone:
        assert found.associated_accuracy is None
        assert found.harmonic_accuracy is None
        return
    sa, da = 100 * sum(kept) / len(kept), 100 * sum(gone) / len(gone)
    assert found.static_accuracy == pytest.approx(sa)
    assert found.dynamic_accuracy == pytest.approx(da)
    assert found.associated_accuracy == pytest.approx(sqrt(sa * da))
    assert found.harmonic_accuracy == pytest.approx(2 * sa * da / (sa + da) if sa + da else 0)
