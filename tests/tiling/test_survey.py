"""A survey is the same however the map is cut and ordered."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tiling.collection import MapCollection
from tiling.formats import PointBatch
from tiling.survey import FINEST_CELL, Survey, columns_of, merge, survey, survey_batches


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
    st.sampled_from([0.5, 30.0, 1e7, 1e13]),
    st.sampled_from([5, 40, 10**6]),
)
def test_parts_in_any_order_give_what_the_whole_gives(seed, size, pieces, extent, most):
    random = np.random.default_rng(seed)
    xyz = random.normal(size=(size, 3)) * extent
    xyz[random.random(size) < 0.1] = np.nan
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("tiling.survey.MOST_COLUMNS", most)
        whole = survey_batches(batches(xyz, 1))
        parts = batches(xyz, pieces, seed)
        same(survey_batches(parts), whole)
        same(merge([survey_batches([part]) for part in reversed(parts)]), whole)
    finite = xyz[np.isfinite(xyz).all(axis=1)]
    assert len(whole.occupancy.counts) <= most
    assert whole.occupancy.counts.sum() == whole.finite_count == len(finite)
    columns, counts = np.unique(
        columns_of(finite, whole.occupancy.cell), axis=0, return_counts=True
    )
    np.testing.assert_array_equal(whole.occupancy.columns, columns.reshape(-1, 2))
    np.testing.assert_array_equal(whole.occupancy.counts, counts)
    if whole.occupancy.cell > FINEST_CELL:
        finer = columns_of(finite, whole.occupancy.cell / 2)
        assert len(np.unique(finer, axis=0)) > most
    if len(finite):
        np.testing.assert_array_equal(whole.minimum, finite.min(axis=0))
        np.testing.assert_array_equal(whole.maximum, finite.max(axis=0))


def test_cells_are_no_wider_than_they_must_be():
    xyz = np.random.default_rng(0).uniform(0, 10, (5000, 3))
    assert survey_batches(batches(xyz, 3)).occupancy.cell == FINEST_CELL


def test_columns_are_floors_also_below_zero_and_on_borders():
    xyz = np.array([[-0.25, 0.25, 0], [-0.3, 0.2499, 0], [1e7 + 0.3, -0.0, 0]])
    np.testing.assert_array_equal(columns_of(xyz, 0.25), [[-1, 1], [-2, 0], [40_000_001, 0]])
    assert len(survey_batches(batches(xyz, 1)).occupancy.counts) == 3


def test_a_stray_point_costs_one_column():
    xyz = np.array([[0.0, 0, 0], [1e300, -1e300, 0], [1e9, 1e9, 1e9]])
    found = survey_batches(batches(xyz, 2))
    assert len(found.occupancy.counts) == 3
    np.testing.assert_array_equal(found.maximum, [1e300, 1e9, 1e9])


def test_no_points():
    found = survey_batches([])
    assert (found.point_count, found.finite_count, len(found.occupancy.counts)) == (0, 0, 0)
    same(merge([]), found)


def test_rows_of_a_map_merge_into_the_whole(tmp_path):
    xyz = np.random.default_rng(1).normal(size=(1000, 3)) * 20
    np.save(tmp_path / "a.npy", xyz[:300])
    np.save(tmp_path / "b.npy", xyz[300:])
    collection = MapCollection([tmp_path / "a.npy", tmp_path / "b.npy"])
    whole = survey(collection)
    same(whole, survey_batches(batches(xyz, 1)))
    same(merge(survey(collection, rows) for rows in collection.row_ranges(170)), whole)


def test_a_survey_goes_through_a_file(tmp_path):
    found = survey_batches(batches(np.random.default_rng(1).normal(size=(100, 3)), 1))
    np.savez(tmp_path / "survey.npz", **found.to_arrays())
    with np.load(tmp_path / "survey.npz") as arrays:
        same(Survey.from_arrays(**arrays), found)
