"""One floor of 750 square metres: a hall with a counter, a corridor, and six rooms.

Four rooms lie north of the corridor, and two behind glass to the east of the hall. The seed moves
walls and doors, chooses and places the furniture, and mirrors the whole. All lengths are in metres.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.construction import Builder, door, glass_wall, passage, window
from pipeline.simulation.furnishing import (
    DESK,
    MEETING_TABLE,
    PLANT,
    SEATS,
    TABLE,
    Furnisher,
    Room,
    ways_of,
)
from pipeline.simulation.scene import MachineKind, Place, Scene, Shapes, Walkways, on_floor

LENGTH, WIDTH = 30.0, 25.0
_CORRIDOR = 3.0
_WALL = 0.1  # half a wall
_QUEUE_X, _COUNTER_Y = 13.0, 8.7


@dataclass(frozen=True, slots=True)
class _Plan:
    """Where walls and doors are.

    Attributes
    ----------
    hall_east : float
        x of the wall between the hall and the rooms to its east.
    hall_north : float
        y of the wall between the hall and the corridor.
    east_split : float
        y of the wall between the two rooms east of the hall.
    dividers : tuple of 3 floats
        x of the walls between the rooms north of the corridor.
    arch : float
        x of the middle of the way from the hall to the corridor, 3 m wide.
    doors : tuple of 4 floats
        x of the middle of each northern room's door.
    laboratory_door, meeting_door : float
        x and y of the middle of the doors of the rooms east of the hall.
    """

    hall_east: float
    hall_north: float
    east_split: float
    dividers: tuple[float, float, float]
    arch: float
    doors: tuple[float, float, float, float]
    laboratory_door: float
    meeting_door: float

    @property
    def corridor_north(self) -> float:
        """Y of the wall between the corridor and the rooms to its north."""
        return self.hall_north + _CORRIDOR

    @property
    def northern_rooms(self) -> tuple[Room, ...]:
        """The rooms north of the corridor, from west to east."""
        walls = (0.0, *self.dividers, LENGTH)
        return tuple(
            Room(
                (west + _WALL, east - _WALL),
                (self.corridor_north + _WALL, WIDTH - _WALL),
            )
            for west, east in pairwise(walls)
        )


def indoor_scene(random: np.random.Generator, glass: bool = True) -> Scene:
    """Build the floor.

    Parameters
    ----------
    random : numpy.random.Generator
        What varies from one floor to the next is drawn from it.
    glass : bool, optional
        Whether panes let rays pass; otherwise they are solid walls.
    """
    plan = _draw_plan(random)
    north, east = plan.hall_north - 3.2, plan.hall_east - 3.1
    scene = Scene(
        shapes=Shapes.of(),
        walkways=_walkways(plan),
        queue=on_floor([(_QUEUE_X, _COUNTER_Y - 0.7 - 0.8 * slot) for slot in range(6)]),
        queue_return=on_floor([(_QUEUE_X - 1.4, 8.0), (_QUEUE_X - 1.4, 3.6)]),
        robot_route=_robot_route(plan),
        machine_route=on_floor([(3.4, 3.1), (east, 3.1), (east, north), (3.4, north)]),
        machines=(MachineKind.FORKLIFT, MachineKind.AGV),
        machine_speed=1.2,
        size=(LENGTH, WIDTH),
    )
    builder = Builder(glass)
    _add_walls(builder, plan)
    furnisher = Furnisher(builder, random, ways_of(scene))
    _furnish_hall(builder, furnisher, plan, random)
    _furnish_rooms(furnisher, plan, random)
    scene = replace(scene, shapes=builder.shapes())
    for axis in (0, 1):
        if random.random() < 0.5:
            scene = scene.mirrored(axis)
    return scene


def _draw_plan(random: np.random.Generator) -> _Plan:
    """Move each wall and door a little from where an architect would put it."""
    first, second, third = np.array([7.5, 15.0, 22.5]) + random.uniform(-0.8, 0.8, 3)
    walls = np.array([0.0, first, second, third, LENGTH])
    doors = walls[:-1] + np.diff(walls) * random.uniform(0.4, 0.6, 4)
    return _Plan(
        hall_east=20.0 + random.uniform(-0.8, 0.8),
        hall_north=14.0 + random.uniform(-0.4, 0.4),
        east_split=7.0 + random.uniform(-0.3, 0.6),
        dividers=(float(first), float(second), float(third)),
        arch=9.5 + random.uniform(-1.5, 1.5),
        doors=(float(doors[0]), float(doors[1]), float(doors[2]), float(doors[3])),
        laboratory_door=25.5 + random.uniform(-1.5, 1.5),
        meeting_door=5.6 + random.uniform(-0.2, 0.2),
    )


def _add_walls(builder: Builder, plan: _Plan) -> None:
    """Add floor, ceiling, every wall, and the pillars of the hall."""
    builder.floor((0, LENGTH), (0, WIDTH))
    builder.ceiling((0, LENGTH), (0, WIDTH))
    builder.wall("x", 0.0, 0.0, LENGTH, (window(2, 5), window(8, 12), window(22, 27)))
    builder.wall("x", WIDTH, 0.0, LENGTH, (window(1, 6), window(9, 14), window(24, 29)))
    builder.wall("y", 0.0, 0.0, WIDTH, (window(4, 9), glass_wall(15, 16)))
    builder.wall("y", LENGTH, 0.0, WIDTH, (window(2, 5), window(9, 12)))
    arch = passage(plan.arch - 1.5, plan.arch + 1.5)
    laboratory = door(plan.laboratory_door - 0.5)
    builder.wall("x", plan.hall_north, 0.0, LENGTH, (arch, laboratory))
    builder.wall(
        "x", plan.corridor_north, 0.0, LENGTH, tuple(door(middle - 0.5) for middle in plan.doors)
    )
    for x in plan.dividers:
        builder.wall("y", x, plan.corridor_north, WIDTH)
    panes = (glass_wall(1, 4.5), door(plan.meeting_door - 0.5), glass_wall(8, 12.5))
    builder.wall("y", plan.hall_east, 0.0, plan.hall_north, panes)
    builder.wall("x", plan.east_split, plan.hall_east, LENGTH)
    for x in (5.6, plan.hall_east - 5.3):
        for y in (5.6, 8.6):
            builder.pillar(x, y)


def _furnish_hall(
    builder: Builder, furnisher: Furnisher, plan: _Plan, random: np.random.Generator
) -> None:
    """Add the counter, and furniture in the hall and the corridor."""
    for x in (5.6, plan.hall_east - 5.3):
        for y in (5.6, 8.6):
            furnisher.take((x - 0.4, x + 0.4), (y - 0.4, y + 0.4))
    counter = (_QUEUE_X - 1.5, _QUEUE_X + 1.1)
    builder.cabinet(counter, (_COUNTER_Y, _COUNTER_Y + 0.6), 1.05)
    builder.cabinet((_QUEUE_X - 1.0, _QUEUE_X - 0.6), (_COUNTER_Y + 0.1, _COUNTER_Y + 0.4), 1.4)
    furnisher.take(counter, (_COUNTER_Y, _COUNTER_Y + 0.6))
    hall = Room((_WALL, plan.hall_east - _WALL), (_WALL, plan.hall_north - _WALL))
    furnisher.free_standing(hall, SEATS, int(random.integers(2, 5)))
    furnisher.along_walls(hall, int(random.integers(3, 7)), (1.2, 3.0), 0.8, (0.4, 2.0))
    furnisher.free_standing(hall, PLANT, 4)
    corridor = Room((_WALL, LENGTH - _WALL), (plan.hall_north + _WALL, plan.corridor_north - _WALL))
    furnisher.along_walls(corridor, 4, (0.8, 2.5), 0.3, (0.9, 1.9))
    furnisher.free_standing(corridor, PLANT, 2)


def _furnish_rooms(furnisher: Furnisher, plan: _Plan, random: np.random.Generator) -> None:
    """Make each room an office, a store or a classroom; a meeting room and a laboratory are set."""
    uses = ("office", "store", "classroom", "office")
    for room, use in zip(plan.northern_rooms, random.permutation(uses), strict=True):
        if use == "store":
            furnisher.along_walls(room, 7, (1.5, 2.8), 0.5, (1.8, 2.3))
            continue
        furnisher.along_walls(room, int(random.integers(1, 4)), (0.9, 2.5), 0.4, (0.9, 2.0))
        if use == "classroom":
            furnisher.free_standing(room, TABLE, 6)
        else:
            furnisher.free_standing(room, DESK, int(random.integers(2, 5)))
    east = (plan.hall_east + _WALL, LENGTH - _WALL)
    meeting = Room(east, (_WALL, plan.east_split - _WALL))
    furnisher.free_standing(meeting, MEETING_TABLE, 1)
    furnisher.along_walls(meeting, 2, (0.9, 1.5), 0.5, (0.8, 1.2))
    laboratory = Room(east, (plan.east_split + _WALL, plan.hall_north - _WALL))
    furnisher.along_walls(laboratory, 4, (1.5, 3.0), 0.9, (0.9, 1.6))
    furnisher.free_standing(laboratory, DESK, 2)


def _walkways(plan: _Plan) -> Walkways:
    """Return the places of the floor, and which are in straight reach of which."""
    middle = plan.hall_north + _CORRIDOR / 2
    north, east = plan.hall_north - 3.4, plan.hall_east - 3.1
    room_y = plan.corridor_north + 3.8
    places = {
        "hall south-west": Place(3.4, 3.8, 0.5),
        "hall south": Place(9.6, 3.6, 0.6),
        "hall south-east": Place(east, 3.8, 0.5),
        "hall east": Place(east, plan.meeting_door, 0.5),
        "hall north-east": Place(east, north, 0.5),
        "hall north": Place(9.6, north, 0.5),
        "hall north-west": Place(3.4, north, 0.4),
        "hall middle": Place(9.6, 7.2, 0.6),
        "arch": Place(plan.arch, plan.hall_north, 0.5),
        "corridor arch": Place(plan.arch, middle, 0.3),
        "laboratory corridor": Place(plan.laboratory_door, middle, 0.3),
        "laboratory door": Place(plan.laboratory_door, plan.hall_north, 0.1),
        "laboratory": Place(plan.laboratory_door, plan.hall_north - 3.0, 0.6),
        "meeting door": Place(plan.hall_east, plan.meeting_door, 0.1),
        "meeting": Place(plan.hall_east + 1.8, plan.meeting_door, 0.3),
    }
    corridor = {"corridor arch": plan.arch, "laboratory corridor": plan.laboratory_door}
    lines: list[tuple[str, ...]] = [
        ("hall south-west", "hall south", "hall middle", "hall north", "hall north-west"),
        ("hall north-west", "hall south-west"),
        ("hall south", "hall south-east", "hall east", "hall north-east", "hall north"),
        ("hall east", "meeting door", "meeting"),
        ("hall north", "arch", "corridor arch"),
        ("laboratory corridor", "laboratory door", "laboratory"),
    ]
    for number, x in enumerate(plan.doors):
        names = tuple(f"{part} {number}" for part in ("corridor", "door", "room"))
        spots = (
            Place(x, middle, 0.3),
            Place(x, plan.corridor_north, 0.1),
            Place(x, room_y, 0.4),
        )
        places.update(zip(names, spots, strict=True))
        corridor[names[0]] = x
        lines.append(names)
    lines.append(tuple(sorted(corridor, key=lambda name: corridor[name])))
    return Walkways.along(places, lines)


def _robot_route(plan: _Plan) -> NDArray[np.float64]:
    """Return the route: about the hall, the corridor end to end, and into two rooms."""
    south, north = 1.8, plan.hall_north - 1.9
    west, east = 2.2, plan.hall_east - 1.6
    corridor = plan.hall_north + 0.9
    inside = plan.corridor_north + 3.0
    first, third = plan.doors[0], plan.doors[2]
    return on_floor(
        [
            (west, south),
            (east, south),
            (east, north),
            (plan.arch - 0.7, north),
            (plan.arch - 0.7, corridor),
            (LENGTH - 4.0, corridor),
            (third, corridor),
            (third, inside),
            (third, corridor),
            (first, corridor),
            (first, inside),
            (first, corridor),
            (plan.arch - 0.7, corridor),
            (plan.arch - 0.7, north),
            (west, north),
        ]
    )
