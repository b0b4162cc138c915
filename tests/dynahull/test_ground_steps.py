"""The compiled steps against plain versions of them, and the simulated building as a whole."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pytest import MonkeyPatch
from scipy import ndimage

from dynahull.ground import columns as columns_module
from dynahull.ground.candidates import outlines, stand_out
from dynahull.ground.columns import Columns, Levels, find_levels, levels_of, sort_columns
from dynahull.ground.lattice import BLOCK, build_lattice, disk_offsets, lattice_of_cells
from dynahull.ground.methods import (
    ground_mask,
    ground_summary,
    height_above_floors,
    height_above_ground,
    height_summary,
)
from dynahull.ground.parameters import GroundParameters, SlopeExpert, SlopeParameters
from dynahull.ground.reach import ground_radius, points_around
from dynahull.ground.slope import GroundSummary
from dynahull.ground.surface import HEIGHT, NOISE, SLOPE_X, SLOPE_Y, fit_surface
from dynahull.summary import Summary


def building_of(seed, **options):
    path = Path(__file__).resolve().parents[2] / "benchmarks" / "building.py"
    spec = importlib.util.spec_from_file_location("building", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.simulate_building(seed, **options)


@pytest.mark.parametrize(("seed", "ramp"), [(0, 0.12), (1, 0.15)])
def test_both_floors_and_the_ramp_of_a_building_are_found(seed, ramp):
    building = building_of(seed, ramp_slope=ramp)
    ground = ground_mask(building.points, GroundParameters())
    assert ground[building.floor].mean() >= 0.97
    assert ground[building.upper].mean() >= 0.96
    assert ground[building.ramp].mean() >= 0.97
    assert ground[~building.floor].mean() <= 0.01


def test_an_upper_floor_without_ceilings_is_found():
    building = building_of(0, ceilings=False)
    ground = ground_mask(building.points, GroundParameters())
    assert ground[building.floor].mean() >= 0.97
    # without ceilings the feet of walls and walkers are a larger share of the others
    assert ground[~building.floor].mean() <= 0.015
    assert (ground & building.clear).sum() / (~building.floor).sum() <= 0.005


def test_a_tile_of_the_building_gets_the_labels_of_the_whole():
    points = building_of(2, density=80.0).points
    parameters = GroundParameters()
    ground = ground_mask(points, parameters)
    low, high, radius = np.array([9.0, 3.0]), np.array([12.0, 6.0]), ground_radius(parameters)
    core = ((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)
    tile = ((points[:, :2] >= low - radius) & (points[:, :2] <= high + radius)).all(axis=1)
    assert tile.sum() < len(points)
    assert ground[core].any() and not ground[core].all()
    assert np.array_equal(ground_mask(points[tile], parameters)[core[tile]], ground[core])


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(0, 300),
    st.sampled_from([0.01, 1.0, 300.0]),
    st.integers(0, 3),
    st.integers(2, 4),
)
def test_columns_hold_every_point_from_the_lowest_up(seed, count, size, decimals, threads):
    random = np.random.default_rng(seed)
    points = np.round(random.uniform(-size, size, (count, 3)), decimals)
    with MonkeyPatch.context() as patch:
        patch.setattr(columns_module, "_SMALLEST_RANGE", 10)
        lattice = build_lattice(points, 0.5, 1.0)
        columns = sort_columns(points, 0.5, threads)
    blocks, local = lattice.blocks[lattice.slots // BLOCK**2], lattice.slots % BLOCK**2
    cells = blocks * BLOCK + np.column_stack([local // BLOCK, local % BLOCK])
    assert np.array_equal(cells, np.floor(points[:, :2] / 0.5))
    assert np.array_equal(np.sort(columns.rows), np.arange(count))
    assert np.array_equal(columns.heights, points[columns.rows, 2])
    assert np.array_equal(columns.rows, np.lexsort([np.arange(count), points[:, 2], lattice.slots]))
    assert (np.diff(columns.starts) > 0).all()
    of_points = np.repeat(columns.cells, np.diff(columns.starts), axis=0)
    assert np.array_equal(of_points, cells[columns.rows])
    again = lattice_of_cells(columns.cells, 0.5, 1.0)
    assert np.array_equal(again.slots, np.unique(lattice.slots))
    assert np.array_equal(again.neighbours, lattice.neighbours)
    known = {tuple(block): BLOCK**2 * number for number, block in enumerate(lattice.blocks)}
    nowhere = BLOCK**2 * len(known)
    assert nowhere not in lattice.slots
    for number, block in enumerate(lattice.blocks):
        for i, j in np.ndindex(lattice.neighbours.shape[1:]):
            other = (block[0] + i - 1, block[1] + j - 1)
            assert lattice.neighbours[number, i, j] == known.get(other, nowhere)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 5))
def test_the_opening_is_that_of_a_grey_image(seed, window):
    random = np.random.default_rng(seed)
    image = ndimage.gaussian_filter(random.random((25, 30)), 2) * 4
    image[8:14, 10:17] += random.uniform(0, 2)
    p = SlopeParameters(
        clearance=None, window=window, slope=0.1, step=0.0, expert=SlopeExpert(cell=1.0)
    )
    rows, columns = np.indices(image.shape)
    points = np.column_stack([rows.ravel() + 0.5, columns.ravel() + 0.5, image.ravel()])
    lattice = build_lattice(points, 1.0, window)
    order = np.argsort(lattice.slots)
    count = len(points)
    levels = Levels(
        image.ravel()[order], np.full(count, -1.0), lattice.slots[order], np.ones(count, bool)
    )
    objects = np.zeros(count, bool)
    objects[order] = stand_out(levels, lattice, p, np.inf)

    expected = np.zeros(image.shape, bool)
    opened = image
    for radius in range(1, window + 1):
        y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
        disk = x * x + y * y <= radius * radius
        eroded = ndimage.minimum_filter(image, footprint=disk, mode="constant", cval=np.inf)
        lowered = ndimage.maximum_filter(eroded, footprint=disk, mode="constant", cval=-np.inf)
        lowered = np.minimum(lowered, opened)
        expected |= opened - lowered > 0.1 * radius
        opened = lowered
    assert np.array_equal(objects.reshape(image.shape), expected)


def one_column(heights):
    starts = np.array([0, len(heights)])
    return Columns(heights, np.arange(len(heights)), starts, np.array([[3, -4]]))


def levels_found(*arguments):
    found = find_levels(*arguments)
    assert (found.cells == [3, -4]).all()
    return levels_of(found, lattice_of_cells(found.cells, 0.25, 1.0))


def test_levels_have_free_height_above_them_and_the_lowest_is_always_one():
    floor = np.linspace(0.0, 0.08, 20)
    shelf = [0.9, 0.91]
    upper = np.linspace(3.0, 3.05, 10)
    ghost = [3.9]
    levels = levels_found(one_column(np.concatenate([floor, shelf, upper, ghost])), 0.1, 1.8, 0.2)
    # two points of a shelf hide no floor of twenty, one of a ghost none of ten
    assert levels.heights == pytest.approx([0.04, 0.905, 3.025, 3.9])
    assert levels.bare.tolist() == [True, False, False, False]
    assert levels.spreads[0] == pytest.approx(floor.std())
    assert levels.spreads[-1] == -1.0

    crowded = np.sort(np.concatenate([floor, np.linspace(0.2, 1.5, 60)]))
    levels = levels_found(one_column(crowded), 0.1, 1.8, 0.2)
    assert levels.heights[0] == pytest.approx(0.04)
    assert not levels.bare[0]


@settings(max_examples=50, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 80),
    st.sampled_from([0.1, 1.0, 1.8]),
    st.sampled_from([0.0, 1e6, -1e12]),
    st.integers(1, 3),
)
def test_outlines_answer_what_all_heights_of_a_column_do(seed, count, clearance, far, decimals):
    random = np.random.default_rng(seed)
    heights = np.sort(np.round(random.uniform(0, 6, count), decimals)) + far
    outline = outlines(one_column(heights), clearance).values[:, 0]
    assert outline[0] == heights[0] and outline[-1] == heights[-1]
    assert np.isin(outline, heights).all()
    length = min(0.6, clearance / 2)
    for low in np.concatenate([heights, random.uniform(-1, 7, 50) + far]):
        for high in (low + length, low + 2 * length):
            held = ((heights >= low) & (heights <= high)).any()
            assert held == ((outline >= low) & (outline <= high)).any()


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.25, 0.3, 1.0]),
    st.sampled_from([None, 1.1]),
    st.floats(0.5, 6),
)
def test_parts_decide_by_their_points_and_summaries_what_the_whole_does(
    seed, cell, clearance, border
):
    random = np.random.default_rng(seed)
    points = random.uniform(0, 7, (4_000, 3)) * [1, 1, 0.5]
    points[:2_000, 2] = random.normal(0, 0.02, 2_000)
    slope = SlopeParameters(clearance=clearance, expert=SlopeExpert(cell=cell))
    parameters = GroundParameters(slope=slope)
    ground = ground_mask(points, parameters)
    height = height_above_ground(points, ground, parameters)
    assert ground.any()
    wide = points_around(parameters, heights=True, border=0.25) or 0.25
    border = np.floor(border / 0.25) * 0.25  # as those of tiles are
    parts = [
        (points[:, 0] < border, points[:, 0] < border + wide),
        (points[:, 0] >= border, points[:, 0] >= border - wide),
    ]
    told = [ground_summary(points[all_], core[all_], parameters) for core, all_ in parts]
    around = GroundSummary(*(Summary.joined(each) for each in zip(*told, strict=True)))
    floors = []
    for core, all_ in parts:
        found = ground_mask(points[all_], parameters, around=around)
        assert np.array_equal(found[core[all_]], ground[core])
        chosen = all_ & ground
        floors.append(height_summary(points[chosen], core[chosen], parameters))
    again = height_above_floors(points, Summary.joined(floors), parameters)
    assert np.array_equal(again, height, equal_nan=True)


def test_planes_follow_a_slope_and_know_its_noise():
    random = np.random.default_rng(0)
    points = random.uniform(-4, 4, (60_000, 3))
    points[:, 2] = 5 + 0.2 * points[:, 0] - 0.1 * points[:, 1] + random.normal(0, 0.01, 60_000)
    columns = sort_columns(points, 0.25)
    found = find_levels(columns, 0.2, np.inf, 1.0)
    lattice = lattice_of_cells(columns.cells, 0.25, 1.0)
    levels = levels_of(found, lattice._replace(slots=lattice.slots))
    surface = fit_surface(levels, lattice, lattice.slots, 1.0, np.inf, 0.2)
    x, y = (columns.cells.T + 0.5) * 0.25
    inner = (abs(x) < 3) & (abs(y) < 3)
    planes = surface.planes[inner]
    np.testing.assert_allclose(planes[:, HEIGHT], (5 + 0.2 * x - 0.1 * y)[inner], atol=0.02)
    assert np.median(planes[:, SLOPE_X]) == pytest.approx(0.2, abs=0.02)
    assert np.median(planes[:, SLOPE_Y]) == pytest.approx(-0.1, abs=0.02)
    # the slope within a cell counts as noise: 0.25 m * hypot(0.2, 0.1) / sqrt(12)
    expected = np.hypot(0.01, 0.25 * np.hypot(0.2, 0.1) / np.sqrt(12))
    assert np.median(planes[:, NOISE]) == pytest.approx(expected, rel=0.25)


def test_disks_grow_from_the_middle():
    offsets = disk_offsets(2.0)
    assert offsets[0].tolist() == [0, 0]
    assert len(offsets) == 13
    assert (np.diff((offsets**2).sum(axis=1)) >= 0).all()


def test_street_ground_has_few_moving_points(shared_data):
    laspy = pytest.importorskip("laspy")
    with laspy.open(shared_data / "maps/street_64beam_labelled.laz") as file:
        cloud = file.read()
    points = np.column_stack([cloud.x, cloud.y, cloud.z])
    near = (np.abs(points[:, :2] - [5.0, 0.0]) < 25).all(axis=1)
    moving = np.asarray(cloud.user_data)[near] == 2
    ground = ground_mask(points[near], GroundParameters())
    assert moving.sum() > 50_000
    assert ground[moving].mean() <= 0.02
    assert ground.mean() > 0.5


def test_airborne_samples(shared_data):
    laspy = pytest.importorskip("laspy")
    yaml = pytest.importorskip("yaml")
    path = Path(__file__).resolve().parents[2] / "configs/outdoor.yaml"
    parameters = GroundParameters.model_validate(yaml.safe_load(path.read_text())["ground"])
    errors = []
    for sample in sorted((shared_data / "ground").glob("samp*.laz")):
        cloud = laspy.read(sample)
        points = np.column_stack([cloud.x, cloud.y, cloud.z])
        truth = np.asarray(cloud.classification) == 2
        errors.append((ground_mask(points, parameters) != truth).mean())
    assert len(errors) == 8
    assert np.mean(errors) < 0.045
