"""Every scene leaves room to move, and all that moves does so as it should."""

import numpy as np
import pytest

from pipeline.simulation import SceneKind, SimulationParameters, Surface, build_scene
from pipeline.simulation.indoor import LENGTH, WIDTH, indoor_scene
from pipeline.simulation.motion import CLEARANCE, TURN_RATE, Trajectory, drive, keep_clear
from pipeline.simulation.movers import WALKING_SPEED, populate
from pipeline.simulation.raycasting import first_hits
from pipeline.simulation.scene import Shapes

SQUARE = np.array([(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (4.0, 4.0, 0.0), (0.0, 4.0, 0.0)])
TIMES = np.arange(0, 200, 0.25)

every_scene = pytest.mark.parametrize("kind", list(SceneKind))


def scene_of(kind, seed=0, glass=True):
    return build_scene(SimulationParameters(scene=kind, seed=seed, glass=glass))


def free_distance(scene, feet):
    """Distance in the plane from each place to the nearest solid from 0.3 to 1.7 m above it."""
    x0, y0, z0, x1, y1, z1, slope_x, slope_y = scene.shapes.boxes.T
    x, y, z = (feet[:, axis, None] for axis in range(3))
    nearest_x, nearest_y = np.clip(x, x0, x1), np.clip(y, y0, y1)
    lift = slope_x * nearest_x + slope_y * nearest_y
    in_the_way = (z0 + lift < z + 1.7) & (z1 + lift > z + 0.3)
    to_boxes = np.where(in_the_way, np.hypot(x - nearest_x, y - nearest_y), np.inf)
    cx, cy, radius, bottom, top = scene.shapes.cylinders.T
    in_the_way = (bottom < z + 1.7) & (top > z + 0.3)
    to_cylinders = np.where(in_the_way, np.hypot(x - cx, y - cy) - radius, np.inf)
    return np.minimum(to_boxes.min(axis=1), to_cylinders.min(axis=1))


def above_floor(scene, feet):
    """Height above the first floor under each place, looked for from half a metre above it."""
    origins = feet + [0, 0, 0.5]
    hits = first_hits(scene.shapes, origins, np.tile([0.0, 0.0, -1.0], (len(feet), 1)))
    assert (hits.surface == Surface.FLOOR).all()
    return hits.distance - 0.5


def test_trajectory_is_straight_between_its_times_and_stands_outside_them():
    poses = np.array([(0.0, 2.0, 1.0, 0.0, 0.0), (4.0, 2.0, 3.0, 1.0, 0.2)])
    states = Trajectory(np.array([1.0, 3.0]), poses).at(np.array([0.0, 1.0, 2.5, 9.0]))
    expected = [poses[0], poses[0], (3, 2, 2.5, 0.75, 0.15), poses[1]]
    assert states == pytest.approx(np.array(expected))


def test_drive_keeps_its_speed_faces_forward_and_returns():
    lap = 4 * (4 / 0.5 + np.pi / 2 / TURN_RATE)
    robot = drive(SQUARE, speed=0.5, duration=2 * lap)
    start, corner, again = robot.at(np.array([0.0, 8.0, lap]))
    assert start == pytest.approx(np.zeros(5))
    assert corner == pytest.approx((4, 0, 0, 0, 0))
    assert again == pytest.approx((0, 0, 0, 2 * np.pi, 0))
    times = np.arange(0, 2 * lap, 0.01)
    steps = np.diff(robot.at(times), axis=0)
    assert np.hypot(steps[:, 0], steps[:, 1]).max() == pytest.approx(0.005)
    assert np.abs(steps[:, 3]).max() == pytest.approx(TURN_RATE * 0.01)
    heading = robot.at(times)[:-1, 3]
    forward = steps[:, 0] * np.cos(heading) + steps[:, 1] * np.sin(heading)
    assert forward.min() > -1e-12


def test_drive_may_begin_part_of_a_lap_ahead():
    whole, ahead = (drive(SQUARE, 0.5, 100.0, ahead=share) for share in (0.0, 0.25))
    lap = 4 * (4 / 0.5 + np.pi / 2 / TURN_RATE)
    assert ahead.at(TIMES[:200]) == pytest.approx(whole.at(TIMES[:200] + lap / 4))


def test_people_make_way_for_what_is_on_wheels_and_only_then_leave_their_way():
    people = np.array([[(0.3, 0.0, 0.0), (2.0, 1.0, 0.0), (0.0, 0.0, 0.0), (0.3, 0.0, 3.2)]])
    moved = keep_clear(people, np.zeros((1, 3)))
    assert moved[0, 0] == pytest.approx((CLEARANCE, 0, 0))
    assert moved[0, 1] == pytest.approx((2, 1, 0))
    assert np.isfinite(moved).all()
    assert moved[0, 3] == pytest.approx((0.3, 0, 3.2)), "on another storey"


@every_scene
@pytest.mark.parametrize("seed", range(3))
def test_nobody_moves_through_anything(kind, seed):
    scene = scene_of(kind, seed)
    movers = populate(scene, 12, 6, 3, 200.0, np.random.default_rng(seed))
    for mover in movers.everyone:
        room = 0.27 if mover.on_foot else 0.56
        feet = mover.trajectory.at(TIMES)[:, :3]
        assert free_distance(scene, feet).min() > room
        assert (np.diff(mover.trajectory.times) >= 0).all()
    robot = drive(scene.robot_route, 0.9, 200.0).at(TIMES)[:, :3]
    assert free_distance(scene, robot).min() > 0.35


@every_scene
def test_feet_and_wheels_are_on_the_floor(kind):
    scene = scene_of(kind)
    movers = populate(scene, 12, 6, 3, 200.0, np.random.default_rng(1))
    ways = [mover.trajectory for mover in movers.everyone]
    ways.append(drive(scene.robot_route, 0.9, 200.0))
    for way in ways:
        # On the street, people step off a kerb of 0.12 m in a straight line.
        kerb = 0.15 if kind is SceneKind.STREET else 0.001
        assert np.abs(above_floor(scene, way.at(TIMES)[:, :3])).max() < kerb


@pytest.mark.parametrize(("kind", "rise"), [("storeys", 3.2), ("ramp", 1.2), ("street", 1.2)])
def test_robot_climbs_and_pitches_with_the_slope(kind, rise):
    robot = drive(scene_of(kind).robot_route, 0.9, 400.0).at(np.arange(0, 400, 0.5))
    assert np.ptp(robot[:, 2]) >= rise
    assert robot[:, 4].max() > 0.015
    assert robot[:, 4].min() < -0.015


@every_scene
def test_everybody_moves_at_a_walking_pace_and_stops(kind):
    movers = populate(scene_of(kind), 12, 4, 2, 200.0, np.random.default_rng(5))
    people = [mover.trajectory for mover in movers.everyone if mover.on_foot]
    assert len(people) == 16
    steps = [np.linalg.norm(np.diff(t.at(TIMES)[:, :2], axis=0), axis=1) for t in people]
    for step in steps:
        assert step.sum() > 5
        assert step.max() <= WALKING_SPEED[1] * 0.25 + 1e-9
    standing = [(step < 1e-12).mean() for step in steps]
    assert np.mean(standing[:12]) > 0.05
    assert np.mean(standing[12:]) > 0.5


@every_scene
def test_queue_moves_up_and_stays_a_queue(kind):
    scene = scene_of(kind)
    movers = populate(scene, 0, 4, 0, 300.0, np.random.default_rng(2))
    times = np.arange(0, 300, 0.5)
    places = np.stack([m.trajectory.at(times)[:, :2] for m in movers.everyone], axis=1)
    near = np.linalg.norm(places - scene.queue[0, :2], axis=2) < 0.3
    assert near.any(axis=0).all()
    assert near.sum(axis=1).max() == 1


@every_scene
def test_machines_keep_apart_on_their_round(kind):
    scene = scene_of(kind)
    movers = populate(scene, 0, 0, 4, 200.0, np.random.default_rng(3))
    places = np.stack([m.trajectory.at(TIMES)[:, :2] for m in movers.everyone], axis=1)
    apart = np.linalg.norm(places[:, :, None] - places[:, None], axis=3)
    apart[:, np.arange(4), np.arange(4)] = np.inf
    assert apart.min() > 1.0
    assert np.linalg.norm(np.diff(places, axis=0), axis=2).sum(axis=0).min() > 50


@every_scene
def test_another_seed_builds_another_scene_and_the_same_seed_the_same(kind):
    first, again, other = (scene_of(kind, seed).shapes.boxes for seed in (0, 0, 1))
    assert first.tobytes() == again.tobytes()
    assert first.shape != other.shape or not np.allclose(first, other)


@pytest.mark.parametrize("seed", range(4))
def test_indoor_floor_is_furnished(seed):
    surfaces = scene_of("indoor", seed).shapes
    assert (surfaces.box_surface == Surface.FURNITURE).sum() > 60
    assert (surfaces.cylinder_surface == Surface.WALL).sum() == 4, "pillars"
    assert LENGTH * WIDTH == 750


def test_mirrored_scene_is_the_same_scene_from_the_other_side():
    scene = scene_of("ramp")
    mirrored = scene.mirrored(0)
    random = np.random.default_rng(0)
    directions = random.normal(size=(500, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = np.tile(scene.robot_route[0] + [0, 0, 0.9], (500, 1))
    length = scene.size[0]
    here = first_hits(scene.shapes, origins, directions)
    there = first_hits(
        mirrored.shapes, [length, 0, 0] + origins * [-1, 1, 1], directions * [-1, 1, 1]
    )
    assert there.distance == pytest.approx(here.distance)
    assert mirrored.robot_route[0] == pytest.approx(
        [length - scene.robot_route[0, 0], *scene.robot_route[0, 1:]]
    )


def test_glass_lets_rays_pass_where_it_is_and_only_there():
    """From the hall to the south: through a window, below it, and beside it, in each building."""
    random = np.random.default_rng(1)
    origins = np.array([[10.0, 1.0, 1.5], [10.0, 1.0, 0.5], [16.0, 1.0, 1.5]])
    outward = np.tile([0.0, -1.0, 0.0], (3, 1))
    glazed, solid = (
        unmirrored(indoor_scene, random, glass, origins, outward) for glass in (True, False)
    )
    assert glazed == pytest.approx([np.inf, 0.9, 0.9])
    assert solid == pytest.approx([0.9, 0.9, 0.9])


def unmirrored(build, random, glass, origins, directions):
    """Cast at the walls of the first scene drawn whose counter says that it is not mirrored."""
    while True:
        scene = build(random, glass)
        if np.allclose(scene.queue[0, :2], (13.0, 8.0)):
            walls = scene.shapes.box_surface == Surface.WALL
            shapes = Shapes.of(scene.shapes.boxes[walls], scene.shapes.box_surface[walls])
            return first_hits(shapes, origins, directions).distance


@pytest.mark.parametrize("kind", ["indoor", "storeys", "ramp"])
def test_solid_building_is_closed(kind):
    """No ray leaves it from anywhere on the robot's route, in any direction."""
    scene = scene_of(kind, glass=False)
    random = np.random.default_rng(0)
    directions = random.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    corners = scene.robot_route[random.integers(len(scene.robot_route), size=2000)]
    origins = corners + [0, 0, 0.9]
    hits = first_hits(scene.shapes, origins, directions)
    points = origins + hits.distance[:, None] * directions
    assert (points >= np.array([-0.1, -0.1, -1e-9])).all()
    assert (points <= np.array([LENGTH + 0.1, WIDTH + 0.1, 6.7])).all()
