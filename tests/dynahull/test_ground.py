import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from dynahull.errors import InvalidPointsError, MissingClassificationError, MissingDependencyError
from dynahull.ground import candidates, columns, surface
from dynahull.ground import slope as slope_module
from dynahull.ground.methods import ground_mask, height_above_ground
from dynahull.ground.parameters import (
    ClothParameters,
    GroundParameters,
    SlopeExpert,
    SlopeParameters,
)
from dynahull.ground.reach import ground_radius, height_radius

DEFAULT = GroundParameters()
SMALL = GroundParameters(
    slope=SlopeParameters(window=1.0, expert=SlopeExpert(storey_radius=1.0, extension=0.5))
)


def plane(random, x, y, z, density=150):
    count = int((x[1] - x[0]) * (y[1] - y[0]) * density)
    height = z + random.normal(0, 0.01, count)
    return np.column_stack([random.uniform(*x, count), random.uniform(*y, count), height])


def room(random, size=8.0, density=150):
    """A floor with a table on it, walls and a ceiling: points, and which are floor."""
    floor = plane(random, (0, size), (0, size), 0.0, density)
    table = plane(random, (2, 3.2), (2, 3.2), 0.75, density)
    ceiling = plane(random, (0, size), (0, size), 2.6, density)
    along, up = random.uniform(0, size, 4000), random.uniform(0.2, 2.6, 4000)
    wall = np.column_stack([along, np.full(4000, size), up])
    points = np.concatenate([floor, table, ceiling, wall])
    return points, np.arange(len(points)) < len(floor)


def test_the_floor_is_ground_and_table_ceiling_and_wall_are_not():
    points, floor = room(np.random.default_rng(0))
    ground = ground_mask(points, DEFAULT)
    assert ground[floor].mean() > 0.97
    assert ground[~floor].mean() < 0.01


@pytest.mark.parametrize("offset", [(0, 0, -50), (500_000, 6_700_000, 30), (-3e6, 12.5, 1e4)])
def test_the_place_of_the_origin_does_not_matter(offset):
    points, _ = room(np.random.default_rng(1))
    moved = points + np.asarray(offset, float)
    # whole numbers of cells, so that only the rounding of the coordinates differs
    changed = ground_mask(points, DEFAULT) != ground_mask(moved, DEFAULT)
    assert changed.mean() < 1e-3


@settings(max_examples=10, deadline=None)
@given(st.floats(0, 2 * np.pi), st.floats(-100, 100), st.floats(-100, 100))
def test_turning_and_moving_a_map_changes_few_labels(angle, dx, dy):
    points, _ = room(np.random.default_rng(2))
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = points.copy()
    moved[:, :2] = points[:, :2] @ turn.T + [dx, dy]
    changed = ground_mask(points, DEFAULT) != ground_mask(moved, DEFAULT)
    assert changed.mean() < 0.03


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 5),
    st.floats(-5, 3),
    st.floats(-5, 3),
    st.floats(0.3, 5),
    st.floats(0.3, 5),
    st.booleans(),
)
def test_a_window_with_its_radius_gives_the_labels_of_the_whole_map(seed, x, y, dx, dy, outdoor):
    random = np.random.default_rng(seed)
    count = 6000
    points = random.uniform(-8, 8, (count, 3)) * [1, 1, 0.3]
    points[: count // 2, 2] = 0.1 * points[: count // 2, 0] + random.normal(0, 0.02, count // 2)
    points[: count // 6, 2] += 2.6
    parameters = SMALL
    if outdoor:
        slope = SlopeParameters(
            clearance=None,
            window=2.1,
            steepest=9,
            expert=SlopeExpert(cell=0.7, extension=1.5, flatness=0.2),
        )
        parameters = GroundParameters(slope=slope)
    ground = ground_mask(points, parameters)
    height = height_above_ground(points, ground, parameters)
    inside = in_box(points, x, y, dx, dy, 0.0)

    radius = ground_radius(parameters)
    part = in_box(points, x, y, dx, dy, radius)
    assert np.array_equal(ground_mask(points[part], parameters)[inside[part]], ground[inside])

    part = in_box(points, x, y, dx, dy, height_radius(parameters))
    again = height_above_ground(points[part], ground[part], parameters)
    assert np.array_equal(again[inside[part]], height[inside], equal_nan=True)


def in_box(points, x, y, dx, dy, margin):
    low, high = np.array([x, y]) - margin, np.array([x + dx, y + dy]) + margin
    return ((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_order_of_points_does_not_matter(seed):
    random = np.random.default_rng(seed)
    points, _ = room(random, size=4.0)
    order = random.permutation(len(points))
    assert np.array_equal(ground_mask(points, DEFAULT)[order], ground_mask(points[order], DEFAULT))


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 5), st.booleans(), st.integers(0, 6000))
def test_the_number_of_threads_does_not_matter(seed, threads, outdoor, count):
    random = np.random.default_rng(seed)
    points, _ = room(random, size=6.0, density=60)
    points = random.permutation(points)[:count]
    slope = SlopeParameters(clearance=None) if outdoor else SlopeParameters()
    parameters = GroundParameters(slope=slope)
    ground = ground_mask(points, parameters)
    height = height_above_ground(points, ground, parameters)
    with pytest.MonkeyPatch.context() as patch:
        # so that a small map is cut into as many ranges as a large one
        for step in (candidates, columns, slope_module, surface):
            patch.setattr(step, "_SMALLEST_RANGE", 20)
        assert np.array_equal(ground_mask(points, parameters, threads=threads), ground)
        again = height_above_ground(points, ground, parameters, threads=threads)
    assert np.array_equal(again, height, equal_nan=True)


def test_a_point_far_away_changes_nothing_and_costs_little():
    points, _ = room(np.random.default_rng(4))
    stray = np.array([[1e7, -1e7, 0.0], [1e300, -1e300, 1e300]])
    ground = ground_mask(np.concatenate([points, stray]), DEFAULT)
    assert np.array_equal(ground[:-2], ground_mask(points, DEFAULT))


@pytest.mark.parametrize("count", [0, 1, 2, 5])
@pytest.mark.parametrize("method", ["slope", "none", "csf"])
def test_few_points_are_no_error(count, method):
    if method == "csf":
        pytest.importorskip("CSF")
    points = np.random.default_rng(0).random((count, 3))
    parameters = GroundParameters(method=method)
    ground = ground_mask(points, parameters)
    assert ground.shape == (count,) and ground.dtype == bool
    assert height_above_ground(points, ground, parameters).shape == (count,)


def test_the_height_is_that_above_the_nearest_floor_beneath():
    random = np.random.default_rng(5)
    lower = plane(random, (0, 4), (0, 4), 10.0)
    upper = plane(random, (0, 4), (0, 4), 13.0)
    probes = np.array([[2, 2, 11.5], [2, 2, 14.2], [2, 2, 9.0], [4.5, 2.0, 11.0], [9, 9, 11.0]])
    points = np.concatenate([lower, upper, probes])
    ground = np.arange(len(points)) < len(lower) + len(upper)
    height = height_above_ground(points, ground, DEFAULT)[-5:]
    np.testing.assert_allclose(height, [1.5, 1.2, -1.0, 1.0, np.nan], atol=0.05)


@pytest.mark.parametrize(("steepest", "low", "high"), [(0.45, 0.0, 0.25), (0.8, 0.8, 1.0)])
def test_most_of_the_stairs_is_ground_if_surfaces_so_steep_may_be(steepest, low, high):
    random = np.random.default_rng(7)
    rise, run, steps = 0.17, 0.28, 16
    foot = plane(random, (-5, 0), (-3, 3), 0.0)
    head = plane(random, (run * steps, run * steps + 5), (-3, 3), rise * steps)
    treads = plane(random, (0, run * steps), (-0.8, 0.8), rise, 400)
    treads[:, 2] += np.floor(treads[:, 0] / run) * rise
    points = np.concatenate([foot, head, treads])
    parameters = GroundParameters(slope=SlopeParameters(steepest=steepest))
    ground = ground_mask(points, parameters)
    assert ground[: len(foot) + len(head)].mean() > 0.97
    assert low <= ground[len(foot) + len(head) :].mean() <= high


def test_trusted_classes():
    parameters = GroundParameters(method="las_class")
    points = np.zeros((3, 3))
    classes = np.array([1, 2, 6], np.uint8)
    assert ground_mask(points, parameters, classes).tolist() == [False, True, False]
    with pytest.raises(MissingClassificationError, match="las_class"):
        ground_mask(points, parameters)


def test_radii():
    assert ground_radius(GroundParameters(method="none")) == 0.0
    assert ground_radius(GroundParameters(method="las_class")) == 0.0
    assert ground_radius(GroundParameters(method="csf")) is None
    assert ground_radius(DEFAULT) == pytest.approx(1 + 2 * 2 + 3.5 + 2**0.5 * 0.25)


@pytest.mark.parametrize("far", [1e5, 3e38])
def test_csf_refuses_a_cloth_that_would_end_the_process(far):
    pytest.importorskip("CSF")
    points = np.concatenate([np.random.default_rng(0).uniform(size=(50, 3)), [[far, far, 0]]])
    with pytest.raises(InvalidPointsError, match="a stray point far away is enough"):
        ground_mask(points, GroundParameters(method="csf"))


def test_csf_finds_a_floor_in_silence_and_twice_the_same(capfd):
    pytest.importorskip("CSF")
    random = np.random.default_rng(6)
    floor = plane(random, (0, 10), (0, 10), 5.0, 60)
    things = np.column_stack([random.uniform(4, 6, (500, 2)), random.uniform(5.5, 7, 500)])
    points = np.concatenate([floor, things]) + np.array([500_000, 6_700_000, 0])
    parameters = GroundParameters(method="csf", csf=ClothParameters(cloth_resolution=0.5))
    ground = ground_mask(points, parameters)
    assert ground[: len(floor)].mean() > 0.95
    assert ground[len(floor) :].mean() < 0.05
    assert np.array_equal(ground, ground_mask(points, parameters))
    assert capfd.readouterr().out == ""


def test_csf_without_its_package_says_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "CSF", None)
    with pytest.raises(MissingDependencyError, match="pip install"):
        ground_mask(np.zeros((3, 3)), GroundParameters(method="csf"))


def test_unknown_keys_are_refused():
    with pytest.raises(ValidationError, match="windov"):
        GroundParameters.model_validate({"slope": {"windov": 3}})


def test_every_key_says_what_it_is():
    for model in (GroundParameters, SlopeParameters, ClothParameters):
        for name, field in model.model_fields.items():
            assert field.description, name


def test_no_module_prints():
    folder = Path(__file__).resolve().parents[2] / "dynahull" / "ground"
    assert not [f for f in folder.glob("*.py") if "print(" in f.read_text()]
