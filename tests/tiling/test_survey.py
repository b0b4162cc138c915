"""A survey is the same however the map is cut and ordered."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling import survey as survey_module
from tiling.formats import PointBatch
from tiling.survey import FINEST_CELL, cells_of, merge_surveys, survey


def batches(xyz, pieces, seed=0):
    order = np.random.default_rng(seed).permutation(len(xyz))
    return [PointBatch(0, xyz[part], None) for part in np.array_split(order, pieces)]


def same(first, second):
    assert (first.point_count, first.finite_count) == (second.point_count, second.finite_count)
    np.testing.assert_array_equal(first.minimum, second.minimum)
    np.testing.assert_array_equal(first.maximum, second.maximum)
    assert first.occupancy.cell == second.occupancy.cell
    np.testing.assert_array_equal(first.occupancy.columns, second.occupancy.columns)
    np.testing.assert_array_equal(first.occupancy.counts, second.occupancy.counts)


@settings(deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 300),
    st.integers(1, 7),
    st.sampled_from([0.5, 30.0, 1e7]),
    st.sampled_from([5, 40, 10**6]),
)
def test_parts_in_any_order_give_what_the_whole_gives(seed, size, pieces, extent, most):
    random = np.random.default_rng(seed)
    xyz = random.normal(size=(size, 3)) * extent
    xyz[random.random(size) < 0.1] = np.nan
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(survey_module, "MOST_COLUMNS", most)
        whole = survey(batches(xyz, 1))
        parts = batches(xyz, pieces, seed)
        same(survey(parts), whole)
        same(merge_surveys([survey([part]) for part in reversed(parts)]), whole)
    finite = xyz[np.isfinite(xyz).all(axis=1)]
    assert len(whole.occupancy.counts) <= most
    assert whole.occupancy.counts.sum() == whole.finite_count == len(finite)
    columns, counts = np.unique(cells_of(finite, whole.occupancy.cell), axis=0, return_counts=True)
    np.testing.assert_array_equal(whole.occupancy.columns, columns.reshape(-1, 2))
    np.testing.assert_array_equal(whole.occupancy.counts, counts)


def test_cells_are_no_wider_than_they_must_be():
    xyz = np.random.default_rng(0).uniform(0, 10, (5000, 3))
    assert survey(batches(xyz, 3)).occupancy.cell == FINEST_CELL


def test_a_stray_point_costs_one_column():
    xyz = np.array([[0.0, 0, 0], [1e300, -1e300, 0], [1e9, 1e9, 1e9]])
    found = survey(batches(xyz, 2))
    assert len(found.occupancy.counts) == 3
    np.testing.assert_array_equal(found.maximum, [1e300, 1e9, 1e9])


def test_no_points():
    found = survey([])
    assert (found.point_count, found.finite_count, len(found.occupancy.counts)) == (0, 0, 0)
