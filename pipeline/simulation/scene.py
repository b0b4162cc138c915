"""A scene: what stands still, and the ways that people, machines and the robot take.

Solid things are boxes, which may lie on a slope, and upright cylinders: enough for floors, ramps,
walls, furniture, people, machines and trees, and the distance along a ray to either is exact.
All lengths are in metres.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import IntEnum, StrEnum
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.tables import Columns, Floats, Random


class SceneKind(StrEnum):
    """The scenes that can be simulated."""

    INDOOR = "indoor"
    STOREYS = "storeys"
    RAMP = "ramp"
    STREET = "street"


class Surface(IntEnum):
    """The kind of thing a point lies on."""

    FLOOR = 0
    WALL = 1
    CEILING = 2
    FURNITURE = 3
    PERSON = 4
    MACHINE = 5
    VEHICLE = 6
    VEGETATION = 7

    @property
    def title(self) -> str:
        """The name used in files: `floor`, `wall` and so on."""
        return self.name.lower()


@dataclass(frozen=True, slots=True)
class Shapes(Columns):
    """Solid bodies.

    The points of a box have x and y within its bounds, and z - slope_x x - slope_y y between its
    lower and upper z.
    """

    boxes: Floats  # (b, 8): lower x, y, z, upper x, y, z, and the slopes along x and y
    box_surface: NDArray[np.uint8]  # the `Surface` of each
    cylinders: Floats  # (c, 5): x and y of the axis, radius, bottom and top
    cylinder_surface: NDArray[np.uint8]

    @classmethod
    def of(
        cls,
        boxes: Sequence[Sequence[float]] = (),
        box_surface: Sequence[int] = (),
        cylinders: Sequence[Sequence[float]] = (),
        cylinder_surface: Sequence[int] = (),
    ) -> "Shapes":
        """Make shapes from rows, none among them."""
        return cls(
            np.array(boxes, dtype=np.float64).reshape(-1, 8),
            np.array(box_surface, dtype=np.uint8),
            np.array(cylinders, dtype=np.float64).reshape(-1, 5),
            np.array(cylinder_surface, dtype=np.uint8),
        )

    def reach(self) -> float:
        """Return the greatest distance of any part from the z axis."""
        corners = np.abs(self.boxes[:, [0, 1, 3, 4]]).reshape(-1, 2, 2).max(axis=1, initial=0.0)
        away = np.hypot(self.cylinders[:, 0], self.cylinders[:, 1]) + self.cylinders[:, 2]
        return float(max(np.hypot(*corners.T).max(initial=0.0), away.max(initial=0.0)))

    def mirrored(self, axis: int, length: float) -> "Shapes":
        """Swap left and right along x (axis 0) or y (axis 1), within 0 to `length`."""
        boxes, cylinders = self.boxes.copy(), self.cylinders.copy()
        boxes[:, axis] = length - self.boxes[:, axis + 3]
        boxes[:, axis + 3] = length - self.boxes[:, axis]
        # z - slope x, with x = length - x': what is left of the slope is added to the bounds.
        slope = self.boxes[:, axis + 6]
        boxes[:, [2, 5]] += (slope * length)[:, None]
        boxes[:, axis + 6] = -slope
        cylinders[:, axis] = length - self.cylinders[:, axis]
        return replace(self, boxes=boxes, cylinders=cylinders)


@dataclass(frozen=True, slots=True)
class Place:
    """A place that people walk to, at (x, y) on a floor of height z.

    They may pass or stand as far from its middle, along each axis, as its freedom is.
    """

    x: float
    y: float
    freedom: float
    z: float = 0.0


@dataclass(frozen=True, slots=True)
class Walkways:
    """Where people walk."""

    places: tuple[Place, ...]  # where they turn, pass or stop
    ways: tuple[tuple[int, ...], ...]  # of each, the places that a straight line leads to

    @classmethod
    def along(cls, places: Mapping[str, Place], lines: Sequence[Sequence[str]]) -> "Walkways":
        """Join places by lines from name to name."""
        ways: dict[str, list[int]] = {name: [] for name in places}
        numbers = {name: number for number, name in enumerate(places)}
        for line in lines:
            for here, there in pairwise(line):
                ways[here].append(numbers[there])
                ways[there].append(numbers[here])
        return cls(tuple(places.values()), tuple(map(tuple, ways.values())))


@dataclass(frozen=True, slots=True)
class Scene:
    """All that stands still, and where one can go."""

    walkways: Walkways
    queue: Floats  # (s, 3), slots of the queue, from the counter to its end
    queue_return: Floats  # (m, 3), corners of the way from the counter back to the end of the queue
    robot_route: Floats  # (m, 3), corners of a closed route on the floor
    machine_route: Floats
    machines: tuple[Callable[[Random], Shapes], ...]  # what makes those that drive, in turn
    machine_speed: float  # in metres per second
    size: tuple[float, float]  # along x and y from 0
    gap: float = 6.0  # to the next scene of its kind
    shapes: Shapes = field(default_factory=Shapes.of)

    def mirrored(self, axis: int) -> "Scene":
        """Swap left and right along x (axis 0) or y (axis 1), within the size."""
        length = self.size[axis]

        def turned(points: Floats) -> Floats:
            swapped = points.copy()
            swapped[:, axis] = length - points[:, axis]
            return swapped

        places = tuple(
            replace(place, x=length - place.x) if axis == 0 else replace(place, y=length - place.y)
            for place in self.walkways.places
        )
        names = ("queue", "queue_return", "robot_route", "machine_route")
        ways: dict[str, Any] = {name: turned(getattr(self, name)) for name in names}
        return replace(
            self,
            shapes=self.shapes.mirrored(axis, length),
            walkways=replace(self.walkways, places=places),
            **ways,
        )


def on_floor(corners: Sequence[Sequence[float]], height: float = 0.0) -> Floats:
    """Return (m, 3) corners of a way from (x, y), at the floor's height, or from (x, y, z)."""
    return np.array([(*corner[:2], corner[2] if len(corner) > 2 else height) for corner in corners])
