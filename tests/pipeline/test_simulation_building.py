"""The floor plan leaves room to move, and people and robot move as they should."""

import numpy as np
import pytest

from pipeline.simulation.indoor import HEIGHT, LENGTH, WIDTH, indoor_floor_plan
from pipeline.simulation.motion import CLEARANCE, TURN_RATE, Trajectory, drive, keep_clear
from pipeline.simulation.people import WALKING_SPEED, populate
from pipeline.simulation.scene import Surface, first_hits

SQUARE = np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)])


def free_distance(plan, points):
    """Distance in the plane from each point to the nearest solid below head height."""
    low = (plan.boxes.lower[:, 2] < 1.8) & (plan.boxes.surface != Surface.FLOOR)
    outside = np.maximum(
        plan.boxes.lower[low, :2] - points[:, None], points[:, None] - plan.boxes.upper[low, :2]
    )
    to_boxes = np.linalg.norm(np.maximum(outside, 0), axis=2).min(axis=1)
    apart = np.linalg.norm(points[:, None] - plan.cylinders.centre, axis=2)
    return np.minimum(to_boxes, (apart - plan.cylinders.radius).min(axis=1))


@pytest.fixture(scope="module")
def plan():
    return indoor_floor_plan()


def test_trajectory_is_straight_between_its_times_and_stands_outside_them():
    trajectory = Trajectory(np.array([1.0, 3.0]), np.array([(0.0, 2.0), (4.0, 2.0)]))
    states = trajectory.at(np.array([0.0, 1.0, 2.5, 9.0]))
    assert states == pytest.approx(np.array([(0, 2), (0, 2), (3, 2), (4, 2)]))


def test_drive_keeps_its_speed_faces_forward_and_returns():
    lap = 4 * (4 / 0.5 + np.pi / 2 / TURN_RATE)
    robot = drive(SQUARE, speed=0.5, duration=2 * lap)
    start, corner, again = robot.at(np.array([0.0, 8.0, lap]))
    assert start == pytest.approx((0, 0, 0))
    assert corner == pytest.approx((4, 0, 0))
    assert again == pytest.approx((0, 0, 2 * np.pi))
    times = np.arange(0, 2 * lap, 0.01)
    steps = np.diff(robot.at(times), axis=0)
    assert np.hypot(steps[:, 0], steps[:, 1]).max() == pytest.approx(0.005)
    assert np.abs(steps[:, 2]).max() == pytest.approx(TURN_RATE * 0.01)
    heading = robot.at(times)[:-1, 2]
    forward = steps[:, 0] * np.cos(heading) + steps[:, 1] * np.sin(heading)
    assert forward.min() > -1e-12


def test_people_make_way_for_the_robot_and_only_then_leave_theirs():
    people = np.array([[(0.3, 0.0), (2.0, 1.0), (0.0, 0.0)]])
    moved = keep_clear(people, np.array([(0.0, 0.0)]))
    assert moved[0, 0] == pytest.approx((CLEARANCE, 0))
    assert moved[0, 1] == pytest.approx((2, 1))
    assert np.isfinite(moved).all()


@pytest.mark.parametrize("seed", range(3))
def test_people_never_walk_through_anything(plan, seed):
    people = populate(plan, 20, 6, 200.0, np.random.default_rng(seed))
    times = np.arange(0, 200, 0.1)
    for trajectory, radius in zip(people.trajectories, people.radius, strict=True):
        assert free_distance(plan, trajectory.at(times)).min() > radius
        assert (np.diff(trajectory.times) >= 0).all()


def test_robot_passes_through_nothing(plan):
    robot = drive(plan.robot_route, 0.9, 200.0)
    assert free_distance(plan, robot.at(np.arange(0, 200, 0.1))[:, :2]).min() > 0.35


def test_everybody_moves_walks_at_a_walking_pace_and_stops(plan):
    people = populate(plan, 12, 4, 200.0, np.random.default_rng(5))
    times = np.arange(0, 200, 0.1)
    for trajectory in people.trajectories:
        step = np.linalg.norm(np.diff(trajectory.at(times), axis=0), axis=1)
        assert step.sum() > 5
        assert step.max() <= WALKING_SPEED[1] * 0.1 + 1e-9
    standing = [
        (np.linalg.norm(np.diff(t.at(times), axis=0), axis=1) == 0).mean()
        for t in people.trajectories
    ]
    assert np.mean(standing[:12]) > 0.05
    assert np.mean(standing[12:]) > 0.5


def test_queue_moves_up_and_stays_a_queue(plan):
    people = populate(plan, 0, 4, 300.0, np.random.default_rng(2))
    times = np.arange(0, 300, 0.5)
    places = np.stack([t.at(times) for t in people.trajectories], axis=1)
    counter = plan.queue[0]
    near = np.linalg.norm(places - counter, axis=2) < 0.3
    assert near.any(axis=0).all()
    assert near.sum(axis=1).max() == 1


def test_glass_lets_rays_pass_where_it_is_and_only_there():
    origins = np.array([[10.0, 3.0, 1.5], [10.0, 3.0, 0.5], [15.0, 3.0, 1.5]])
    outward = np.tile([0.0, -1.0, 0.0], (3, 1))
    glazed = first_hits(indoor_floor_plan(glass=True).boxes, origins, outward).distance
    solid = first_hits(indoor_floor_plan(glass=False).boxes, origins, outward).distance
    assert glazed == pytest.approx([np.inf, 2.9, 2.9])
    assert solid == pytest.approx([2.9, 2.9, 2.9])


def test_solid_building_is_closed():
    """No ray leaves it from anywhere on the robot's route, in any direction."""
    plan = indoor_floor_plan(glass=False)
    random = np.random.default_rng(0)
    directions = random.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    corners = plan.robot_route[random.integers(len(plan.robot_route), size=2000)]
    origins = np.column_stack([corners, np.full(2000, 0.9)])
    hits = first_hits(plan.boxes, origins, directions)
    points = origins + hits.distance[:, None] * directions
    assert (points >= np.array([-0.1, -0.1, -1e-9])).all()
    assert (points <= np.array([LENGTH + 0.1, WIDTH + 0.1, HEIGHT + 1e-9])).all()
