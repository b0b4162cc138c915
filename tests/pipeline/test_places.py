"""The places where points were removed: the same however a map is cut, and what is said of them."""

import json
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import ndimage

from dynahull.evidence.reasons import NO_REASON, REASONS
from pipeline.areas import areas_of_voxels
from pipeline.configuration.run import load_configuration
from pipeline.outputs.run_report import RunReport
from pipeline.places import (
    ARRAY_NAMES,
    DENSITY,
    FEWEST,
    MOST_LISTED,
    NOWHERE,
    SIDE,
    SURROUNDINGS,
    Decision,
    DecisionSums,
    Place,
    PlaceReason,
)
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run


def judged(seed, count, extent, shift=0.0):
    """Points, half of them in small heaps, with scores and reasons; some are not scored."""
    random = np.random.default_rng(seed)
    heaps = random.uniform(0, extent, (12, 3))[random.integers(0, 12, count)]
    xyz = random.uniform(0, extent, (count, 3))
    xyz[::2] = heaps[::2] + random.normal(0, 0.3, (len(xyz[::2]), 3))
    xyz[:: max(count // 20, 1)] = np.round(xyz[:: max(count // 20, 1)] / SIDE) * SIDE
    score = random.uniform(size=count).astype(np.float32)
    score[random.random(count) < 0.1] = np.nan
    reason = random.choice([0, 1, 2, len(REASONS) - 1, NO_REASON], count).astype(np.uint8)
    return xyz + shift, score, reason


def parts_of(judged, confidence, cuts_x, cuts_y):
    """The sums of tiles of any widths; those at the edge go on for ever."""
    xyz, score, reason = judged
    edges = [np.array([-np.inf, *sorted(cuts), np.inf]) for cuts in (cuts_x, cuts_y)]
    for west, east in zip(edges[0][:-1], edges[0][1:], strict=True):
        for south, north in zip(edges[1][:-1], edges[1][1:], strict=True):
            low, high = np.array([west, south]), np.array([east, north])
            own = ((xyz[:, :2] >= low) & (xyz[:, :2] < high)).all(axis=1)
            core = np.stack([low, high])
            yield DecisionSums.of(xyz[own], score[own], reason[own], confidence, core)


def assert_same(one, other):
    assert one.places == other.places
    for name in ("place_count", "scattered", "uncertain"):
        assert getattr(one, name) == getattr(other, name)
    np.testing.assert_array_equal(one.scores, other.scores)


@settings(deadline=None, max_examples=150)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(0, 1_500),
    extent=st.sampled_from([3.0, 12.0, 40.0]),
    shift=st.sampled_from([0.0, -7.3, 652_345.5]),
    confidence=st.sampled_from([0.05, 0.37, 0.5, 0.9]),
    shares_x=st.lists(st.floats(0, 1), max_size=4),
    shares_y=st.lists(st.floats(0, 1), max_size=4),
    order=st.randoms(use_true_random=False),
)
def test_places_of_tiles_are_those_of_the_whole_map(
    seed, count, extent, shift, confidence, shares_x, shares_y, order
):
    points = judged(seed, count, extent, shift)
    # Corners of voxels, too, where a point is on the one side or the other by its last bit.
    cuts_x, cuts_y = (
        [np.round(share * extent / SIDE) * SIDE + shift if index % 2 else share * extent + shift
         for index, share in enumerate(shares)]
        for shares in (shares_x, shares_y)
    )  # fmt: skip
    parts = list(parts_of(points, confidence, cuts_x, cuts_y))
    order.shuffle(parts)
    handed = (
        DecisionSums.from_arrays(*(part.to_arrays()[name] for name in ARRAY_NAMES))
        for part in parts
    )
    whole = DecisionSums.of(*points, confidence).decision()
    assert_same(DecisionSums.merged(handed).decision(), whole)


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1), st.integers(1, 1_500), st.sampled_from([3.0, 12.0]))
def test_places_are_the_groups_of_voxels_that_touch(seed, count, extent):
    xyz, score, reason = judged(seed, count, extent)
    decision = DecisionSums.of(xyz, score, reason, 0.5).decision()
    gone = np.nan_to_num(score) >= 0.5
    cells = np.floor(xyz[gone] / SIDE).astype(int)
    cells -= cells.min(axis=0, initial=0)
    grid = np.zeros(cells.max(axis=0, initial=0) + 1, int)
    np.add.at(grid, tuple(cells.T), 1)
    groups, number = ndimage.label(grid > 0, np.ones((3, 3, 3)))
    points = np.array(ndimage.sum_labels(grid, groups, range(1, number + 1)), int)
    large = np.sort(points[points >= FEWEST])[::-1]
    assert decision.place_count == len(large)
    assert [place.points for place in decision.places] == large[:MOST_LISTED].tolist()
    assert decision.scattered == points[points < FEWEST].sum()
    assert decision.uncertain == ((score >= 0.25) & (score < 0.5)).sum()


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    extent=st.sampled_from([3.0, 12.0]),
    shift=st.sampled_from([0.0, -7.3, 652_345.5]),
    data=st.data(),
)
def test_areas_of_a_place_hold_its_points_alone(seed, extent, shift, data):
    """Of points on the corners of voxels, too, and of places that reach into each other's boxes."""
    xyz, score, reason = judged(seed, 700, extent, shift)
    gone = np.nan_to_num(score) >= 0.5
    sums = DecisionSums.of(xyz, score, reason, 0.5, NOWHERE)
    places = sums.decision().places
    if not places:
        return
    numbers = data.draw(st.sets(st.sampled_from([each.number for each in places]), min_size=1))
    cells = sums.cells_of(sorted(numbers))
    inside = np.any([area.holds(xyz) for area in areas_of_voxels(cells, SIDE)], axis=0)
    own = (np.floor(xyz / SIDE)[:, np.newaxis] == cells).all(axis=2).any(axis=1)
    np.testing.assert_array_equal(inside, own)
    assert np.count_nonzero(inside & gone) == sum(places[n - 1].points for n in numbers)


def test_what_is_said_of_a_place():
    random = np.random.default_rng(0)
    xyz = random.uniform([4.0, 8.0, 0.0], [4.4, 8.8, 1.2], (300, 3))
    score = np.full(300, 0.75, np.float32)
    reason = np.full(300, NO_REASON, np.uint8)
    reason[:150], reason[150:200], reason[200:230] = 3, 0, 1
    (place,) = DecisionSums.of(xyz, score, reason, 0.5).decision().places
    assert (place.number, place.points, place.score) == (1, 300, 0.75)
    assert (place.low, place.high) == ((4.0, 8.0, 0.0), (4.4, 8.8, 1.2))
    words = list(REASONS)
    said = [(why.words, why.share) for why in place.reasons]
    assert said == [(words[3], 0.5), (SURROUNDINGS, 0.233), (words[0], 0.167)]


def test_a_place_that_many_tiles_share_is_one():
    line = np.column_stack([np.linspace(0, 400, 4_001), np.full((4_001, 2), 0.1)])
    points = line, np.ones(4_001, np.float32), np.zeros(4_001, np.uint8)
    cuts = np.arange(0.05, 400, 0.9).tolist()
    parts = list(parts_of(points, 0.5, cuts, [0.1]))
    (place,) = DecisionSums.merged(parts).decision().places
    assert place.points == 4_001
    assert place.size[0] == pytest.approx(400.4)


def test_of_places_that_end_within_a_tile_no_voxel_is_handed_on():
    xyz, score, reason = judged(3, 4_000, 40.0)
    tile = DecisionSums.of(xyz, score, reason, 0.5, np.array([[-9.0, -9.0], [49.0, 49.0]]))
    assert len(tile.open) == 0
    assert 0 < len(tile.whole) <= tile.counts[0]
    narrow = DecisionSums.of(xyz, score, reason, 0.5, np.array([[0.0, 0.0], [40.0, 40.0]]))
    assert len(narrow.open) > 0


def test_of_many_tiles_few_are_held_at_a_time(monkeypatch):
    from pipeline import places  # noqa: PLC0415

    points = judged(5, 3_000, 12.0)
    parts = list(parts_of(points, 0.3, [2.0, 4.0, 6.0, 8.0], [3.0, 9.0]))
    monkeypatch.setattr(places, "_MANY", 10)
    added = []
    original = DecisionSums._added.__func__
    monkeypatch.setattr(
        DecisionSums,
        "_added",
        classmethod(lambda cls, parts: (added.append(len(parts)), original(cls, parts))[1]),
    )
    found = DecisionSums.merged(parts).decision()
    assert len(added) > 2
    assert_same(found, DecisionSums.of(*points, 0.3).decision())


@pytest.mark.parametrize("step", [0, 5, 37, 50, 99, 100])
def test_the_table_says_what_a_run_of_another_confidence_takes(step):
    _, score, _ = judged(1, 5_000, 9.0)
    score[:101] = (np.arange(101) / 100).astype(np.float32)
    score[101:202] = np.nextafter(score[:101], np.float32(-1))
    score = np.clip(score, 0, 1)
    sums = DecisionSums.of(np.zeros((5_000, 3)), score, np.zeros(5_000, np.uint8), 0.5)
    removed_at = sums.decision().removed_at()
    assert removed_at[step] == (score >= float(f"{step / 100:g}")).sum()


def street(people):
    """A floor and two walls, and a trail of somebody who walked there."""
    random = np.random.default_rng(4)
    floor = random.uniform([0, 0, 0], [16, 6, 0.01], (6_000, 3))
    walls = [random.uniform([0, y, 0], [16, y + 0.01, 2.5], (5_000, 3)) for y in (0, 6)]
    trail = np.column_stack([random.uniform(3, 13, people), random.normal(3, 0.15, people),
                             random.uniform(0.2, 1.8, people)])  # fmt: skip
    return np.concatenate([floor, *walls, trail])


def cleaned(points, folder, *wanted):
    np.save(folder / "map.npy", points)
    settings = ["neighbours.k=20", "execution.cluster=none", *wanted]
    configuration = load_configuration(None, settings)
    return run([folder / "map.npy"], folder / "out", configuration, StageObserver(LogDisplay()))


@pytest.mark.parametrize("max_points", [1_000_000, 4_000])
def test_a_run_by_evidence_says_where_and_why(tmp_path, max_points):
    settings = ["removal.decision=auto", f"tiling.max_points={max_points}"]
    report = cleaned(street(900), tmp_path, *settings)
    assert report.counts["dynamic"] > 0
    stored = json.loads((tmp_path / "out" / "run.json").read_text(encoding="utf-8"))
    assert [place["number"] for place in stored["places"]] == [*range(1, len(report.places) + 1)]
    listed = sum(place["points"] for place in stored["places"])
    assert listed + stored["scattered_points"] == report.counts["dynamic"]
    assert stored["place_count"] == len(stored["places"])
    share = 100 * report.counts["dynamic"] / report.points
    *_, written, verdict, largest = report.summary().splitlines()
    assert written.startswith("written: ")
    assert verdict.startswith(f"{share:.1f} % removed in {stored['place_count']} place")
    place = stored["places"][0]
    assert largest.startswith(f"largest place: {place['points']:,} points about (")
    assert place["reasons"][0]["words"] in largest


@settings(deadline=None, max_examples=25)
@given(st.integers(0, 2**32 - 1), st.lists(st.floats(0, 1), max_size=4))
def test_places_by_density_are_those_of_tiles_too(seed, cuts):
    xyz, score, _ = judged(seed, 900, 12.0)
    gone = np.nan_to_num(score) >= 0.5
    edges = [-np.inf, *sorted(12 * cut for cut in cuts), np.inf]
    parts = []
    for west, east in pairwise(edges):
        own = gone & (xyz[:, 0] >= west) & (xyz[:, 0] < east)
        core = np.array([[west, -np.inf], [east, np.inf]])
        parts.append(DecisionSums.by_density(xyz[own], core))
    whole = DecisionSums.by_density(xyz[gone]).decision()
    assert_same(DecisionSums.merged(parts).decision(), whole)
    same = DecisionSums.of(xyz, score, np.zeros(len(xyz), np.uint8), 0.5).decision()
    assert [each.low for each in whole.places] == [each.low for each in same.places]
    assert {each.score for each in whole.places} <= {None}
    assert {why.words for each in whole.places for why in each.reasons} <= {DENSITY}
    assert (whole.uncertain, whole.scores.sum()) == (0, 0)


@pytest.mark.parametrize("max_points", [1_000_000, 4_000])
def test_the_paper_says_where(tmp_path, max_points):
    settings = ["removal.decision=paper", f"tiling.max_points={max_points}"]
    report = cleaned(street(900), tmp_path, *settings)
    assert report.places
    assert report.uncertain_points is None
    listed = sum(place.points for place in report.places)
    assert listed + report.scattered_points == report.counts["dynamic"]
    *_, written, verdict, largest = report.summary().splitlines()
    assert written.startswith("written: ")
    assert verdict.endswith("scattered points")
    assert largest.startswith(f"largest place: {report.places[0].points:,} points about (")
    assert largest.endswith(f"m: {DENSITY} (100 %)")


def reported(static, dynamic, decision, tmp_path):
    """A report as it would be, had the evidence decided so."""
    base = cleaned(np.zeros((3, 3)), tmp_path)
    counts = dict.fromkeys(base.counts, 0) | {"static": static, "dynamic": dynamic, "ground": 500}
    update = {
        "points": sum(counts.values()),
        "counts": counts,
        "places": list(decision.places),
        "place_count": decision.place_count,
        "scattered_points": decision.scattered,
        "uncertain_points": decision.uncertain,
    }
    report: RunReport = base.model_copy(update=update)
    return report.verdict()


ABOUT = "about (0.4, 3.0, 0.8), 0.8 x 2.0 x 1.6 m: stands free (61 %)"


def a_place(points):
    why = PlaceReason(words="stands free", share=0.61)
    return Place(number=1, points=points, low=(0, 2, 0), high=(0.8, 4, 1.6), score=0.8,
                 reasons=(why,))  # fmt: skip


@pytest.mark.parametrize(
    ("static", "dynamic", "places", "scattered", "uncertain", "said"),
    [
        (500, 0, 0, 0, 0, ["nothing moved: nothing removed"]),
        (500, 0, 0, 0, 30, ["nothing moved: nothing removed; 3.0 % uncertain, kept"]),
        (0, 0, 0, 0, 0, ["nothing was scored: nothing removed"]),
        (1499500, 1, 0, 1, 0, ["under 0.1 % removed in 1 scattered point"]),
        (
            400, 100, 1, 0, 4,
            ["10.0 % removed in 1 place; 0.4 % uncertain, kept",
             "largest place: 100 points " + ABOUT],
        ),
        (
            400, 100, 63, 7, 0,
            ["10.0 % removed in 63 places and 7 scattered points",
             "largest place: 93 points " + ABOUT],
        ),
    ],
)  # fmt: skip
def test_the_verdict_is_plain(tmp_path, static, dynamic, places, scattered, uncertain, said):
    listed = (a_place(dynamic - scattered),) if places else ()
    decision = Decision(listed, places, scattered, uncertain, np.zeros(101, np.int64))
    assert reported(static, dynamic, decision, tmp_path) == said
