"""The cuts found over tiles are those of the whole array, to the last bit and row."""

from fractions import Fraction
from unittest.mock import patch

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahull.removal import remove_least_dense
from pipeline.tiles import thresholds
from pipeline.tiles.thresholds import find_cuts, order_statistic


class Tile:
    """Points of one tile, in no particular order."""

    def __init__(self, cluster, density, rows):
        self.cluster, self.density, self.rows = cluster, density, rows

    def densities(self, cluster):
        return self.density[self.cluster == cluster]

    def rows_at(self, cluster, density):
        return self.rows[(self.cluster == cluster) & (self.density == density)]


def tiles_of(cluster, density, rows, pieces, seed):
    order = np.random.default_rng(seed).permutation(len(rows))
    return [
        Tile(cluster[part], density[part], rows[part]) for part in np.array_split(order, pieces)
    ]


@settings(deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 300),
    st.integers(1, 5),
    st.integers(1, 12),
    st.sampled_from(["scattered", "tied", "wide"]),
    st.sampled_from(["rank", "stepped"]),
    st.sampled_from([1, 3, 1 << 40]),
    st.sampled_from([0, 20, 300]),
)
def test_cuts_over_tiles_remove_what_removal_on_the_array_removes(
    seed, size, count, pieces, kind, threshold, spacing, few
):
    random = np.random.default_rng(seed)
    density = {
        "scattered": lambda: random.uniform(1, 100, size),
        "tied": lambda: random.integers(1, 4, size) * 0.1,
        "wide": lambda: 10.0 ** random.uniform(-30, 30, size),
    }[kind]()
    density[random.random(size) < 0.1] = np.inf
    density[random.random(size) < 0.05] = np.nan
    cluster = random.integers(0, count, size).astype(np.int32)
    rows = random.permutation(10 * size)[:size].astype(np.int64) * spacing
    counts = np.bincount(cluster, minlength=count)
    percentages = [Fraction(int(share), 10) for share in random.integers(0, 1001, count)]

    tiles = tiles_of(cluster, density, rows, pieces, seed)
    with patch.object(thresholds, "_FEW", few):
        cuts = find_cuts(tiles, counts, percentages, threshold)

    for index, cut in enumerate(cuts):
        members = cluster == index
        if not members.any():
            assert cut.density is None
            continue
        expected = remove_least_dense(
            density[members], rows[members], percentages[index], threshold
        )
        dynamic = cut.dynamic(density[members], rows[members])
        np.testing.assert_array_equal(dynamic, expected.dynamic)
        assert cut.density == expected.threshold


@pytest.mark.parametrize("threshold", ["rank", "stepped"])
def test_no_tiles_and_no_clusters(threshold):
    assert find_cuts([], [], [], threshold) == []
    assert find_cuts([], [0], [Fraction(0)], threshold)[0].density is None


@given(
    st.lists(
        st.floats(min_value=0, allow_nan=False, allow_infinity=False)
        | st.sampled_from([0.0, -0.0, 5e-324, 1.0, 1 + 2**-52]),
        min_size=1,
        max_size=40,
    ),
    st.data(),
)
@settings(deadline=None)
def test_the_number_of_a_rank_is_that_of_a_sort(numbers, data):
    rank = data.draw(st.integers(0, len(numbers) - 1))
    batches = np.array_split(np.array(numbers), 3)
    with patch.object(thresholds, "_FEW", data.draw(st.sampled_from([0, 5, 40]))):
        assert order_statistic(batches, rank) == sorted(numbers)[rank]
