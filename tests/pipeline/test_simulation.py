"""The simulated map is the same every time, and its truth is true."""

import gc
import tracemalloc
from itertools import islice

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.spatial import ConvexHull, cKDTree
from sklearn.metrics import roc_auc_score

from pipeline.errors import ConfigurationError
from pipeline.simulation import (
    SceneKind,
    SimulationParameters,
    Surface,
    build_scene,
    scans,
    simulate,
    simulate_scans,
)
from pipeline.simulation.motion import drift
from pipeline.simulation.scans import RING_ELEVATIONS, Drive, measured_ranges, rotation

SHORT = {"scans": 40, "rotations_per_scan": 15}
EXACT = {"range_noise": 0, "range_resolution": 0, "drift_position": 0, "drift_heading": 0}
ARRAYS = ("xyz", "intensity", "time", "scan", "moving", "surface", "true_poses", "estimated_poses")
# float32 resolves 4 micrometres at 64 m, 8 at 120 m.
RESOLUTION = 2e-5


@pytest.fixture(scope="module")
def default_map():
    return simulate(SimulationParameters())


@pytest.fixture(scope="module", params=list(SceneKind))
def exact_map(request):
    return simulate(SimulationParameters(**SHORT, **EXACT, scene=request.param, seed=3, machines=3))


def off_shapes(shapes, points):
    """Distance from each point to the surface of each shape, boxes on slopes included: (n, m)."""
    x, y, z = (points[..., axis] for axis in range(3))
    x0, y0, z0, x1, y1, z1, slope_x, slope_y = shapes.boxes.T
    low = z[..., None] - slope_x * x[..., None] - slope_y * y[..., None]
    to_box = outside_or_inside(
        [x0 - x[..., None], x[..., None] - x1],
        [y0 - y[..., None], y[..., None] - y1],
        [z0 - low, low - z1],
    )
    cx, cy, radius, bottom, top = shapes.cylinders.T
    to_cylinder = outside_or_inside(
        [np.hypot(x[..., None] - cx, y[..., None] - cy) - radius],
        [bottom - z[..., None], z[..., None] - top],
    )
    return np.concatenate([to_box, to_cylinder], axis=-1)


def outside_or_inside(*pairs):
    """Distance to a convex body from how far a point is beyond each pair of its faces."""
    beyond = np.stack([np.max(pair, axis=0) for pair in pairs])
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=0)
    return outside - np.minimum(beyond.max(axis=0), 0)


def off_movers(simulated, points, times):
    """Distance from each point to the nearest mover, placed anew by the seed at its time."""
    drive = Drive(simulated.parameters)
    poses = drive.movers.at(times, drive.robot.at(times))
    nearest = np.full(len(points), np.inf)
    for number, mover in enumerate(drive.movers.everyone):
        x, y, z, heading, slope = poses[:, number].T
        east, north = points[:, 0] - x, points[:, 1] - y
        ahead = np.cos(heading) * east + np.sin(heading) * north
        left = np.cos(heading) * north - np.sin(heading) * east
        local = np.stack([ahead, left, points[:, 2] - z - slope * ahead], axis=1)
        nearest = np.minimum(nearest, off_shapes(mover.shapes, local).min(axis=1))
    return nearest


def test_same_seed_same_bits_another_seed_another_map():
    first, again, other = (simulate(SimulationParameters(**SHORT, seed=s)) for s in (7, 7, 8))
    for name in ARRAYS:
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes()
    assert first.xyz.tobytes() != other.xyz.tobytes()


def test_people_change_neither_noise_nor_drift():
    few, many = (
        list(simulate_scans(SimulationParameters(**SHORT, walkers=w, queuers=w, machines=w)))
        for w in (0, 4)
    )
    for here, there in zip(few, many, strict=True):
        assert np.array_equal(here.estimated_pose, there.estimated_pose)
        assert np.array_equal(here.static_returns.xyz, there.static_returns.xyz)


def test_another_drive_goes_through_the_same_scene():
    first, second = (SimulationParameters(**SHORT, drive=number) for number in (0, 1))
    assert build_scene(first).shapes.boxes.tobytes() == build_scene(second).shapes.boxes.tobytes()
    assert simulate(first).xyz.tobytes() != simulate(second).xyz.tobytes()


def test_arrays_have_the_promised_types_and_one_length(default_map):
    count = len(default_map.xyz)
    assert 150_000 <= count <= 201_600
    expected = {
        "xyz": ("float32", (count, 3)),
        "intensity": ("float32", (count,)),
        "time": ("float64", (count,)),
        "scan": ("uint32", (count,)),
        "moving": ("uint8", (count,)),
        "surface": ("uint8", (count,)),
        "true_poses": ("float64", (700, 3, 4)),
        "estimated_poses": ("float64", (700, 3, 4)),
    }
    for name, (dtype, shape) in expected.items():
        array = getattr(default_map, name)
        assert (array.dtype, array.shape) == (np.dtype(dtype), shape), name
    assert np.isfinite(default_map.xyz).all()
    assert ((default_map.intensity >= 0) & (default_map.intensity <= 255)).all()


def test_points_come_in_order_of_time_within_their_scans(default_map):
    assert (np.diff(default_map.time) >= 0).all()
    since = default_map.time - default_map.scan * default_map.parameters.scan_interval
    assert (since >= -1e-9).all()
    assert (since < 1 / default_map.parameters.rotation_rate).all()


def test_without_noise_static_points_lie_on_what_stands_there(exact_map):
    still = exact_map.moving == 0
    shapes = build_scene(exact_map.parameters).shapes
    surface = np.concatenate([shapes.box_surface, shapes.cylinder_surface])
    points, found = exact_map.xyz[still].astype(float), exact_map.surface[still]
    distance = np.concatenate([off_shapes(shapes, part) for part in np.array_split(points, 8)])
    other_kind = surface != found[:, None]
    distance[other_kind] = np.inf
    assert distance.min(axis=1).max() < RESOLUTION
    assert {Surface.FLOOR, Surface.WALL, Surface.FURNITURE} <= set(found)


def test_moving_points_lie_on_what_moves_and_others_do_not(exact_map):
    points = exact_map.xyz.astype(float)
    distance = off_movers(exact_map, points, exact_map.time)
    moving = exact_map.moving == 1
    assert moving.sum() > 200
    assert distance[moving].max() < RESOLUTION
    assert (distance[~moving] < RESOLUTION).mean() < 2e-3, "feet on the floor only"
    assert set(exact_map.surface[moving]) <= {Surface.PERSON, Surface.MACHINE, Surface.VEHICLE}
    assert len(set(exact_map.surface[moving])) == 2, "people and machines"


def test_nothing_that_moves_no_ghosts():
    nobody = {"walkers": 0, "queuers": 0, "machines": 0}
    assert not simulate(SimulationParameters(**SHORT, **nobody)).moving.any()


def test_static_returns_are_the_map_without_what_moves():
    """The same points where nothing was in the way, and others behind the ghosts."""
    for scan in simulate_scans(SimulationParameters(scans=20, rotations_per_scan=30)):
        still = scan.returns.xyz[~scan.returns.moving]
        distance, _ = cKDTree(scan.static_returns.xyz).query(still)
        assert distance.max() < 1e-9
        assert len(scan.static_returns) >= len(still)
        assert not scan.static_returns.moving.any()


def test_low_activity_drive_sees_the_same_scene_with_hardly_a_ghost():
    busy = SimulationParameters(**SHORT)
    quiet = busy.low_activity()
    assert build_scene(busy).shapes.boxes.tobytes() == build_scene(quiet).shapes.boxes.tobytes()
    assert 0 < simulate(quiet).moving.mean() < simulate(busy).moving.mean() / 3


def test_no_ray_passes_through_a_solid(exact_map):
    """Stepped along each ray from the sensor to the point, by membership in the boxes."""
    scene = build_scene(exact_map.parameters)
    x0, y0, z0, x1, y1, z1, slope_x, slope_y = scene.shapes.boxes.T
    chosen = np.random.default_rng(0).choice(len(exact_map.xyz), 60, replace=False)
    origin = eyes(exact_map, exact_map.time[chosen])
    way = exact_map.xyz[chosen] - origin
    # Each point of a solid thicker than a step is found; the thinnest, a table's top, is 3 cm.
    for share in np.linspace(0, 1, 1500)[:-1]:
        x, y, z = ((origin + share * way)[:, axis, None] for axis in range(3))
        low = z - slope_x * x - slope_y * y
        within = np.stack([x - x0, x1 - x, y - y0, y1 - y, low - z0, z1 - low]).min(axis=0)
        assert within.max() < RESOLUTION


def eyes(simulated, times):
    """Where the sensor is: above the robot, along the robot's own upward axis."""
    robot = Drive(simulated.parameters).robot.at(times)
    heading, pitch = robot[:, 3], np.arctan(robot[:, 4])
    up = np.stack(
        [-np.sin(pitch) * np.cos(heading), -np.sin(pitch) * np.sin(heading), np.cos(pitch)], axis=1
    )
    return robot[:, :3] + simulated.parameters.sensor_height * up


def test_rings_are_sixteen_two_degrees_apart(exact_map):
    """Angles above the plane that the robot stands on."""
    assert np.degrees(RING_ELEVATIONS) == pytest.approx(np.arange(-15, 16, 2))
    origin = eyes(exact_map, exact_map.time)
    robot = Drive(exact_map.parameters).robot.at(exact_map.time)
    up = (origin - robot[:, :3]) / exact_map.parameters.sensor_height
    way = exact_map.xyz - origin
    sine = (way * up).sum(axis=1) / np.linalg.norm(way, axis=1)
    elevation = np.degrees(np.arcsin(sine))
    ring = np.round((elevation + 15) / 2)
    assert np.abs(elevation - (2 * ring - 15)).max() < 2e-3
    assert set(ring) == set(range(16))


def test_rotation_covers_the_circle_evenly_in_the_time_of_a_turn():
    columns = SimulationParameters(azimuth_step=2.0).columns
    share, directions = rotation(columns, np.random.default_rng(0))
    assert directions.shape == (180 * 16, 3)
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1)
    azimuth = np.unwrap(np.arctan2(directions[:, 1], directions[:, 0])).reshape(180, 16)
    assert np.degrees(np.diff(azimuth, axis=0)) == pytest.approx(2.0)
    assert np.ptp(azimuth, axis=1) == pytest.approx(0)
    assert share.shape == (180,)
    assert share.min() >= 0
    assert share.max() < 1


def test_range_noise_has_its_deviation_and_ranges_are_rounded():
    parameters = SimulationParameters(range_noise=0.02, range_resolution=0.004)
    noise = np.random.default_rng(0).standard_normal(100_000)
    ranges = measured_ranges(np.full(100_000, 5.0), noise, parameters)
    # Standard errors at this size: 6e-5 of the mean, 5e-5 of the deviation.
    assert ranges.mean() == pytest.approx(5.0, abs=3e-4)
    assert ranges.std() == pytest.approx(np.hypot(0.02, 0.004 / np.sqrt(12)), abs=3e-4)
    steps = ranges / 0.004
    assert np.abs(steps - np.round(steps)).max() < 1e-9


def test_ranges_outside_the_limits_are_not_reported():
    parameters = SimulationParameters(min_range=1.0, max_range=20.0)
    distance = np.array([0.5, 1.5, 19.0, 21.0, np.inf])
    ranges = measured_ranges(distance, np.zeros(5), parameters)
    assert np.isfinite(ranges).tolist() == [False, True, True, False, False]


def test_drift_starts_at_zero_and_stays_within_its_deviation():
    parameters = SimulationParameters(rotations_per_scan=100)
    errors = np.stack(list(islice(drift(parameters, np.random.default_rng(0)), 20_000)))
    assert not errors[0].any()
    assert errors[:, :3].std(axis=0) == pytest.approx([parameters.drift_position] * 3, rel=0.05)
    assert np.degrees(errors[:, 3].std()) == pytest.approx(parameters.drift_heading, rel=0.05)


def test_noise_and_drift_thicken_walls(default_map):
    """Points near a face of the building's southern or northern wall, seen from inside."""
    x, y, z = default_map.xyz[default_map.surface == Surface.WALL].T
    for face in (0.1, 24.9):
        near = y[(np.abs(y - face) < 0.08) & (x > 2) & (x < 28) & (z > 0.3) & (z < 2.9)]
        assert len(near) > 500
        assert abs(near.mean() - face) < 0.02
        assert 0.01 < near.std() < 0.04


def test_poses_take_scans_back_to_the_sensor_whatever_their_error():
    """Drifted scans, by their estimated poses, are the scans without drift, by their true ones."""
    parameters = SimulationParameters(scans=8, rotations_per_scan=40, drift_heading=5)
    steady = parameters.model_copy(update={"drift_heading": 0.0, "drift_position": 0.0})
    for drifted, true in zip(simulate_scans(parameters), simulate_scans(steady), strict=True):
        local = [
            (xyz - pose[:, 3]) @ pose[:, :3]
            for xyz, pose in (
                (drifted.returns.xyz, drifted.estimated_pose),
                (true.returns.xyz, true.true_pose),
            )
        ]
        assert local[0] == pytest.approx(local[1])
        assert drifted.in_sensor_frame() == pytest.approx(local[0])
        assert np.array_equal(drifted.true_pose, true.true_pose)
        floor = local[1][true.returns.surface == Surface.FLOOR]
        assert len(floor) > 10
        assert floor[:, 2].mean() == pytest.approx(-parameters.sensor_height, abs=0.005)
    assert not np.allclose(drifted.returns.xyz, true.returns.xyz, atol=0.1)


@pytest.mark.parametrize("seed", [0, 1])
def test_ghosts_are_less_dense_than_what_stands_still(seed):
    """The premise of the method: k over hull volume tells ghosts from static surfaces."""
    simulated = simulate(SimulationParameters(seed=seed))
    upright = ~np.isin(simulated.surface, (Surface.FLOOR, Surface.CEILING))
    points = simulated.xyz[upright].astype(float)
    moving = simulated.moving[upright] == 1
    random = np.random.default_rng(0)
    queries = np.concatenate(
        [random.choice(np.flatnonzero(moving == kind), 500, replace=False) for kind in (0, 1)]
    )
    _, neighbours = cKDTree(points).query(points[queries], k=75)
    density = np.array([75 / ConvexHull(points[rows]).volume for rows in neighbours])
    truth = moving[queries]
    assert np.median(density[~truth]) > 4 * np.median(density[truth])
    assert roc_auc_score(truth, -density) > 0.8


def few_points_a_block(monkeypatch, points):
    monkeypatch.setattr(scans, "POINTS_OF_A_BLOCK", points)


@pytest.mark.parametrize("points", [1, 17, 999, 5000, 12_345])
@pytest.mark.parametrize("kind", ["indoor", "street"])
def test_map_has_the_points_asked_for_exactly(monkeypatch, points, kind):
    few_points_a_block(monkeypatch, 5000)
    simulated = simulate(SimulationParameters(points=points, scene=kind, scans=30))
    assert len(simulated.xyz) == points
    assert np.array_equal(np.unique(simulated.scan), np.arange(simulated.scan[-1] + 1))
    assert (np.diff(simulated.time) >= 0).all()
    assert len(simulated.true_poses) == simulated.scan[-1] + 1


def test_blocks_differ_lie_apart_and_are_seen_one_after_the_other(monkeypatch):
    few_points_a_block(monkeypatch, 5000)
    simulated = simulate(SimulationParameters(points=20_000, scans=30, **EXACT))
    blocks = np.split(simulated.xyz, 4)
    # Four buildings of 30 by 25 m with 6 m between them: two and two, there and back.
    for block, corner in zip(blocks, [(0, 0), (36, 0), (36, 31), (0, 31)], strict=True):
        assert (block[:, :2] >= np.array(corner) - 0.2).all()
        assert (block[:, :2] <= np.array(corner) + [30.2, 25.2]).all()
    local = [np.round(block - block.min(axis=0), 3) for block in blocks]
    assert not any(np.array_equal(local[0], other) for other in local[1:])


def test_scans_go_on_until_there_are_enough():
    """A few coarse scans would not do: the drive is longer than planned."""
    simulated = simulate(SimulationParameters(points=200_000, scans=1, rotations_per_scan=1))
    assert len(simulated.xyz) == 200_000
    assert simulated.scan[-1] > 1


def test_sensor_that_sees_nothing_is_one_clear_line():
    parameters = SimulationParameters(points=100, min_range=50, max_range=60, scans=5)
    with pytest.raises(ConfigurationError, match="expected 100 from a block, found 0 in 24 scans"):
        simulate(parameters)


def test_sensor_that_hardly_sees_anything_is_given_up(monkeypatch):
    monkeypatch.setattr(scans, "_LONGEST", 0.1)
    with pytest.raises(
        ConfigurationError, match=r"expected 5000 from a block, found \d+ in 4 scans"
    ):
        simulate(SimulationParameters(points=5000, scans=40))


def test_memory_does_not_grow_with_the_map(monkeypatch):
    few_points_a_block(monkeypatch, 8000)
    for _ in simulate_scans(SimulationParameters(points=64_000, scans=10)):
        pass  # the first run brings libraries and caches, of every block
    peaks = []
    for points in (8000, 64_000):
        gc.collect()
        tracemalloc.start()
        for _ in simulate_scans(SimulationParameters(points=points, scans=10)):
            pass
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    # 56,000 more points would take 672,000 bytes for their coordinates alone.
    assert peaks[1] < peaks[0] + 300_000
    assert peaks[1] < 8 << 20


@pytest.mark.parametrize(
    "wrong",
    [{"sedd": 1}, {"scans": 0}, {"range_noise": -1}, {"queuers": 7}, {"scene": "x"}, {"points": 0}],
)
def test_wrong_parameters_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        SimulationParameters(**wrong)


def test_every_parameter_says_what_it_is():
    assert all(field.description for field in SimulationParameters.model_fields.values())
