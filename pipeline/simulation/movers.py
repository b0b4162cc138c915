"""People who walk about, stop and queue, and machines that drive."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.simulation.motion import CLEARANCE, Trajectory, drive, keep_clear
from pipeline.simulation.scene import Scene, Shapes, Surface, Walkways
from pipeline.simulation.tables import Floats, Random

WALKING_SPEED = (0.9, 1.6)  # slowest and fastest walker, in metres per second
STOP_PROBABILITY = 0.25  # how often a walker stops at a place
STOP_SECONDS = (2.0, 8.0)  # shortest and longest stop
SERVICE_SECONDS = (8.0, 16.0)  # shortest and longest time that the counter takes for one person

_MACHINE_CLEARANCE = 0.35  # metres between a machine's farthest corner and a person's axis


@dataclass(frozen=True, slots=True)
class Mover:
    """Someone or something that moves, and its shapes, x ahead and z up from the floor.

    Who is on foot makes way for what is on wheels.
    """

    trajectory: Trajectory
    shapes: Shapes
    on_foot: bool


class Movers:
    """All p that move in a scene, people on foot first.

    `shapes`, `starts` and `reach` are as `first_moving_hits` takes them.
    """

    def __init__(self, everyone: Sequence[Mover]) -> None:
        self.everyone = tuple(sorted(everyone, key=lambda mover: not mover.on_foot))
        parts = [mover.shapes for mover in self.everyone]
        counts = [(len(part.boxes), len(part.cylinders)) for part in parts]
        self.shapes = Shapes.joined([Shapes.of(), *parts])
        self.starts = np.cumsum([(0, 0), *counts], axis=0)
        self.reach = np.array([part.reach() for part in parts])

    def at(self, times: Floats, robot: Floats) -> Floats:
        """Return the poses of all at n times, (n, p, 5).

        People keep out of the way of the machines and of the robot, whose poses, (n, 5), are given.
        """
        poses = np.empty((len(times), len(self.everyone), 5))
        for number, mover in enumerate(self.everyone):
            poses[:, number] = mover.trajectory.at(times)
        on_foot = sum(mover.on_foot for mover in self.everyone)
        for machine in range(on_foot, len(self.everyone)):
            clearance = self.reach[machine] + _MACHINE_CLEARANCE
            poses[:, :on_foot] = keep_clear(poses[:, :on_foot], poses[:, machine], clearance)
        poses[:, :on_foot] = keep_clear(poses[:, :on_foot], robot, CLEARANCE)
        return poses


def populate(
    scene: Scene, walkers: int, queuers: int, machines: int, duration: float, random: Random
) -> Movers:
    """Send people and machines through a scene for `duration` seconds."""
    ways = [_walk(scene.walkways, duration, random) for _ in range(walkers)]
    ways += _queue(scene, queuers, duration, random)
    everyone = [Mover(way, person_shapes(random), on_foot=True) for way in ways]
    for number in range(machines):
        machine = scene.machines[number % len(scene.machines)]
        # All keep the same distance on their round, whatever it is at the beginning.
        ahead = (number + random.uniform(0.0, 0.2)) / machines
        way = drive(scene.machine_route, scene.machine_speed, duration, ahead)
        everyone.append(Mover(way, machine(random), on_foot=False))
    return Movers(everyone)


def person_shapes(random: Random) -> Shapes:
    """Return a body and a head."""
    height, radius = random.uniform(1.55, 1.85), random.uniform(0.2, 0.27)
    rows = [(0.0, 0.0, radius, 0.0, height - 0.25), (0.0, 0.0, 0.1, height - 0.25, height)]
    return Shapes.of(cylinders=rows, cylinder_surface=[Surface.PERSON] * 2)


def bicycle(random: Random) -> Shapes:
    """Return a bicycle and its rider."""
    frame = (-0.85, -0.04, 0.0, 0.85, 0.04, 0.75, 0.0, 0.0)
    rider = (-0.1, 0.0, 0.22, 0.75, random.uniform(1.6, 1.85))
    return Shapes.of([frame], [Surface.VEHICLE], [rider], [Surface.PERSON])


def automated_vehicle(random: Random) -> Shapes:
    """Return an automated guided vehicle and its load."""
    top = 0.35 + random.uniform(0.6, 1.2)
    boxes = [(-0.7, -0.45, 0.05, 0.7, 0.45, 0.35), (-0.6, -0.4, 0.35, 0.6, 0.4, top)]
    return _upright_boxes(boxes, Surface.MACHINE)


def forklift(random: Random) -> Shapes:
    """Return a forklift with a load on its fork."""
    boxes = [
        (-1.0, -0.55, 0.1, 0.5, 0.55, 1.1),  # body
        (-0.7, -0.5, 2.05, 0.45, 0.5, 2.1),  # roof
        (0.5, -0.45, 0.1, 0.6, 0.45, 2.2),  # mast
        (0.6, -0.5, 0.15, 1.2, 0.5, 0.15 + random.uniform(0.6, 1.2)),  # load on the fork
    ]
    posts = [(x, y) for x in (-0.7, 0.4) for y in (-0.5, 0.45)]
    boxes += [(x, y, 1.1, x + 0.05, y + 0.05, 2.05) for x, y in posts]
    return _upright_boxes(boxes, Surface.MACHINE)


def car(random: Random) -> Shapes:
    """Return a car, or now and then a van: its body, its cabin and its wheels as one box each."""
    half, width = random.uniform(1.95, 2.3), random.uniform(0.82, 0.92)
    roof = 2.2 if random.random() < 0.2 else random.uniform(1.4, 1.65)
    boxes = [
        (-half, -width, 0.25, half, width, 0.85),
        (-half + 0.2, -width + 0.1, 0.85, half - 1.2, width - 0.1, roof),
        (-half + 0.4, -width, 0.0, -half + 1.0, width, 0.25),
        (half - 1.0, -width, 0.0, half - 0.4, width, 0.25),
    ]
    return _upright_boxes(boxes, Surface.VEHICLE)


def _upright_boxes(boxes: Sequence[tuple[float, ...]], surface: Surface) -> Shapes:
    return Shapes.of([(*box, 0.0, 0.0) for box in boxes], [surface] * len(boxes))


def _walk(walkways: Walkways, duration: float, random: Random) -> Trajectory:
    """Walk from place to place at random, and stop at some; turn back only in dead ends."""
    speed = random.uniform(*WALKING_SPEED)
    here, before = int(random.integers(len(walkways.places))), -1
    time = 0.0
    position = _spot(walkways, here, random)
    times, positions = [time], [position]
    while time <= duration:
        onward = [place for place in walkways.ways[here] if place != before] or [before]
        here, before = onward[int(random.integers(len(onward)))], here
        target = _spot(walkways, here, random)
        time += float(np.hypot(*(target - position)[:2])) / speed
        position = target
        times.append(time)
        positions.append(position)
        if random.random() < STOP_PROBABILITY:
            time += random.uniform(*STOP_SECONDS)
            times.append(time)
            positions.append(position)
    return _upright(times, positions)


def _spot(walkways: Walkways, place: int, random: Random) -> Floats:
    """Return a point within the freedom of a place."""
    chosen = walkways.places[place]
    shift = random.uniform(-chosen.freedom, chosen.freedom, 2)
    return np.array([chosen.x + shift[0], chosen.y + shift[1], chosen.z])


def _queue(scene: Scene, queuers: int, duration: float, random: Random) -> list[Trajectory]:
    """Queue at the counter: whoever is served walks around and joins again at the end."""
    slots = scene.queue[:queuers].copy()
    slots[:, :2] += random.uniform(-0.1, 0.1, (queuers, 2))
    times = [[0.0] for _ in range(queuers)]
    positions = [[slot] for slot in slots]
    order = list(range(queuers))
    time = 0.0
    while queuers and time <= duration:
        time += random.uniform(*SERVICE_SECONDS)
        served = order.pop(0)
        order.append(served)
        for slot, person in enumerate(order):
            stops = [positions[person][-1], slots[slot]]
            if person == served:
                stops[1:1] = list(scene.queue_return)
            # One behind the other: each sets off a little after the person in front of them.
            start = time + (0.4 * slot if person != served else 0.0)
            lengths = np.hypot(*np.diff(np.array(stops)[:, :2], axis=0).T)
            times[person] += [start, *(start + np.cumsum(lengths) / np.mean(WALKING_SPEED))]
            positions[person].extend(stops)
    return [_upright(t, p) for t, p in zip(times, positions, strict=True)]


def _upright(times: list[float], positions: list[Floats]) -> Trajectory:
    """Return a trajectory of someone who is the same from all sides."""
    poses = np.zeros((len(positions), 5))
    poses[:, :3] = positions
    return Trajectory(np.array(times), poses)
