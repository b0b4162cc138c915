"""The evidence: sums that do not depend on how a map is cut, and terms that follow from them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from dynahull import Label, clean
from dynahull.density import reference_spreads
from dynahull.evidence.model import (
    MODELS,
    POOLED_TERMS,
    evidence_model,
    pooled_terms,
)
from dynahull.evidence.reasons import NO_REASON, REASONS, _reason_of
from dynahull.evidence.shapes import moments_of, shapes_of
from dynahull.evidence.summaries import (
    FINEST,
    REACH,
    SCORED,
    ScoredPoints,
    TimedVoxels,
    about_middles,
    around,
    summarise_ground,
    summarise_odds,
    summarise_points,
)
from dynahull.evidence.surroundings import Surroundings, _columns
from dynahull.evidence.terms import FALLING, RISING, TERMS, TIMED_TERMS, evidence, places_of
from dynahull.evidence.visits import marks_of, scan_counts
from dynahull.evidence.voxels import Voxels, cells_of
from dynahull.kernels import hull_densities

K = 12


def scene(count, seed, size=(6.0, 5.0, 2.0)):
    """Scored points of a map, and points of its ground."""
    random = np.random.default_rng(seed)
    xyz = np.concatenate(
        [
            random.uniform(size=(count, 3)) * size,
            random.uniform(size=(count, 3)) * [size[0], 0.02, size[2]],
        ]
    )
    xyz = random.permutation(xyz) + [652_345.5, 5_401_234.25, 431.125]
    found = hull_densities(xyz, np.arange(len(xyz)), K, spread=True)
    height = np.where(random.random(len(xyz)) < 0.9, xyz[:, 2] - 431.1, np.nan)
    ground = random.uniform(size=(count, 3)) * [*size[:2], 0.02] + [652_345.5, 5_401_234.25, 431.1]
    return ScoredPoints(xyz, found.density, found.spread, height), ground


@given(
    arrays.arrays(np.float64, (40, 3), elements=st.floats(-1e7, 1e7)),
    st.integers(0, 40),
)
@settings(deadline=None)
def test_voxels_of_parts_add_up_to_those_of_the_whole(points, cut):
    values = np.arange(80, dtype=np.int64).reshape(40, 2)
    cells = cells_of(points, FINEST)
    whole = Voxels.of(cells, values)
    parts = Voxels.merged(
        [Voxels.of(cells[cut:], values[cut:]), Voxels.of(cells[:cut], values[:cut])]
    )
    assert as_dictionary(parts) == as_dictionary(whole)
    assert whole.sums.sum(axis=0).tolist() == values.sum(axis=0).tolist()
    for one, other in zip(cells_of(points, FINEST), points, strict=True):
        assert (np.floor(other / FINEST) == one).all()


@given(arrays.arrays(np.int32, 60, elements=st.integers(-1, 500)), st.integers(0, 60))
@settings(deadline=None)
def test_marks_of_parts_are_united_to_those_of_the_whole(scan, cut):
    cells = np.zeros((60, 3), np.int32)
    cells[:, 0] = np.arange(60) % 3
    values = np.column_stack([np.ones(60, np.int64), marks_of(scan)])
    whole = TimedVoxels.of(cells, values)
    parts = [TimedVoxels.of(cells[own], values[own]) for own in (slice(cut, 60), slice(cut))]
    assert as_dictionary(Voxels.merged(parts)) == as_dictionary(whole)
    coarser, _ = whole.coarser()
    together = np.bitwise_or.reduce(values[:, 1:], axis=0).tolist()
    assert np.bitwise_or.reduce(coarser.sums[:, 1:], axis=0).tolist() == together
    middle = [tuple(cell) for cell in whole.cells.tolist()].index((1, 0, 0))
    assert whole.around()[middle, 1:].tolist() == together


@pytest.mark.parametrize("count", [1, 3, 10, 40, 100])
def test_marks_tell_how_many_scans_there_were(count):
    scan = np.arange(1_000, 1_000 + 7 * count, 7, dtype=np.int32)
    marks = np.bitwise_or.reduce(marks_of(np.repeat(scan, 5)), axis=0)[None]
    assert 2.0 ** scan_counts(marks)[0, 0] == pytest.approx(count, rel=0.25)
    assert np.isnan(scan_counts(marks_of(np.array([-1], np.int32)))).all()


def test_a_place_seen_in_passing_is_told_from_one_seen_again_and_again():
    random = np.random.default_rng(0)
    points, _ = scene(3_000, 3)
    passing = points.xyz[:, 0] - 652_345.5 < 1.0
    scan = np.where(passing, 7, random.integers(0, 40, len(points))).astype(np.int32)
    timed = replace(points, scan=scan)
    terms = evidence(timed, K, Surroundings.of(summarise_points(timed)))
    own, more = (terms[:, TIMED_TERMS.index(name)] for name in ("scans_1_0.3", "scans_1_4.8"))
    inside = points.xyz[:, 0] - 652_345.5 < 0.7
    assert own[inside].max() < 0.1 and np.median(own[~passing]) > 1.5
    assert np.median(more[inside]) > 3.0 > np.median(more[~passing])
    known = evidence(points, K, Surroundings.of(summarise_points(points)))
    np.testing.assert_array_equal(known, terms[:, : len(TERMS)])  # without scans: the same bits


def as_dictionary(voxels):
    return {tuple(cell): tuple(sums) for cell, sums in zip(voxels.cells, voxels.sums, strict=True)}


@pytest.mark.parametrize("farthest", [4, 2**30])
def test_sums_around_a_voxel_are_those_of_its_27(farthest):
    random = np.random.default_rng(0)
    cells = random.integers(-4, 4, (200, 3)).astype(np.int32)
    cells[:50] += np.int32(farthest - 4)
    voxels = Voxels.of(cells, np.ones((200, 1), np.int64))
    wanted = random.random(len(voxels)) < 0.5
    assert voxels.cells.tolist() == [list(cell) for cell in sorted(set(map(tuple, cells.tolist())))]
    some = voxels.around(wanted)[:, 0]
    for cell, total, asked, found in zip(
        voxels.cells.astype(np.int64), voxels.around()[:, 0], wanted, some, strict=True
    ):
        assert total == (np.abs(cells - cell).max(axis=1) <= 1).sum()
        assert found == (total if asked else 0)


def test_columns_tell_of_runs_and_gaps_above_and_below():
    occupied = {0, 1, 2, 5, 6, 14, 19, 40}
    cells = np.array([(x, y, z) for x in (0, 1) for y in (-1, 7) for z in occupied], np.int32)
    voxels = Voxels.of(cells, np.ones((len(cells), 1), np.int64))
    found = dict(zip(map(tuple, voxels.cells.tolist()), _columns(voxels.cells), strict=True))
    for (_, _, z), columns in found.items():
        for step, told in ((1, columns[:3]), (-1, columns[3:])):
            is_there = [z + step * away in occupied for away in range(1, 17)]
            run = next((away for away, there in enumerate(is_there) if not there), 16)
            after = [away for away, there in enumerate(is_there) if there and away > run]
            assert told.tolist() == [run, after[0] - run if after else 16, sum(is_there)]


def test_cells_beyond_all_bounds_are_one():
    cells = cells_of(np.array([[1e150, -1e150, 0.0]]), FINEST)
    assert cells.tolist() == [[2**30, -(2**30), 0]]


@pytest.mark.parametrize("offset", [0.0, 5_401_234.25, -5e7])
def test_the_shape_of_a_box_is_that_of_its_covariance(offset):
    random = np.random.default_rng(1)
    points = random.normal(size=(500, 3)) * [0.02, 0.05, 0.004] + offset + 0.15
    values = np.column_stack([np.ones(500, np.int64), moments_of(points)])
    voxels = Voxels.of(cells_of(points, FINEST), values)
    shapes = shapes_of(voxels.cells, voxels.around(), 0, 1, FINEST)
    for cell, shape in zip(voxels.cells, shapes, strict=True):
        near = np.abs(cells_of(points, FINEST) - cell).max(axis=1) <= 1
        if near.sum() < 5:
            assert np.isnan(shape).all()
            continue
        rounded = np.rint(points[near] / 0.001) - np.rint(offset / 0.001)
        values, axes = np.linalg.eigh(np.cov(rounded.T, bias=True))
        spread = np.sqrt(values + 0.25)
        assert shape[0] == pytest.approx(np.log2(spread[0] / 100), abs=1e-3)
        assert shape[1] == pytest.approx(np.log2(spread[0] / spread[1]), abs=1e-3)
        assert shape[2] == pytest.approx(np.log2(spread[1] / spread[2]), abs=1e-3)
        assert shape[3] == pytest.approx(abs(axes[2, 0]), abs=1e-3)


@given(
    arrays.arrays(np.float64, (40, 3), elements=st.one_of(st.floats(-9, 9), st.floats())),
    st.sampled_from([0.0, 5_401_234.25, -3e8]),
)
@settings(deadline=None)
def test_moments_about_the_middles_of_voxels_are_small_and_go_back(points, offset):
    points = np.nan_to_num(points) + offset
    unknown = np.full((len(points), 5), np.nan, np.float32)
    scored = ScoredPoints(points, np.ones(len(points)), unknown, unknown[:, 0])
    voxels = summarise_points(scored)
    moved = about_middles(voxels)
    assert as_dictionary(about_middles(moved, -1)) == as_dictionary(voxels)
    near = (np.abs(voxels.cells) < 2**29).all(axis=1)
    assert (np.abs(moved.sums[near, 4:7]) <= 51 * moved.sums[near, SCORED, None]).all()
    assert (np.abs(moved.sums[near, 7:13]) <= 51**2 * moved.sums[near, SCORED, None]).all()


def test_the_compiled_spread_is_that_of_the_plain_version():
    points, _ = scene(300, 2)
    plain = reference_spreads(points.xyz, np.arange(len(points)), K)
    np.testing.assert_allclose(points.spread, plain, rtol=2e-4, atol=2e-6)


def test_terms_do_not_depend_on_how_the_map_is_cut():
    points, ground = scene(1500, 3, size=(16.0, 14.0, 2.0))
    whole = evidence(
        points,
        K,
        Surroundings.of(Voxels.merged([summarise_points(points), summarise_ground(ground)])),
    )
    low = points.xyz[:, :2].min(axis=0) + [4.0, 3.0]
    high = low + [5.0, 4.0]
    halves = np.arange(len(points)) % 2 == 0
    parts = [
        summarise_points(points.part(halves)),
        summarise_ground(ground),
        summarise_points(points.part(~halves)),
    ]
    near = Voxels.merged([around(part, low, high) for part in parts])
    assert len(near) < len(Voxels.merged(parts))
    inside = ((points.xyz[:, :2] >= low) & (points.xyz[:, :2] < high)).all(axis=1)
    assert inside.sum() > 100
    cut = evidence(points.part(inside), K, Surroundings.of(near))
    assert cut.tobytes() == whole[inside].tobytes()
    assert cut.shape[1] == len(TERMS)


def test_nothing_beyond_the_reach_decides():
    points, ground = scene(1500, 4, size=(16.0, 14.0, 2.0))
    voxels = Voxels.merged([summarise_points(points), summarise_ground(ground)])
    one = points.part(slice(0, 1))
    away = np.abs((voxels.cells[:, :2] + 0.5) * FINEST - one.xyz[:, :2]).max(axis=1)
    near = Voxels(voxels.cells[away <= REACH + FINEST], voxels.sums[away <= REACH + FINEST])
    assert len(near) < len(voxels)
    alone = evidence(one, K, Surroundings.of(near))
    assert alone.tobytes() == evidence(one, K, Surroundings.of(voxels)).tobytes()


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize(("names", "sign"), [(RISING, 1), (FALLING, -1)])
def test_the_model_keeps_to_what_physics_says(names, sign, name):
    """What is less flat is never less likely a ghost; what is denser or higher never more."""
    first = evidence_model(name).first
    terms = np.random.default_rng(0).normal(size=(300, len(first.terms))).astype(np.float32)
    middle = float(np.median(first.quick.log_odds(terms)))
    first = replace(first, doubtful=middle)  # so that many points are, and many are not
    if first.dense is not None:  # and half of them among dense surroundings
        terms[::2, first.dense.column] = first.dense.limit + 1
    for term in set(names) & set(first.terms):
        low, high = terms.copy(), terms.copy()
        low[:, first.terms.index(term)], high[:, first.terms.index(term)] = -2.0, 2.0
        assert (sign * (first.log_odds(high) - first.log_odds(low)) >= -1e-4).all()


def test_pooled_odds_are_means_over_boxes():
    points, _ = scene(400, 5)
    odds = np.random.default_rng(6).normal(size=len(points)).astype(np.float32) * 12
    cells, summed = cells_of(points.xyz, FINEST), summarise_odds(points.xyz, odds)
    pooled = pooled_terms(summed).take(places_of(cells, summed.cells, summed.table), axis=0)
    clipped = np.rint(np.clip(odds, -8, 8).astype(np.float64) * 256) / 256
    for query in range(0, len(points), 97):
        for level in range(5):
            near = np.abs((cells >> level) - (cells[query] >> level)).max(axis=1) <= 1
            mean, likely = (
                POOLED_TERMS.index(f"{name}_{0.3 * 2**level:.1f}") for name in ("pooled", "likely")
            )
            assert pooled[query, mean] == pytest.approx(clipped[near].mean(), abs=1e-4)
            assert pooled[query, likely] == pytest.approx((odds[near] > 0).mean(), abs=1e-6)


def test_every_term_has_its_reason():
    assert len({_reason_of(term) for term in TIMED_TERMS}) == len(REASONS)


def test_threads_change_nothing_about_a_score():
    points, ground = scene(3000, 7)
    voxels = Voxels.merged([summarise_points(points), summarise_ground(ground)])
    model, surroundings = evidence_model(), Surroundings.of(voxels)
    one, two = (model.first_round(points, K, surroundings, threads) for threads in (1, 2))
    assert one.log_odds.tobytes() == two.log_odds.tobytes()
    odds = summarise_odds(points.xyz, one.log_odds)
    rounds = [model.second_round(points.xyz, one, odds, threads) for threads in (1, 2)]
    assert rounds[0].tobytes() == rounds[1].tobytes()


def test_the_order_of_the_points_changes_nothing_about_a_score():
    points, ground = scene(3000, 9)
    voxels = Voxels.merged([summarise_points(points), summarise_ground(ground)])
    model, surroundings = evidence_model(), Surroundings.of(voxels)
    order = np.random.default_rng(10).permutation(len(points))
    whole = model.first_round(points, K, surroundings)
    found = model.first_round(points.part(order), K, surroundings)
    for one, other in (
        (whole.log_odds, found.log_odds),
        (whole.kept, found.kept),
        (whole.reason, found.reason),
    ):
        assert other.tobytes() == one[order].tobytes()
    odds = summarise_odds(points.xyz, whole.log_odds)
    scores = model.second_round(points.xyz, whole, odds)
    again = model.second_round(points.xyz[order], found, odds)
    assert again.tobytes() == scores[order].tobytes()


def test_the_more_confidence_is_asked_for_the_fewer_points_go():
    points, ground = scene(2500, 8)
    xyz = np.concatenate([points.xyz, ground])
    results = [
        clean(xyz, removal={"decision": "auto", "confidence": confidence}, neighbours={"k": K})
        for confidence in (0.1, 0.5, 0.9)
    ]
    removed = [result.labels == Label.DYNAMIC for result in results]
    assert removed[0].sum() >= removed[1].sum() >= removed[2].sum()
    assert (results[0].reason[removed[0]] < len(REASONS)).any()
    for result, of_result, confidence in zip(results, removed, (0.1, 0.5, 0.9), strict=True):
        assert (of_result == (np.nan_to_num(result.score) >= confidence)).all()
        scored = np.isin(result.labels, [Label.STATIC, Label.DYNAMIC])
        assert (np.isfinite(result.score) == scored).all()
        assert (result.reason[~scored] == NO_REASON).all()


def test_the_paper_weighs_no_evidence():
    points, _ = scene(500, 9)
    result = clean(points.xyz, "paper", ground={"method": "none"}, neighbours={"k": K})
    assert np.isnan(result.score).all()
    assert (result.reason == NO_REASON).all()
    assert summarise_points(points).sums[:, SCORED].sum() == len(points)


def test_the_model_that_is_shipped_asks_for_the_terms_there_are():
    assert evidence_model().first.terms == TERMS
    assert all(evidence_model(name).asked == asked for name, asked in MODELS.items())
