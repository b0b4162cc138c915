"""Furniture at random places that leaves the ways free."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.construction import Builder, Span
from pipeline.simulation.scene import Scene

_TRIES = 60
_STEP = 0.1  # metres between the points that stand for a way
_GAP = 0.1  # metres between a piece of furniture and the next

ROBOT_MARGIN, MACHINE_MARGIN, PERSON_MARGIN, QUEUE_MARGIN = 0.6, 1.45, 0.4, 0.55
"""Room that each needs to either side of its way, in metres."""


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
SEATS = Piece(1.2, 2.1, Builder.seats)
MEETING_TABLE = Piece(4.0, 2.8, Builder.meeting_table)
TABLE = Piece(1.8, 0.8, Builder.table)
PLANT = Piece(0.7, 0.7, Builder.plant)
PILLAR = Piece(0.6, 0.6, Builder.pillar)


class Furnisher:
    """Places furniture in rooms, away from ways and from each other.

    Parameters
    ----------
    ways : sequence of ((n, 2) float64 array, float)
        Points along each way, `_STEP` apart, and the room it needs to either side.
    """

    def __init__(
        self,
        builder: Builder,
        random: np.random.Generator,
        ways: Sequence[tuple[NDArray[np.float64], float]],
    ) -> None:
        self._builder = builder
        self._random = random
        self._ways = np.concatenate([points for points, _ in ways])
        self._margins = np.concatenate([np.full(len(points), margin) for points, margin in ways])
        self._taken: list[tuple[float, float, float, float]] = []

    def take(self, x: Span, y: Span) -> None:
        """Keep furniture out of a rectangle, such as one that stands there already."""
        self._taken.append((x[0], y[0], x[1], y[1]))

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
                    self._builder.cabinet(
                        (x - size_x / 2, x + size_x / 2), (y - size_y / 2, y + size_y / 2), top
                    )
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


def route_points(route: NDArray[np.float64], *, closed: bool = True) -> NDArray[np.float64]:
    """Return points along a route of (m, 2 or 3) corners, `_STEP` apart, (n, 2)."""
    corners = np.concatenate([route, route[:1]]) if closed else route
    pieces = [
        np.linspace(here, there, 1 + int(np.hypot(*(there - here)) / _STEP), endpoint=False)
        for here, there in zip(corners[:-1, :2], corners[1:, :2], strict=True)
    ]
    return np.concatenate([*pieces, corners[-1:, :2]])


def ways_of(scene: Scene, *, rounds: bool = True) -> list[tuple[NDArray[np.float64], float]]:
    """Return points along all ways of a scene, and the room that each needs to either side.

    With the rounds of the machines and of those who queue, or without.
    """
    routes = [(scene.robot_route, ROBOT_MARGIN)]
    if rounds:
        queue = np.concatenate([scene.queue, scene.queue_return[::-1]])
        routes += [(scene.machine_route, MACHINE_MARGIN), (queue, QUEUE_MARGIN)]
    ways = [(route_points(route), room) for route, room in routes]
    for here, onward in zip(scene.walkways.places, scene.walkways.ways, strict=True):
        for place in onward:
            there = scene.walkways.places[place]
            corners = np.array([(here.x, here.y), (there.x, there.y)])
            margin = PERSON_MARGIN + np.sqrt(2) * max(here.freedom, there.freedom)
            ways.append((route_points(corners, closed=False), margin))
    return ways
