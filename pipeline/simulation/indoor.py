"""The building: walls with doors and panes, pillars, furniture, and the ways people and robot take.

An indoor floor plan of 750 square metres: a hall with a counter, a corridor, four rooms to its
north, and two rooms behind glass to the east of the hall. All lengths are in metres.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.scene import Boxes, Cylinders, Surface

LENGTH, WIDTH, HEIGHT = 30.0, 25.0, 3.0
WALL_THICKNESS = 0.2
DOOR_HEIGHT = 2.1


@dataclass(frozen=True, slots=True)
class Opening:
    """A hole in a wall: a door, or a pane that rays pass."""

    start: float
    end: float
    bottom: float
    top: float
    glazed: bool


def door(start: float, width: float = 1.0) -> Opening:
    """Return an open door."""
    return Opening(start, start + width, 0.0, DOOR_HEIGHT, glazed=False)


def window(start: float, end: float) -> Opening:
    """Return a window over a parapet."""
    return Opening(start, end, 0.9, 2.3, glazed=True)


def glass_wall(start: float, end: float) -> Opening:
    """Return a pane from the floor almost to the ceiling."""
    return Opening(start, end, 0.1, 2.7, glazed=True)


@dataclass(frozen=True, slots=True)
class Place:
    """A place that people walk to.

    Attributes
    ----------
    x, y : float
        Its middle.
    freedom : float
        How far from the middle, along each axis, people may pass or stand.
    """

    x: float
    y: float
    freedom: float


@dataclass(frozen=True, slots=True)
class FloorPlan:
    """All that stands still, and where one can go.

    Attributes
    ----------
    boxes, cylinders : Boxes, Cylinders
        Everything solid.
    places : tuple of Place
        Where people walk.
    ways : tuple of tuple of int
        For each place, the places that can be reached from it in a straight line.
    queue : (s, 2) float64 array
        Slots of the queue, from the counter to its end.
    queue_return : (m, 2) float64 array
        Corners of the way from the counter back to the end of the queue.
    robot_route : (m, 2) float64 array
        Corners of the closed route of the robot.
    """

    boxes: Boxes
    cylinders: Cylinders
    places: tuple[Place, ...]
    ways: tuple[tuple[int, ...], ...]
    queue: NDArray[np.float64]
    queue_return: NDArray[np.float64]
    robot_route: NDArray[np.float64]


@dataclass(slots=True)
class _Builder:
    """Gathers the solid bodies of a plan."""

    glass: bool
    boxes: list[tuple[float, ...]] = field(default_factory=list)
    box_surfaces: list[Surface] = field(default_factory=list)
    cylinders: list[tuple[float, ...]] = field(default_factory=list)
    cylinder_surfaces: list[Surface] = field(default_factory=list)

    def box(
        self,
        x: tuple[float, float],
        y: tuple[float, float],
        z: tuple[float, float],
        surface: Surface = Surface.FURNITURE,
    ) -> None:
        """Add a box from its bounds along each axis."""
        self.boxes.append((x[0], y[0], z[0], x[1], y[1], z[1]))
        self.box_surfaces.append(surface)

    def cylinder(
        self, x: float, y: float, radius: float, top: float, surface: Surface = Surface.FURNITURE
    ) -> None:
        """Add a cylinder that stands on the floor."""
        self.cylinders.append((x, y, radius, top))
        self.cylinder_surfaces.append(surface)

    def wall(
        self, along: str, at: float, start: float, end: float, openings: tuple[Opening, ...] = ()
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
            piece(position, opening.start, 0.0, HEIGHT)
            piece(opening.start, opening.end, 0.0, opening.bottom)
            piece(opening.start, opening.end, opening.top, HEIGHT)
            position = opening.end
        piece(position, end, 0.0, HEIGHT)

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
        self.cylinder(x, y, 0.06, 0.42)
        self.box((x - 0.22, x + 0.22), (y + back - 0.02, y + back + 0.02), (0.47, 0.95))

    def desk(self, x: float, y: float) -> None:
        """Add a table with a screen on it and a chair in front, to its south."""
        self.table(x, y)
        self.box((x - 0.3, x + 0.3), (y + 0.1, y + 0.15), (0.8, 1.2))
        self.chair(x, y - 0.65, back=-0.2)

    def cabinet(self, x: tuple[float, float], y: tuple[float, float], top: float) -> None:
        """Add a closed piece of furniture that stands on the floor."""
        self.box(x, y, (0.0, top))


def indoor_floor_plan(glass: bool = True) -> FloorPlan:
    """Build the floor plan.

    Parameters
    ----------
    glass : bool, optional
        Whether panes let rays pass; otherwise they are solid walls.

    Returns
    -------
    FloorPlan
    """
    builder = _Builder(glass)
    _add_walls(builder)
    _add_hall(builder)
    _add_rooms(builder)
    places, ways = _walkways()
    corners = np.array(builder.boxes)
    x, y, radius, top = np.array(builder.cylinders).T
    return FloorPlan(
        boxes=Boxes(corners[:, :3], corners[:, 3:], np.array(builder.box_surfaces, np.uint8)),
        cylinders=Cylinders(
            centre=np.stack([x, y], axis=1)[None],
            radius=radius,
            bottom=np.zeros_like(radius),
            top=top,
            surface=np.array(builder.cylinder_surfaces, np.uint8),
        ),
        places=places,
        ways=ways,
        queue=np.array([(13.0, 8.0 - 0.8 * slot) for slot in range(6)]),
        queue_return=np.array([(11.6, 8.0), (11.6, 3.6)]),
        robot_route=_robot_route(),
    )


def _add_walls(builder: _Builder) -> None:
    """Add floor, ceiling and every wall."""
    builder.box((0, LENGTH), (0, WIDTH), (-0.3, 0.0), Surface.FLOOR)
    builder.box((0, LENGTH), (0, WIDTH), (HEIGHT, HEIGHT + 0.3), Surface.CEILING)
    builder.wall("x", 0.0, 0.0, LENGTH, (window(2, 5), window(8, 12), window(22, 27)))
    builder.wall("x", WIDTH, 0.0, LENGTH, (window(1, 6), window(9, 14), window(24, 29)))
    builder.wall("y", 0.0, 0.0, WIDTH, (window(4, 9), glass_wall(15, 16)))
    builder.wall("y", LENGTH, 0.0, WIDTH, (window(2, 5), window(9, 12)))
    hall_arch = Opening(8.0, 11.0, 0.0, 2.5, glazed=False)
    builder.wall("x", 14.0, 0.0, LENGTH, (hall_arch, door(25)))
    builder.wall("x", 17.0, 0.0, LENGTH, (door(3.2), door(11), door(18.5), door(26)))
    for x in (7.5, 15.0, 22.5):
        builder.wall("y", x, 17.0, WIDTH)
    builder.wall("y", 20.0, 0.0, 14.0, (glass_wall(1, 4.5), door(5.2), glass_wall(8, 12.5)))
    builder.wall("x", 7.0, 20.0, LENGTH)


def _add_hall(builder: _Builder) -> None:
    """Add pillars and furniture of the hall and the corridor."""
    for x, y in ((5.0, 5.5), (5.0, 9.2), (15.2, 5.5), (15.2, 9.2)):
        builder.cylinder(x, y, 0.3, HEIGHT, Surface.WALL)
    builder.cabinet((11.5, 14.5), (8.7, 9.3), 1.05)
    builder.cabinet((12.0, 12.4), (8.8, 9.1), 1.4)
    for y in (5.6, 8.8):
        builder.table(6.8, y, length=1.2)
        for x in (6.5, 7.1):
            builder.chair(x, y - 0.6, back=-0.2)
            builder.chair(x, y + 0.6, back=0.2)
    for y in (4.6, 7.4):
        builder.cabinet((0.3, 1.1), (y, y + 2.0), 0.42)
        builder.box((0.15, 0.3), (y, y + 2.0), (0.0, 0.85))
    builder.cabinet((18.9, 19.8), (12.9, 13.8), 1.9)
    builder.cabinet((12.2, 15.8), (13.5, 13.85), 2.0)
    for x, y in ((0.7, 0.7), (19.2, 0.7), (0.7, 13.3), (29.4, 14.5), (0.5, 14.5)):
        builder.cylinder(x, y, 0.18, 0.4)
        builder.cylinder(x, y, 0.3, 1.5)
    builder.cabinet((13.0, 15.0), (16.5, 16.85), 1.2)
    builder.cabinet((21.5, 24.0), (16.5, 16.85), 1.8)


def _add_rooms(builder: _Builder) -> None:
    """Add the furniture of the offices, store, classroom, meeting room and laboratory."""
    for x, y in ((1.4, 19.5), (1.4, 22.5), (6.2, 19.5), (6.2, 22.5), (24.2, 19.5), (24.2, 22.5)):
        builder.desk(x, y)
    builder.cabinet((2.5, 5.0), (24.5, 24.85), 1.9)
    builder.cabinet((29.4, 29.85), (19.0, 23.5), 1.9)
    for y in (19.0, 21.2, 23.4):
        builder.cabinet((7.9, 10.6), (y, y + 0.5), 2.2)
        builder.cabinet((12.6, 14.8), (y, y + 0.5), 2.2)
    for x in (16.4, 20.9):
        for y in (19.6, 21.4, 23.2):
            builder.table(x, y, length=1.8, depth=0.6)
            builder.chair(x - 0.4, y - 0.55, back=-0.2)
            builder.chair(x + 0.4, y - 0.55, back=-0.2)
    builder.table(25.5, 3.4, length=4.0, depth=1.4)
    for x in (24.2, 25.5, 26.8):
        builder.chair(x, 2.4, back=-0.2)
        builder.chair(x, 4.4, back=0.2)
    builder.cabinet((29.3, 29.85), (0.6, 1.8), 1.1)
    for x in (22.0, 28.0):
        builder.cabinet((x - 0.5, x + 0.5), (8.5, 11.5), 0.9)
        builder.cabinet((x - 0.2, x + 0.2), (9.0, 10.0), 1.5)
    builder.cylinder(29.2, 7.8, 0.3, 1.7)


def _walkways() -> tuple[tuple[Place, ...], tuple[tuple[int, ...], ...]]:
    """Return the places of the plan and, for each, those in straight reach."""
    places = {
        "hall south-west": Place(3.4, 3.8, 0.5),
        "hall south": Place(9.6, 3.6, 0.6),
        "hall south-east": Place(16.9, 3.8, 0.5),
        "hall north-east": Place(16.9, 10.6, 0.5),
        "hall north": Place(9.6, 10.6, 0.5),
        "hall north-west": Place(3.4, 10.6, 0.4),
        "hall middle": Place(9.6, 7.2, 0.6),
        "arch": Place(9.9, 14.0, 0.5),
        "corridor west": Place(3.7, 15.8, 0.3),
        "corridor arch": Place(9.9, 15.8, 0.3),
        "corridor store": Place(11.5, 15.8, 0.3),
        "corridor class": Place(19.0, 15.8, 0.3),
        "corridor east": Place(26.2, 15.8, 0.3),
        "office door": Place(3.7, 17.0, 0.1),
        "office": Place(3.8, 20.5, 0.4),
        "store door": Place(11.5, 17.0, 0.1),
        "store": Place(11.6, 21.0, 0.4),
        "class door": Place(19.0, 17.0, 0.1),
        "class": Place(18.6, 21.0, 0.5),
        "east office door": Place(26.5, 17.0, 0.1),
        "east office": Place(27.0, 20.5, 0.6),
        "laboratory door": Place(25.5, 14.0, 0.1),
        "laboratory": Place(25.2, 10.5, 0.8),
        "meeting door": Place(20.0, 5.7, 0.1),
        "meeting": Place(21.8, 5.7, 0.3),
        "hall east": Place(17.0, 5.7, 0.5),
    }
    lines = (
        ("hall south-west", "hall south", "hall middle", "hall north", "hall north-west"),
        ("hall north-west", "hall south-west"),
        ("hall south", "hall south-east", "hall east", "hall north-east", "hall north"),
        ("hall east", "meeting door", "meeting"),
        ("hall north", "arch", "corridor arch", "corridor west", "office door", "office"),
        ("corridor arch", "corridor store", "corridor class", "corridor east"),
        ("corridor store", "store door", "store"),
        ("corridor class", "class door", "class"),
        ("corridor east", "east office door", "east office"),
        ("corridor east", "laboratory door", "laboratory"),
    )
    number = {name: index for index, name in enumerate(places)}
    ways: list[list[int]] = [[] for _ in places]
    for line in lines:
        for here, there in pairwise(line):
            ways[number[here]].append(number[there])
            ways[number[there]].append(number[here])
    return tuple(places.values()), tuple(map(tuple, ways))


def _robot_route() -> NDArray[np.float64]:
    """Return the route: about the hall, the corridor end to end, and into two rooms."""
    return np.array(
        [
            (2.2, 1.8),
            (18.4, 1.8),
            (18.4, 12.1),
            (8.9, 12.1),
            (8.9, 14.8),
            (26.0, 14.8),
            (19.0, 14.8),
            (19.0, 20.0),
            (19.0, 14.8),
            (3.7, 14.8),
            (3.7, 20.0),
            (3.7, 14.8),
            (8.9, 14.8),
            (8.9, 12.1),
            (2.2, 12.1),
        ]
    )
