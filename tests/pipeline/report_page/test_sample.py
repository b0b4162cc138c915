import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahull.evidence.range_images import PIXELS, Views
from dynahull.labels import Label
from pipeline.outputs import map_sample as sample_module
from pipeline.outputs.map_sample import MapSample, is_sampled, sampled_rows


def whole_map(count: int) -> MapSample:
    rng = np.random.default_rng(0)
    return MapSample.of_map(
        rng.normal(size=(count, 3)),
        rng.integers(0, 5, count).astype(np.uint8),
        rng.integers(-1, 5, count).astype(np.int32),
        rng.uniform(size=count),
        rng.uniform(size=count).astype(np.float32),
    )


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 5_000_000))
def test_the_sample_is_of_distinct_rows_of_the_map_and_never_too_large(total):
    rows = sampled_rows(total)
    most = sample_module.MOST_POINTS
    assert min(total, 0.98 * most) <= len(rows) <= most
    assert (np.diff(rows) > 0).all()
    assert not len(rows) or (rows[0] >= 0 and rows[-1] < total)


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 10**7), st.integers(0, 2**32))
def test_parts_of_a_map_know_which_of_their_rows_are_sampled(total, seed):
    rows = np.random.default_rng(seed).integers(0, total, 1_000)
    assert (is_sampled(rows, total) == np.isin(rows, sampled_rows(total))).all()


def test_a_period_in_the_recording_is_not_mistaken_for_the_map():
    # 64 beams, one after the other: every beam has its share of a sample of one in ten.
    beams = np.bincount(sampled_rows(3_000_000) % 64, minlength=64)
    assert beams.min() > 0.9 * beams.mean() and beams.max() < 1.1 * beams.mean()


def test_the_sample_of_all_parts_is_the_sample_of_the_map(monkeypatch):
    monkeypatch.setattr(sample_module, "MOST_POINTS", 500)
    whole = whole_map(10_000)
    parts = np.random.default_rng(1).integers(0, 4, len(whole))
    names = ("rows", "xyz", "labels", "cluster", "density", "score")
    cut = [
        MapSample(10_000, *(getattr(whole, name)[parts == part] for name in names))
        for part in (2, 0, 3, 1)
    ]
    together = MapSample.of_parts(10_000, cut)
    assert 300 < len(together) <= 500
    for name in names:
        np.testing.assert_array_equal(getattr(together, name), getattr(whole, name))


def test_scans_meet_a_place_or_see_through_it():
    near, at, far = (np.full((1, PIXELS), range_, np.uint16) for range_ in (200, 500, 900))
    images = np.concatenate([far, near, at, far])
    places = np.array([[5.0, 0.05, 0.05], [0.05, 1.0, 0.05], [5.04, 0.06, 0.01]])
    sample = MapSample.of_parts(
        3,
        [MapSample(3, np.arange(3), places, np.zeros(3, np.uint8), np.zeros(3, np.int32),
                   np.ones(3), np.ones(3, np.float32))],
    )  # fmt: skip
    scan = np.array([3, -1, 0], np.int32)
    seen = sample.seen(scan, Views(np.full((4, 3), 0.05), lambda rows: images[rows]))
    assert seen.scan.tolist() == [3, -1, 0]
    assert seen.through.tolist() == [2, 4, 2]
    assert seen.met.tolist() == [1, 0, 1]
    unposed = sample.seen(scan, None)
    assert (unposed.scan.tolist(), unposed.met, unposed.through) == ([3, -1, 0], None, None)


def test_invalid_points_are_not_shown():
    points = np.zeros((3, 3))
    points[1] = np.nan
    labels = np.array([Label.STATIC, Label.INVALID, Label.DYNAMIC], np.uint8)
    scores = np.full(3, 0.5, np.float32)
    sample = MapSample.of_map(points, labels, np.zeros(3, np.int32), np.ones(3), scores)
    assert sample.rows.tolist() == [0, 2]
    assert sample.total == 3
    part = MapSample(3, np.arange(3), points, labels, labels, np.ones(3), scores)
    parts = MapSample.of_parts(3, [part])
    assert parts.rows.tolist() == [0, 2]


@pytest.mark.parametrize("total", [0, 1])
def test_maps_of_next_to_nothing(total):
    assert len(MapSample.of_parts(total, [])) == 0
    assert is_sampled(np.arange(total), total).all()
