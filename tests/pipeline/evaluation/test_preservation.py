"""ERASOR's rates, against dictionaries of voxels and loops over all pairs."""

from collections import defaultdict
from math import floor, sqrt

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.evaluation.labels import Truth
from pipeline.evaluation.preservation import Preservation, voxel_means


def labels(*values):
    return np.array(values, dtype=np.int8)


@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 80),
    st.integers(1, 6),
    st.integers(1, 30),
    st.sampled_from([0.2, 0.5, 3.0]),
)
def test_voxel_means_are_those_of_a_dictionary(seed, count, pieces, most, voxel):
    points = np.random.default_rng(seed).uniform(-1.5, 1.5, (count, 3)) + [1e3, 0, -1e3]
    cells = defaultdict(list)
    for point in points:
        cells[tuple(floor(value / voxel) for value in point)].append(point)
    expected = sorted(tuple(np.mean(cell, axis=0)) for cell in cells.values())
    found = voxel_means(np.array_split(points, pieces), voxel, most_voxels=most)
    assert found.shape == (len(cells), 3)
    np.testing.assert_allclose(sorted(map(tuple, found)), expected, rtol=1e-12)


def test_voxels_begin_at_whole_multiples_below_zero_too():
    points = np.array([[-0.01, 0, 0], [0.01, 0, 0], [0.19, 0, 0], [0.21, 0, 0]])
    found = voxel_means([points], 0.2)
    np.testing.assert_allclose(found[:, 0], [-0.01, 0.1, 0.21])


def test_rates_counted_by_hand():
    voxel = 0.2
    original = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0], [5, 0, 0]])
    truth = labels(0, 0, 0, 1, 1, 0)
    # The first is kept; the second is met by a ghost; the third has nothing near enough (0.18 is
    # over 0.1 sqrt(3)); of those that moved one is kept, and one is near something static.
    cleaned = np.array([[0.17, 0, 0], [1, 0, 0], [2.18, 0, 0], [3.1, 0, 0], [4, 0, 0], [5, 0, 0]])
    found = Preservation.of(original, truth, cleaned, labels(0, 1, 0, 1, 0, 0), voxel)
    assert (found.static_voxels, found.dynamic_voxels) == (4, 2)
    assert found.preservation_rate == 50
    assert found.rejection_rate == 50
    assert found.f1 == 50


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 40), st.integers(1, 40))
def test_rates_are_those_of_all_pairs(seed, count, others):
    random = np.random.default_rng(seed)
    original, cleaned = random.uniform(0, 1, (count, 3)), random.uniform(0, 1, (others, 3))
    truth, kept = (random.integers(0, 2, n).astype(np.int8) for n in (count, others))
    preserved = {Truth.STATIC: 0, Truth.DYNAMIC: 0}
    for point, label in zip(original, truth, strict=True):
        distances = [sqrt(sum((point - other) ** 2)) for other in cleaned]
        nearest = int(np.argmin(distances))
        if distances[nearest] < 0.2 * sqrt(3) / 2 and kept[nearest] == label:
            preserved[Truth(label)] += 1
    found = Preservation.of(original, truth, cleaned, kept, 0.2)
    static, moved = np.count_nonzero(truth == 0), np.count_nonzero(truth == 1)
    if static:
        assert found.preservation_rate == pytest.approx(100 * preserved[Truth.STATIC] / static)
    if moved:
        rejected = 100 * (1 - preserved[Truth.DYNAMIC] / moved)
        assert found.rejection_rate == pytest.approx(rejected)
    if static and moved:
        pr, rr = found.preservation_rate, found.rejection_rate
        assert found.f1 == pytest.approx(2 * pr * rr / (pr + rr) if pr + rr else 0)
    else:
        assert found.f1 is None
