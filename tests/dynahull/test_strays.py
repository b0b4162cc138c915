"""Invalid returns at the origin and a handful of far strays change nothing about the others."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynahull import Label, clean
from dynahull.removal import removal_percentages, smallest_counted
from dynahull.strays import HEAP, OUTSKIRTS_NAMES, Outskirts
from tests.listener import Listener

FAST = {"ground": {"method": "none"}, "neighbours": {"k": 20}, "clustering": {"count": 3}}


def room(seed=0, count=1500):
    random = np.random.default_rng(seed)
    wall = random.uniform(size=(count, 3)) * [6, 0.03, 2.5] + [1, 1, 0]
    ghost = random.uniform(size=(count // 10, 3)) * [4, 1.5, 1.8] + [2, 3, 0]
    return np.vstack([wall, ghost])


def with_points(points, more):
    """Put more points among others, at the same places each time; return also where they are."""
    places = np.random.default_rng(1).integers(0, len(points), len(more))
    mixed = np.insert(points, places, more, axis=0)
    added = np.insert(np.zeros(len(points), bool), places, True)
    return mixed, added


STRAYS = {
    "one": [[1e6, 0, 0]],
    "four": [[4e6, 0, 0], [0, -3e6, 1], [1, 2, 5e5], [-2e9, 3e9, 0]],
    "together": [[9e3, 9e3, 9e3]] * 9,
    "below": [[3, 3, -800.0]],
    "absurdly far": [[1e140, 0, 0], [0, -1e149, 3]],
}


@pytest.mark.parametrize("kind", STRAYS)
def test_strays_are_unscored_and_the_others_are_as_without_them(kind):
    points = room()
    mixed, added = with_points(points, np.array(STRAYS[kind], float))
    listener = Listener()
    result, alone = clean(mixed, FAST, observer=listener), clean(points, FAST)
    np.testing.assert_array_equal(result.labels[~added], alone.labels)
    np.testing.assert_array_equal(result.density[~added], alone.density)
    assert result.removal_percentages.tolist() == alone.removal_percentages.tolist()
    assert (result.labels[added] == Label.UNSCORED).all()
    (warning,) = listener.warnings
    assert "farther from the rest of the map" in warning


def test_a_heap_at_the_origin_is_invalid_and_the_others_are_as_without_it():
    points = room()
    mixed, added = with_points(points, np.zeros((700, 3)) * [1, -1, 1])
    listener = Listener()
    result, alone = clean(mixed, FAST, observer=listener), clean(points, FAST)
    np.testing.assert_array_equal(result.labels[~added], alone.labels)
    assert (result.labels[added] == Label.INVALID).all()
    (warning,) = listener.warnings
    assert "700 points lie at exactly (0, 0, 0)" in warning


@pytest.mark.parametrize("count", [1, HEAP])
def test_a_few_points_at_the_origin_are_points(count):
    points = np.vstack([room() - [2, 1.01, 1], np.zeros((count, 3))])
    result = clean(points, FAST)
    assert set(result.labels[-count:]) <= {Label.STATIC, Label.DYNAMIC}


def test_a_map_of_nothing_but_the_origin_is_kept():
    result = clean(np.zeros((5000, 3)), FAST)
    assert result.kept.all()
    assert result.density.shape == (5000,)


def test_a_few_points_at_the_origin_of_a_map_far_away_are_strays():
    result = clean(np.vstack([room() + [5e5, 5e6, 0], np.zeros((3, 3))]), FAST)
    assert (result.labels[-3:] == Label.UNSCORED).all()


def test_a_building_far_away_is_no_stray():
    points = np.vstack([room(), room(1, 300) + [1e4, 0, 0]])
    assert Label.UNSCORED not in clean(points, FAST).labels


def test_what_is_far_within_the_maps_own_scale_is_no_stray():
    points = np.vstack([room(), [[40, 0, 0], [0, 50, 0]]])
    assert Label.UNSCORED not in clean(points, FAST).labels


@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.integers(4, 40))
def test_the_verdict_does_not_depend_on_how_the_map_is_cut(seed, parts, k):
    random = np.random.default_rng(seed)
    points = np.round(random.normal(size=(random.integers(1, 900), 3)), 1)
    far = random.random(len(points)) < 0.01
    points[far] *= 10 ** random.uniform(1, 7, (int(far.sum()), 3))
    points[random.random(len(points)) < random.choice([0, 0.01, 0.3])] = 0
    chosen = random.random(len(points)) < 0.9
    whole = Outskirts(k)
    whole.add(points, chosen=chosen)
    merged = Outskirts(k)
    bounds = np.sort(random.integers(0, len(points) + 1, parts - 1)).tolist()
    pairs = list(zip([0, *bounds], [*bounds, len(points)], strict=True))
    for start, end in random.permutation(pairs).tolist():
        part = Outskirts(k)
        part.add(points[start:end], start, chosen[start:end])
        arrays = part.to_arrays()
        merged.merge(Outskirts.from_arrays(*(arrays[name] for name in OUTSKIRTS_NAMES)))
    one, other = whole.strays(), merged.strays()
    assert (one.heap, one.at_origin) == (other.heap, other.at_origin)
    for name in ("rows", "points", "low", "high"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))
    inside = ((points >= one.low) & (points <= one.high)).all(axis=1)
    np.testing.assert_array_equal(np.flatnonzero(chosen & ~inside), one.rows)


def test_a_cluster_of_fewer_points_than_k_is_not_the_smallest_one():
    assert removal_percentages([4, 100, 300], 5, 20, 75) == (5, 5, 20)
    assert removal_percentages([0, 74, 75, 76], 5, 20, 75) == (0, 5, 5, 20)
    assert removal_percentages([4, 10], 5, 20, 75) == (5, 20)
    assert smallest_counted([4, 100, 300], 75) == 100


def test_what_is_left_out_is_unscored_and_the_others_are_as_without_it():
    points = room()
    noise = np.random.default_rng(2).uniform(size=(300, 3)) * [20, 20, 9]
    mixed, added = with_points(points, noise)
    result, alone = clean(mixed, FAST, left_out=added), clean(points, FAST)
    np.testing.assert_array_equal(result.labels[~added], alone.labels)
    assert (result.labels[added] == Label.UNSCORED).all()
    assert (result.cluster[added] == -1).all()
