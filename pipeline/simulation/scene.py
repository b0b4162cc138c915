"""A scene: all that stands still, and the ways that people, machines and the robot take.

All lengths are in metres.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.shapes import Shapes


class SceneKind(StrEnum):
    """The scenes that can be simulated."""

    INDOOR = "indoor"
    STOREYS = "storeys"
    RAMP = "ramp"
    STREET = "street"


class MachineKind(StrEnum):
    """The machines and vehicles that drive about."""

    FORKLIFT = "forklift"
    AGV = "agv"
    CAR = "car"
    BICYCLE = "bicycle"


@dataclass(frozen=True, slots=True)
class Place:
    """A place that people walk to.

    Attributes
    ----------
    x, y : float
        Its middle.
    freedom : float
        How far from the middle, along each axis, people may pass or stand.
    z : float
        Height of the floor.
    """

    x: float
    y: float
    freedom: float
    z: float = 0.0


@dataclass(frozen=True, slots=True)
class Walkways:
    """Where people walk.

    Attributes
    ----------
    places : tuple of Place
        Where they turn, pass or stop.
    ways : tuple of tuple of int
        For each place, the places that can be reached from it in a straight line.
    """

    places: tuple[Place, ...]
    ways: tuple[tuple[int, ...], ...]

    @classmethod
    def along(cls, places: Mapping[str, Place], lines: Sequence[Sequence[str]]) -> "Walkways":
        """Join places by lines from name to name."""
        number = {name: index for index, name in enumerate(places)}
        ways: list[list[int]] = [[] for _ in places]
        for line in lines:
            for here, there in pairwise(line):
                ways[number[here]].append(number[there])
                ways[number[there]].append(number[here])
        return cls(tuple(places.values()), tuple(map(tuple, ways)))


@dataclass(frozen=True, slots=True)
class Scene:
    """All that stands still, and where one can go.

    Attributes
    ----------
    shapes : Shapes
        Everything solid.
    walkways : Walkways
        Where people walk.
    queue : (s, 3) float64 array
        Slots of the queue, from the counter to its end.
    queue_return : (m, 3) float64 array
        Corners of the way from the counter back to the end of the queue.
    robot_route : (m, 3) float64 array
        Corners of the closed route of the robot, on the floor.
    machine_route : (m, 3) float64 array
        Corners of the closed route of the machines.
    machines : tuple of MachineKind
        Which machines drive, in turn.
    machine_speed : float
        In metres per second.
    size : (length, width)
        Along x and y from 0.
    gap : float
        Space to the next scene of its kind.
    """

    shapes: Shapes
    walkways: Walkways
    queue: NDArray[np.float64]
    queue_return: NDArray[np.float64]
    robot_route: NDArray[np.float64]
    machine_route: NDArray[np.float64]
    machines: tuple[MachineKind, ...]
    machine_speed: float
    size: tuple[float, float]
    gap: float = 6.0

    def mirrored(self, axis: int) -> "Scene":
        """Swap left and right along x (axis 0) or y (axis 1), within the size."""
        length = self.size[axis]

        def turned(points: NDArray[np.float64]) -> NDArray[np.float64]:
            swapped = points.copy()
            swapped[:, axis] = length - points[:, axis]
            return swapped

        places = tuple(
            replace(place, x=length - place.x) if axis == 0 else replace(place, y=length - place.y)
            for place in self.walkways.places
        )
        return replace(
            self,
            shapes=self.shapes.mirrored(axis, length),
            walkways=Walkways(places, self.walkways.ways),
            queue=turned(self.queue),
            queue_return=turned(self.queue_return),
            robot_route=turned(self.robot_route),
            machine_route=turned(self.machine_route),
        )


def on_floor(corners: Sequence[Sequence[float]], height: float = 0.0) -> NDArray[np.float64]:
    """Return (m, 3) corners of a way from (x, y), at the floor's height, or from (x, y, z)."""
    return np.array([(*corner[:2], corner[2] if len(corner) > 2 else height) for corner in corners])
