"""Building scenes of boxes and cylinders: walls with doors and panes, furniture, and where it goes.

All lengths are in metres.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise, product

import numpy as np

from pipeline.simulation.scene import Scene, Shapes, Surface
from pipeline.simulation.tables import Floats, Random

HEIGHT = 3.0
WALL_THICKNESS = 0.2
DOOR_HEIGHT = 2.1

ROBOT_MARGIN, MACHINE_MARGIN, PERSON_MARGIN, QUEUE_MARGIN = 0.6, 1.45, 0.4, 0.55
"""Room that each needs to either side of its way."""

_TRIES = 60  # to find a place for a piece of furniture
_STEP = 0.1  # between the points that stand for a way
_GAP = 0.1  # between a piece of furniture and the next

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Opening:
    """A hole in a wall, from start to end along it: a door, or a pane that rays pass."""

    start: float
    end: float
    bottom: float
    top: float
    glazed: bool


def door(start: float) -> Opening:
    """Return an open door, 1 m wide."""
    return Opening(start, start + 1.0, 0.0, DOOR_HEIGHT, glazed=False)


passage = partial(Opening, bottom=0.0, top=2.5, glazed=False)  # a wide way through
window = partial(Opening, bottom=0.9, top=2.3, glazed=True)  # over a parapet
glass_wall = partial(Opening, bottom=0.1, top=2.7, glazed=True)  # from the floor almost to the top


@dataclass(slots=True)
class Builder:
    """Gathers the solid bodies of a scene; heights are above the floor it stands on at present."""

    glass: bool = True
    base: float = 0.0
    slope: float = 0.0
    boxes: list[tuple[float, ...]] = field(default_factory=list)
    box_surfaces: list[Surface] = field(default_factory=list)
    cylinders: list[tuple[float, ...]] = field(default_factory=list)
    cylinder_surfaces: list[Surface] = field(default_factory=list)

    def shapes(self) -> Shapes:
        """Return all that was built."""
        return Shapes.of(self.boxes, self.box_surfaces, self.cylinders, self.cylinder_surfaces)

    @contextmanager
    def on(self, base: float, slope: float = 0.0) -> Iterator[None]:
        """Build on a floor that is `base` high at x = 0 and rises by `slope` along x."""
        before = self.base, self.slope
        self.base, self.slope = base, slope
        yield
        self.base, self.slope = before

    def box(self, x: Span, y: Span, z: Span, surface: Surface = Surface.FURNITURE) -> None:
        """Add a box from its bounds along each axis."""
        lower, upper = self.base + z[0], self.base + z[1]
        self.boxes.append((x[0], y[0], lower, x[1], y[1], upper, self.slope, 0.0))
        self.box_surfaces.append(surface)

    def cylinder(
        self, x: float, y: float, radius: float, z: Span, surface: Surface = Surface.FURNITURE
    ) -> None:
        """Add an upright cylinder about an axis, from its bounds above the floor."""
        floor = self.base + self.slope * x
        self.cylinders.append((x, y, radius, floor + z[0], floor + z[1]))
        self.cylinder_surfaces.append(surface)

    def floor(self, x: Span, y: Span) -> None:
        """Add a floor."""
        self.box(x, y, (-0.3, 0.0), Surface.FLOOR)

    def ceiling(self, x: Span, y: Span, height: float = HEIGHT) -> None:
        """Add a ceiling, 0.2 m thick."""
        self.box(x, y, (height, height + 0.2), Surface.CEILING)

    def wall(
        self,
        along: str,
        at: float,
        start: float,
        end: float,
        openings: tuple[Opening, ...] = (),
        height: float = HEIGHT,
    ) -> None:
        """Add a wall along "x" or "y" whose middle line is at `at`, with openings in order."""
        across = (at - WALL_THICKNESS / 2, at + WALL_THICKNESS / 2)

        def piece(first: float, last: float, bottom: float, top: float) -> None:
            if first < last and bottom < top:
                x, y = ((first, last), across) if along == "x" else (across, (first, last))
                self.box(x, y, (bottom, top), Surface.WALL)

        position = start
        for opening in openings:
            if opening.glazed and not self.glass:
                continue
            piece(position, opening.start, 0.0, height)
            piece(opening.start, opening.end, 0.0, opening.bottom)
            piece(opening.start, opening.end, opening.top, height)
            position = opening.end
        piece(position, end, 0.0, height)

    def pillar(self, x: float, y: float, height: float = HEIGHT) -> None:
        """Add a round pillar from the floor to the ceiling."""
        self.cylinder(x, y, 0.3, (0.0, height), Surface.WALL)

    def table(self, x: float, y: float, length: float = 1.6, depth: float = 0.8) -> None:
        """Add a table about (x, y): a thin top on four legs."""
        half_x, half_y, leg = length / 2, depth / 2, 0.05
        self.box((x - half_x, x + half_x), (y - half_y, y + half_y), (0.72, 0.75))
        for left in (x - half_x, x + half_x - leg):
            for front in (y - half_y, y + half_y - leg):
                self.box((left, left + leg), (front, front + leg), (0.0, 0.72))

    def chair(self, x: float, y: float, back: float) -> None:
        """Add a chair about (x, y): a seat on one foot, its back at y + `back`."""
        self.box((x - 0.22, x + 0.22), (y - 0.22, y + 0.22), (0.42, 0.47))
        self.cylinder(x, y, 0.06, (0.0, 0.42))
        self.box((x - 0.22, x + 0.22), (y + back - 0.02, y + back + 0.02), (0.47, 0.95))

    def desk(self, x: float, y: float) -> None:
        """Add a table with a screen on it and a chair to its south, 1.6 by 1.7 about (x, y)."""
        self.table(x, y + 0.45)
        self.box((x - 0.3, x + 0.3), (y + 0.55, y + 0.6), (0.8, 1.2))
        self.chair(x, y - 0.4, back=-0.2)

    def seats(self, x: float, y: float, size: Span, chairs: tuple[float, ...], away: float) -> None:
        """Add a table about (x, y) between two rows of chairs, which stand at `away` from it."""
        self.table(x, y, *size)
        for side, left in product((-1, 1), chairs):
            self.chair(x + left, y + side * away, back=side * 0.2)

    def plant(self, x: float, y: float) -> None:
        """Add a plant in a pot, 0.7 by 0.7 about (x, y)."""
        self.cylinder(x, y, 0.18, (0.0, 0.4))
        self.cylinder(x, y, 0.3, (0.4, 1.5), Surface.VEGETATION)


@dataclass(frozen=True, slots=True)
class Room:
    """A rectangle on one floor, between the faces of its walls."""

    x: Span
    y: Span


@dataclass(frozen=True, slots=True)
class Piece:
    """A piece of furniture that stands free: its footprint along x and y, and how it is built."""

    length: float
    depth: float
    build: Callable[[Builder, float, float], None]


DESK = Piece(1.6, 1.7, Builder.desk)
SEATS = Piece(1.2, 2.1, partial(Builder.seats, size=(1.2, 0.8), chairs=(-0.3, 0.3), away=0.6))
MEETING_TABLE = Piece(
    4.0, 2.8, partial(Builder.seats, size=(4.0, 1.4), chairs=(-1.3, 0.0, 1.3), away=1.0)
)
TABLE = Piece(1.8, 0.8, Builder.table)
PLANT = Piece(0.7, 0.7, Builder.plant)
PILLAR = Piece(0.6, 0.6, Builder.pillar)


class Furnisher:
    """Places furniture in rooms, away from the ways of a scene and from each other.

    `rounds` says whether those of the machines and of who queues are among them.
    """

    def __init__(
        self, builder: Builder, random: Random, scene: Scene, *, rounds: bool = True
    ) -> None:
        self._builder = builder
        self._random = random
        ways = [(_points_along(corners), room) for corners, room in _ways_of(scene, rounds)]
        self._ways = np.concatenate([points for points, _ in ways])
        self._margins = np.concatenate([np.full(len(points), room) for points, room in ways])
        self._taken: list[tuple[float, float, float, float]] = []

    def take(self, x: Span, y: Span) -> None:
        """Keep furniture out of a rectangle, such as one that stands there already."""
        self._taken.append((x[0], y[0], x[1], y[1]))

    def cabinet(self, x: Span, y: Span, top: float) -> None:
        """Build a closed piece of furniture in a given place."""
        self._builder.box(x, y, (0.0, top))
        self.take(x, y)

    def free_standing(self, room: Room, piece: Piece, count: int) -> None:
        """Place up to `count` pieces anywhere in a room, as far as there is space."""
        for _ in range(count):
            for _ in range(_TRIES):
                x, y = (
                    self._random.uniform(low + size / 2, max(high - size / 2, low + size / 2))
                    for (low, high), size in ((room.x, piece.length), (room.y, piece.depth))
                )
                if self._claim(room, x, y, piece.length, piece.depth):
                    piece.build(self._builder, x, y)
                    break

    def along_walls(
        self, room: Room, count: int, lengths: Span, depth: float, heights: Span
    ) -> None:
        """Place up to `count` cabinets with their backs to a wall of a room."""
        for _ in range(count):
            length, top = self._random.uniform(*lengths), self._random.uniform(*heights)
            for _ in range(_TRIES):
                side, share = int(self._random.integers(4)), self._random.random()
                across, along = (room.x, room.y) if side < 2 else (room.y, room.x)
                near_wall = across[0] + depth / 2 if side % 2 else across[1] - depth / 2
                middle = along[0] + length / 2 + share * (along[1] - along[0] - length)
                x, y = (near_wall, middle) if side < 2 else (middle, near_wall)
                size_x, size_y = (depth, length) if side < 2 else (length, depth)
                if self._claim(room, x, y, size_x, size_y):
                    wide, deep = (x - size_x / 2, x + size_x / 2), (y - size_y / 2, y + size_y / 2)
                    self._builder.box(wide, deep, (0.0, top))
                    break

    def _claim(self, room: Room, x: float, y: float, length: float, depth: float) -> bool:
        """Take a rectangle about (x, y) if it is free."""
        x0, x1, y0, y1 = x - length / 2, x + length / 2, y - depth / 2, y + depth / 2
        within = room.x[0] - 1e-9 <= x0 and x1 <= room.x[1] + 1e-9
        if not (within and room.y[0] - 1e-9 <= y0 and y1 <= room.y[1] + 1e-9):
            return False
        for a0, b0, a1, b1 in self._taken:
            if a0 < x1 + _GAP and x0 - _GAP < a1 and b0 < y1 + _GAP and y0 - _GAP < b1:
                return False
        apart = np.maximum([x0, y0] - self._ways, self._ways - [x1, y1])
        away = np.hypot(*np.maximum(apart, 0.0).T)
        if (away < self._margins).any():
            return False
        self._taken.append((x0, y0, x1, y1))
        return True


def _ways_of(scene: Scene, rounds: bool) -> list[tuple[Floats, float]]:
    """Return the corners of all ways of a scene, and the room that each needs to either side."""
    routes = [(scene.robot_route, ROBOT_MARGIN)]
    if rounds:
        queue = np.concatenate([scene.queue, scene.queue_return[::-1]])
        routes += [(scene.machine_route, MACHINE_MARGIN), (queue, QUEUE_MARGIN)]
    ways = [(np.concatenate([route, route[:1]]), room) for route, room in routes]
    for here, onward in zip(scene.walkways.places, scene.walkways.ways, strict=True):
        for there in (scene.walkways.places[place] for place in onward):
            corners = np.array([(here.x, here.y), (there.x, there.y)])
            margin = PERSON_MARGIN + np.sqrt(2) * max(here.freedom, there.freedom)
            ways.append((corners, margin))
    return ways


def _points_along(corners: Floats) -> Floats:
    """Return points along a way of (m, 2 or 3) corners, `_STEP` apart, (n, 2)."""
    pieces = [
        np.linspace(here, there, 1 + int(np.hypot(*(there - here)) / _STEP), endpoint=False)
        for here, there in pairwise(corners[:, :2])
    ]
    return np.concatenate([*pieces, corners[-1:, :2]])
