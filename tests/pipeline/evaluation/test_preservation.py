"""ERASOR's rates, against dictionaries of voxels and loops over all pairs."""

from collections import Counter, defaultdict
from math import floor, sqrt
from pathlib import Path
from tempfile import mkdtemp

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from dynahull.observer import SilentObserver
from pipeline.evaluation.scoring import compare_voxels, voxel_means
from tests.pipeline.evaluation.clouds import cut, source_of


def labels(*values):
    return np.array(values, dtype=np.int8)


anew = settings(
    deadline=None, max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture]
)


@given(st.integers(0, 2**32 - 1), st.integers(0, 80), st.sampled_from([0.2, 0.5, 3.0]))
def test_voxel_means_are_those_of_a_dictionary(seed, count, voxel):
    random = np.random.default_rng(seed)
    points = random.uniform(-1.5, 1.5, (count, 3)) + [1e3, 0, -1e3]
    cells = defaultdict(list)
    for point in points:
        cells[tuple(floor(value / voxel) for value in point)].append(point)
    expected = sorted(tuple(np.mean(cell, axis=0)) for cell in cells.values())
    found = voxel_means(points, voxel)
    assert found.shape == (len(cells), 3)
    np.testing.assert_allclose(sorted(map(tuple, found)), expected, rtol=1e-12)
    np.testing.assert_array_equal(voxel_means(random.permutation(points), voxel), found)


def test_voxels_begin_at_whole_multiples_below_zero_too():
    points = np.array([[-0.01, 0, 0], [0.01, 0, 0], [0.19, 0, 0], [0.21, 0, 0]])
    found = voxel_means(points, 0.2)
    np.testing.assert_allclose(found[:, 0], [-0.01, 0.1, 0.21])


def test_a_place_beyond_all_whole_numbers_is_a_voxel_of_its_own():
    points = np.array([[1e20, 0, 0], [1e20, 0, 0], [-1e150, 1, 0], [0.1, 0, 0]])
    found = voxel_means(points, 0.2)
    assert sorted(map(tuple, found)) == [(-1e150, 1, 0), (0.1, 0, 0), (1e20, 0, 0)]


def rates(folder, original, truth, cleaned, kept, voxel=0.2, most=1000):
    """Compare two maps of one point a voxel, or of more."""
    clouds = cut(
        folder, most, voxel,
        original=source_of(folder.with_name("original.npy"), original, truth),
        cleaned=source_of(folder.with_name("cleaned.npy"), cleaned, kept),
    )  # fmt: skip
    return compare_voxels(
        clouds["original"], clouds["cleaned"], voxel, Path(mkdtemp(dir=folder)), SilentObserver()
    )


def test_rates_counted_by_hand(tmp_path):
    original = np.array([[0.0, 0, 0], [1, 0, 0], [2, 0, 0], [3, 0, 0], [4, 0, 0], [5, 0, 0]])
    truth = labels(0, 0, 0, 1, 1, 0)
    # The first is kept; the second is met by a ghost; the third has nothing near enough (0.18 is
    # over 0.1 sqrt(3)); of those that moved one is kept, and one is near something static.
    cleaned = np.array([[0.17, 0, 0], [1, 0, 0], [2.18, 0, 0], [3.1, 0, 0], [4, 0, 0], [5, 0, 0]])
    found = rates(tmp_path / "cut", original, truth, cleaned, labels(0, 1, 0, 1, 0, 0))
    assert (found.static_voxels, found.dynamic_voxels) == (4, 2)
    assert found.preservation_rate == 50
    assert found.rejection_rate == 50
    assert found.f1 == 50


def one_a_voxel(points, truth, voxel):
    """Return the mean of each voxel and the label of the nearest point: the plain version."""
    cells = defaultdict(list)
    for point in sorted(map(tuple, points)):
        cells[tuple(floor(value / voxel) for value in point)].append(point)
    # Rounded as NumPy sums: a last bit decides between points that are nearly as near.
    sums = [np.add.reduceat(np.array(cell), [0], axis=0)[0] for cell in cells.values()]
    means = [total / len(cell) for total, cell in zip(sums, cells.values(), strict=True)]
    return means, [nearest_label(mean, points, truth)[1] for mean in means]


def nearest_label(place, points, truth):
    """Return the distance of the nearest point and its label: of several the static one."""
    squared = [(x * x + y * y) + z * z for x, y, z in points - place]
    least, label = min(zip(squared, truth, strict=True))
    return sqrt(least), label


@anew
@example(386, 50, 1, 3)
@given(st.integers(0, 2**32 - 1), st.integers(1, 60), st.integers(1, 60), st.integers(3, 200))
def test_rates_are_those_of_all_pairs_in_any_order_and_tiles(tmp_path, seed, count, others, most):
    random = np.random.default_rng(seed)
    # Tenths: two points of a voxel are often as near to its middle.
    original, cleaned = (random.integers(0, 12, (n, 3)) * 0.1 for n in (count, others))
    truth, kept = (random.integers(0, 2, n).astype(np.int8) for n in (count, others))
    voxels, preserved = Counter(), Counter()
    means, of_means = one_a_voxel(cleaned, kept, 0.2)
    for mean, label in zip(*one_a_voxel(original, truth, 0.2), strict=True):
        distance, found = nearest_label(mean, np.array(means), of_means)
        voxels[label] += 1
        preserved[label] += distance < 0.2 * sqrt(3) / 2 and found == label
    found = rates(tmp_path / "cut", original, truth, cleaned, kept, most=most)
    assert (found.static_voxels, found.dynamic_voxels) == (voxels[0], voxels[1])
    if voxels[0]:
        assert found.preservation_rate == pytest.approx(100 * preserved[0] / voxels[0])
    if voxels[1]:
        assert found.rejection_rate == pytest.approx(100 * (1 - preserved[1] / voxels[1]))
    if voxels[0] and voxels[1]:
        pr, rr = found.preservation_rate, found.rejection_rate
        assert found.f1 == pytest.approx(2 * pr * rr / (pr + rr) if pr + rr else 0)
    else:
        assert found.f1 is None
    order = random.permutation(count)
    again = rates(tmp_path / "cut", original[order], truth[order], cleaned, kept)
    assert again == found
