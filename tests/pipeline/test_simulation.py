"""The simulated map is the same every time, its truth is true, and its files can be read."""

import numpy as np
import pyarrow.parquet as pq
import pytest
import yaml
from pydantic import ValidationError
from scipy.spatial import ConvexHull, cKDTree
from sklearn.metrics import roc_auc_score

from pipeline.errors import OutputError
from pipeline.simulation import (
    SimulationParameters,
    Surface,
    simulate,
    simulate_scans,
    write_simulated_map,
)
from pipeline.simulation.indoor import indoor_floor_plan
from pipeline.simulation.motion import drive
from pipeline.simulation.people import populate
from pipeline.simulation.poses import drift
from pipeline.simulation.sensor import RING_ELEVATIONS, measured_ranges, rotation
from tiling.formats import open_map

SHORT = {"scans": 60, "rotations_per_scan": 10}
EXACT = {"range_noise": 0, "range_resolution": 0, "drift_position": 0, "drift_heading": 0}
ARRAYS = ("xyz", "intensity", "time", "scan", "moving", "surface", "true_poses", "estimated_poses")


@pytest.fixture(scope="module")
def default_map():
    return simulate(SimulationParameters())


@pytest.fixture(scope="module")
def exact_map():
    return simulate(SimulationParameters(**SHORT, **EXACT, seed=3))


def off_boxes(plan, surface, points):
    """Distance from each point to the nearest face of a box of this kind."""
    chosen = plan.boxes.surface == surface
    beyond = np.maximum(
        plan.boxes.lower[chosen] - points[:, None], points[:, None] - plan.boxes.upper[chosen]
    )
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=2)
    inside = -np.minimum(beyond.max(axis=2), 0)
    return (outside + inside).min(axis=1)


def off_cylinders(centre, radius, top, points):
    """Distance from each point to the surface of its cylinders, (n, m)."""
    beyond = np.stack(
        [
            np.linalg.norm(points[:, None, :2] - centre, axis=2) - radius,
            np.maximum(points[:, None, 2] - top, -points[:, None, 2]),
        ]
    )
    return np.linalg.norm(np.maximum(beyond, 0), axis=0) - np.minimum(beyond.max(axis=0), 0)


def test_same_seed_same_bits_another_seed_another_map():
    first, again, other = (simulate(SimulationParameters(**SHORT, seed=s)) for s in (7, 7, 8))
    for name in ARRAYS:
        assert getattr(first, name).tobytes() == getattr(again, name).tobytes()
    assert first.xyz.tobytes() != other.xyz.tobytes()


def test_people_change_neither_noise_nor_drift():
    few, many = (simulate(SimulationParameters(**SHORT, walkers=w)) for w in (0, 9))
    assert np.array_equal(few.estimated_poses, many.estimated_poses)


def test_arrays_have_the_promised_types_and_one_length(default_map):
    count = len(default_map.xyz)
    assert 150_000 <= count <= 200_000
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


def test_without_noise_every_point_lies_on_its_surface(exact_map):
    plan = indoor_floor_plan()
    for surface in (Surface.FLOOR, Surface.WALL, Surface.CEILING, Surface.FURNITURE):
        points = exact_map.xyz[exact_map.surface == surface].astype(float)
        own = plan.cylinders.surface == surface
        distance = off_boxes(plan, surface, points)
        if own.any():
            round_ones = off_cylinders(
                plan.cylinders.centre[:, own],
                plan.cylinders.radius[own],
                plan.cylinders.top[own],
                points,
            )
            distance = np.minimum(distance, round_ones.min(axis=1))
        # float32 resolves about 2 micrometres at 30 m.
        assert len(points) > 100
        assert distance.max() < 1e-5


def test_moving_points_lie_on_people_and_others_do_not(exact_map):
    """The people are placed anew, by the same seed, at the time of each point."""
    parameters = exact_map.parameters
    plan = indoor_floor_plan()
    people_seed = np.random.SeedSequence(parameters.seed).spawn(3)[0]
    people = populate(
        plan,
        parameters.walkers,
        parameters.queuers,
        parameters.duration,
        np.random.default_rng(people_seed),
    )
    robot = drive(plan.robot_route, parameters.robot_speed, parameters.duration)
    cylinders = people.at(exact_map.time, robot.at(exact_map.time)[:, :2])
    points = exact_map.xyz.astype(float)
    distance = off_cylinders(cylinders.centre, cylinders.radius, cylinders.top, points)
    moving = exact_map.moving == 1
    assert moving.sum() > 500
    assert distance[moving].min(axis=1).max() < 1e-5
    assert (distance[~moving].min(axis=1) < 1e-5).mean() < 1e-3
    assert np.array_equal(moving, exact_map.surface == Surface.PERSON)


def test_no_people_no_ghosts():
    assert not simulate(SimulationParameters(**SHORT, walkers=0, queuers=0)).moving.any()


def test_no_ray_passes_through_a_solid(exact_map):
    """Stepped along each ray from the sensor to the point, by membership in the boxes."""
    plan = indoor_floor_plan()
    robot = drive(plan.robot_route, exact_map.parameters.robot_speed, exact_map.parameters.duration)
    chosen = np.random.default_rng(0).choice(len(exact_map.xyz), 200, replace=False)
    origin = robot.at(exact_map.time[chosen])
    origin[:, 2] = exact_map.parameters.sensor_height
    way = exact_map.xyz[chosen] - origin
    # Each point of a solid thicker than a step is found; the thinnest, a table's top, is 3 cm.
    for share in np.linspace(0, 1, 1500)[:-1]:
        points = (origin + share * way)[:, None]
        inside = (points > plan.boxes.lower + 1e-5) & (points < plan.boxes.upper - 1e-5)
        assert not inside.all(axis=2).any()


def test_rings_are_sixteen_two_degrees_apart(exact_map):
    assert np.degrees(RING_ELEVATIONS) == pytest.approx(np.arange(-15, 16, 2))
    robot = drive(
        indoor_floor_plan().robot_route,
        exact_map.parameters.robot_speed,
        exact_map.parameters.duration,
    )
    origin = robot.at(exact_map.time)
    origin[:, 2] = exact_map.parameters.sensor_height
    way = exact_map.xyz - origin
    elevation = np.degrees(np.arctan2(way[:, 2], np.hypot(way[:, 0], way[:, 1])))
    ring = np.round((elevation + 15) / 2)
    assert np.abs(elevation - (2 * ring - 15)).max() < 1e-3
    assert set(ring) == set(range(16))


def test_rotation_covers_the_circle_evenly_in_the_time_of_a_turn():
    parameters = SimulationParameters(azimuth_step=2.0, rotation_rate=20.0)
    turn = rotation(parameters, np.random.default_rng(0))
    assert turn.directions.shape == (180 * 16, 3)
    assert np.linalg.norm(turn.directions, axis=1) == pytest.approx(1)
    azimuth = np.unwrap(np.arctan2(turn.directions[::16, 1], turn.directions[::16, 0]))
    assert np.degrees(np.diff(azimuth)) == pytest.approx(2.0)
    assert turn.delay.min() >= 0
    assert turn.delay.max() < 1 / 20


def test_range_noise_has_its_deviation_and_ranges_are_rounded():
    parameters = SimulationParameters(range_noise=0.02, range_resolution=0.004)
    distance = np.full(100_000, 5.0)
    ranges = measured_ranges(distance, parameters, np.random.default_rng(0))
    # Standard errors at this size: 6e-5 of the mean, 5e-5 of the deviation.
    assert ranges.mean() == pytest.approx(5.0, abs=3e-4)
    assert ranges.std() == pytest.approx(np.hypot(0.02, 0.004 / np.sqrt(12)), abs=3e-4)
    steps = ranges / 0.004
    assert np.abs(steps - np.round(steps)).max() < 1e-9


def test_ranges_outside_the_limits_are_not_reported():
    parameters = SimulationParameters(min_range=1.0, max_range=20.0)
    distance = np.array([0.5, 1.5, 19.0, 21.0, np.inf])
    ranges = measured_ranges(distance, parameters, np.random.default_rng(0))
    assert np.isfinite(ranges).tolist() == [False, True, True, False, False]


def test_drift_starts_at_zero_and_stays_within_its_deviation():
    parameters = SimulationParameters(scans=20_000, rotations_per_scan=100)
    errors = drift(parameters, np.random.default_rng(0))
    assert not errors[0].any()
    assert errors[:, :3].std(axis=0) == pytest.approx([parameters.drift_position] * 3, rel=0.05)
    assert np.degrees(errors[:, 3].std()) == pytest.approx(parameters.drift_heading, rel=0.05)


def test_noise_and_drift_thicken_walls(default_map):
    """Points of the hall's south wall, whose inner face is at y = 0.1, seen along its middle."""
    x, y, z = default_map.xyz[default_map.surface == Surface.WALL].T
    face = y[(np.abs(y - 0.1) < 0.08) & (x > 6) & (x < 7.8) & (z > 0.3)]
    assert len(face) > 500
    assert abs(face.mean() - 0.1) < 0.02
    assert 0.01 < face.std() < 0.04


def test_poses_take_scans_back_to_the_sensor_whatever_their_error():
    """Drifted scans, by their estimated poses, are the scans without drift, by their true ones."""
    parameters = SimulationParameters(scans=8, rotations_per_scan=40, drift_heading=5)
    steady = parameters.model_copy(update={"drift_heading": 0.0, "drift_position": 0.0})
    for drifted, true in zip(simulate_scans(parameters), simulate_scans(steady), strict=True):
        local = [
            (xyz - pose[:, 3]) @ pose[:, :3]
            for xyz, pose in ((drifted.xyz, drifted.estimated_pose), (true.xyz, true.true_pose))
        ]
        assert local[0] == pytest.approx(local[1])
        assert np.array_equal(drifted.true_pose, true.true_pose)
        floor = local[1][true.surface == Surface.FLOOR]
        assert len(floor) > 10
        assert floor[:, 2].mean() == pytest.approx(-parameters.sensor_height, abs=0.005)
    assert not np.allclose(drifted.xyz, true.xyz, atol=0.1)


def test_ghosts_are_less_dense_than_what_stands_still(default_map):
    """The premise of the method: k over hull volume tells ghosts from static surfaces."""
    upright = ~np.isin(default_map.surface, (Surface.FLOOR, Surface.CEILING))
    points = default_map.xyz[upright].astype(float)
    moving = default_map.moving[upright] == 1
    random = np.random.default_rng(0)
    queries = np.concatenate(
        [random.choice(np.flatnonzero(moving == kind), 500, replace=False) for kind in (0, 1)]
    )
    _, neighbours = cKDTree(points).query(points[queries], k=75)
    density = np.array([75 / ConvexHull(points[rows]).volume for rows in neighbours])
    truth = moving[queries]
    assert np.median(density[~truth]) > 4 * np.median(density[truth])
    assert roc_auc_score(truth, -density) > 0.8


def test_files_hold_what_was_simulated(tmp_path):
    simulated = simulate(SimulationParameters(scans=30, seed=4))
    files = write_simulated_map(simulated, tmp_path / "new" / "folder")
    assert sorted(path.name for path in files.map.parent.iterdir()) == [
        "map.pcd",
        "poses.txt",
        "simulation.yaml",
        "truth.parquet",
    ]
    reader = open_map(files.map)
    assert [(field.name, field.dtype) for field in reader.description.fields] == [
        ("x", "float32"),
        ("y", "float32"),
        ("z", "float32"),
        ("intensity", "float32"),
        ("time", "float64"),
        ("scan", "uint32"),
    ]
    xyz = np.concatenate([batch.xyz for batch in reader.batches()])
    assert np.array_equal(xyz, simulated.xyz.astype(float))

    body = files.map.read_bytes().split(b"DATA binary\n", 1)[1]
    rows = np.frombuffer(body, "<f4,<f4,<f4,<f4,<f8,<u4")
    assert np.array_equal(rows["f3"], simulated.intensity)
    assert np.array_equal(rows["f4"], simulated.time)
    assert np.array_equal(rows["f5"], simulated.scan)

    truth = pq.read_table(files.truth)
    assert truth["moving"].to_pylist() == simulated.moving.astype(bool).tolist()
    titles = [Surface(number).title for number in simulated.surface]
    assert truth["surface"].to_pylist() == titles
    poses = np.loadtxt(files.poses).reshape(-1, 3, 4)
    assert poses == pytest.approx(simulated.estimated_poses, abs=1e-9)


def test_written_parameters_make_the_same_bytes_again(tmp_path):
    first = write_simulated_map(simulate(SimulationParameters(scans=20, seed=6)), tmp_path / "a")
    parameters = SimulationParameters(**yaml.safe_load(first.parameters.read_text()))
    again = write_simulated_map(simulate(parameters), tmp_path / "b")
    for name in ("map", "truth", "poses", "parameters"):
        assert getattr(first, name).read_bytes() == getattr(again, name).read_bytes()


def test_writing_again_replaces(tmp_path):
    for seed in (1, 2):
        simulated = simulate(SimulationParameters(scans=3, seed=seed))
        files = write_simulated_map(simulated, tmp_path)
    assert open_map(files.map).description.point_count == len(simulated.xyz)
    assert pq.read_table(files.truth).num_rows == len(simulated.xyz)


def test_folder_that_cannot_be_made_is_one_clear_line(tmp_path):
    (tmp_path / "taken").write_text("a file")
    simulated = simulate(SimulationParameters(scans=1))
    with pytest.raises(OutputError, match=r"taken/sub: expected a folder to write in, found Not a"):
        write_simulated_map(simulated, tmp_path / "taken" / "sub")


@pytest.mark.parametrize("wrong", [{"sedd": 1}, {"scans": 0}, {"range_noise": -1}, {"queuers": 7}])
def test_wrong_parameters_are_refused(wrong):
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        SimulationParameters(**wrong)


def test_every_parameter_says_what_it_is():
    assert all(field.description for field in SimulationParameters.model_fields.values())
