"""People who walk about, stop and queue."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.indoor import FloorPlan
from pipeline.simulation.motion import Trajectory, keep_clear
from pipeline.simulation.scene import Cylinders, Surface

WALKING_SPEED = (0.9, 1.6)
"""Slowest and fastest walker, in metres per second."""

STOP_PROBABILITY = 0.25
"""How often a walker stops at a place."""

STOP_SECONDS = (2.0, 8.0)
"""Shortest and longest stop."""

SERVICE_SECONDS = (8.0, 16.0)
"""Shortest and longest time that the counter takes for one person."""


@dataclass(frozen=True, slots=True)
class People:
    """Everybody in the building, each an upright cylinder.

    Attributes
    ----------
    trajectories : tuple of p Trajectory
        Of x and y.
    radius, height : (p,) float64 array
        In metres.
    """

    trajectories: tuple[Trajectory, ...]
    radius: NDArray[np.float64]
    height: NDArray[np.float64]

    def at(self, times: NDArray[np.float64], robot: NDArray[np.float64]) -> Cylinders:
        """Return the people as they stand at n times, out of the way of the robot.

        Parameters
        ----------
        times : (n,) float64 array
            In seconds.
        robot : (n, 2) float64 array
            Where the robot is at these times, in metres.
        """
        places = np.empty((len(times), len(self.trajectories), 2))
        for person, trajectory in enumerate(self.trajectories):
            places[:, person] = trajectory.at(times)
        return Cylinders(
            centre=keep_clear(places, robot),
            radius=self.radius,
            bottom=np.zeros_like(self.radius),
            top=self.height,
            surface=np.full(len(self.radius), Surface.PERSON, dtype=np.uint8),
        )


def populate(
    plan: FloorPlan, walkers: int, queuers: int, duration: float, random: np.random.Generator
) -> People:
    """Send people through a floor plan for `duration` seconds."""
    trajectories = [_walk(plan, duration, random) for _ in range(walkers)]
    trajectories += _queue(plan, queuers, duration, random)
    return People(
        trajectories=tuple(trajectories),
        radius=random.uniform(0.22, 0.28, len(trajectories)),
        height=random.uniform(1.55, 1.85, len(trajectories)),
    )


def _walk(plan: FloorPlan, duration: float, random: np.random.Generator) -> Trajectory:
    """Walk from place to place at random, and stop at some; turn back only in dead ends."""
    speed = random.uniform(*WALKING_SPEED)
    here, before = int(random.integers(len(plan.places))), -1
    time = 0.0
    position = _spot(plan, here, random)
    times, states = [time], [position]
    while time <= duration:
        onward = [place for place in plan.ways[here] if place != before] or [before]
        here, before = onward[int(random.integers(len(onward)))], here
        target = _spot(plan, here, random)
        time += float(np.hypot(*(target - position))) / speed
        position = target
        times.append(time)
        states.append(position)
        if random.random() < STOP_PROBABILITY:
            time += random.uniform(*STOP_SECONDS)
            times.append(time)
            states.append(position)
    return Trajectory(np.array(times), np.array(states))


def _spot(plan: FloorPlan, place: int, random: np.random.Generator) -> NDArray[np.float64]:
    """Return a point within the freedom of a place."""
    chosen = plan.places[place]
    shift = random.uniform(-chosen.freedom, chosen.freedom, 2)
    return np.array([chosen.x, chosen.y]) + shift


def _queue(
    plan: FloorPlan, queuers: int, duration: float, random: np.random.Generator
) -> list[Trajectory]:
    """Queue at the counter: whoever is served walks around and joins again at the end."""
    slots = plan.queue[:queuers] + random.uniform(-0.1, 0.1, (queuers, 2))
    times = [[0.0] for _ in range(queuers)]
    states = [[slot] for slot in slots]
    order = list(range(queuers))
    time = 0.0
    while queuers and time <= duration:
        time += random.uniform(*SERVICE_SECONDS)
        served = order.pop(0)
        order.append(served)
        for slot, person in enumerate(order):
            stops = [states[person][-1], slots[slot]]
            if person == served:
                stops[1:1] = list(plan.queue_return)
            # One behind the other: each sets off a little after the person in front of them.
            start = time + (0.4 * slot if person != served else 0.0)
            times[person].extend(_walking_times(start, np.array(stops)))
            states[person].extend(stops)
    return [Trajectory(np.array(t), np.array(s)) for t, s in zip(times, states, strict=True)]


def _walking_times(start: float, stops: NDArray[np.float64]) -> list[float]:
    """Return when each stop is reached at a walker's mean speed, the first at `start`."""
    lengths = np.hypot(*np.diff(stops, axis=0).T)
    return [start, *(start + np.cumsum(lengths) / np.mean(WALKING_SPEED))]
