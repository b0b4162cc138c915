"""One floor of 750 square metres: a hall with a counter, a corridor, and six rooms.

Four rooms lie north of the corridor, and two behind glass to the east of the hall. The seed moves
walls and doors, chooses and places the furniture, and mirrors the whole. All lengths are in metres.
"""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from pipeline.simulation import construction as c
from pipeline.simulation.construction import door, glass_wall, passage, window
from pipeline.simulation.movers import automated_vehicle, forklift
from pipeline.simulation.scene import Place, Scene, Walkways, on_floor
from pipeline.simulation.tables import Floats, Random

LENGTH, WIDTH = 30.0, 25.0
_CORRIDOR = 3.0
_WALL = 0.1  # half a wall
_QUEUE_X, _COUNTER_Y = 13.0, 8.7


@dataclass(frozen=True, slots=True)
class _Plan:
    """Where walls and the middles of doors are."""

    hall_east: float  # x of the wall between the hall and the rooms to its east
    hall_north: float  # y of the wall between the hall and the corridor
    east_split: float  # y of the wall between the two rooms east of the hall
    dividers: tuple[float, ...]  # x of the walls between the rooms north of the corridor
    arch: float  # x of the way from the hall to the corridor, 3 m wide
    doors: tuple[float, ...]  # x of each northern room's door
    laboratory_door: float  # x
    meeting_door: float  # y

    @property
    def corridor_north(self) -> float:
        """Y of the wall between the corridor and the rooms to its north."""
        return self.hall_north + _CORRIDOR

    @property
    def pillars(self) -> list[tuple[float, float]]:
        """X and y of the pillars of the hall."""
        return [(x, y) for x in (5.6, self.hall_east - 5.3) for y in (5.6, 8.6)]


def indoor_scene(random: Random, glass: bool = True) -> Scene:
    """Draw a floor. Panes let rays pass; without `glass` they are solid walls."""
    plan = _draw_plan(random)
    north, east = plan.hall_north - 3.2, plan.hall_east - 3.1
    scene = Scene(
        walkways=_walkways(plan),
        queue=on_floor([(_QUEUE_X, _COUNTER_Y - 0.7 - 0.8 * slot) for slot in range(6)]),
        queue_return=on_floor([(_QUEUE_X - 1.4, 8.0), (_QUEUE_X - 1.4, 3.6)]),
        robot_route=_robot_route(plan),
        machine_route=on_floor([(3.4, 3.1), (east, 3.1), (east, north), (3.4, north)]),
        machines=(forklift, automated_vehicle),
        machine_speed=1.2,
        size=(LENGTH, WIDTH),
    )
    builder = c.Builder(glass)
    _add_walls(builder, plan)
    furnisher = c.Furnisher(builder, random, scene)
    _furnish_hall(builder, furnisher, plan, random)
    _furnish_rooms(furnisher, plan, random)
    scene = replace(scene, shapes=builder.shapes())
    for axis in (0, 1):
        if random.random() < 0.5:
            scene = scene.mirrored(axis)
    return scene


def _draw_plan(random: Random) -> _Plan:
    """Move each wall and door a little from where an architect would put it."""
    dividers = np.array([7.5, 15.0, 22.5]) + random.uniform(-0.8, 0.8, 3)
    walls = np.array([0.0, *dividers, LENGTH])
    doors = walls[:-1] + np.diff(walls) * random.uniform(0.4, 0.6, 4)
    return _Plan(
        hall_east=20.0 + random.uniform(-0.8, 0.8),
        hall_north=14.0 + random.uniform(-0.4, 0.4),
        east_split=7.0 + random.uniform(-0.3, 0.6),
        dividers=tuple(dividers.tolist()),
        arch=9.5 + random.uniform(-1.5, 1.5),
        doors=tuple(doors.tolist()),
        laboratory_door=25.5 + random.uniform(-1.5, 1.5),
        meeting_door=5.6 + random.uniform(-0.2, 0.2),
    )


def _add_walls(builder: c.Builder, plan: _Plan) -> None:
    """Add floor, ceiling, every wall, and the pillars of the hall."""
    builder.floor((0, LENGTH), (0, WIDTH))
    builder.ceiling((0, LENGTH), (0, WIDTH))
    builder.wall("x", 0.0, 0.0, LENGTH, (window(2, 5), window(8, 12), window(22, 27)))
    builder.wall("x", WIDTH, 0.0, LENGTH, (window(1, 6), window(9, 14), window(24, 29)))
    builder.wall("y", 0.0, 0.0, WIDTH, (window(4, 9), glass_wall(15, 16)))
    builder.wall("y", LENGTH, 0.0, WIDTH, (window(2, 5), window(9, 12)))
    ways = (passage(plan.arch - 1.5, plan.arch + 1.5), door(plan.laboratory_door - 0.5))
    builder.wall("x", plan.hall_north, 0.0, LENGTH, ways)
    doors = tuple(door(middle - 0.5) for middle in plan.doors)
    builder.wall("x", plan.corridor_north, 0.0, LENGTH, doors)
    for x in plan.dividers:
        builder.wall("y", x, plan.corridor_north, WIDTH)
    panes = (glass_wall(1, 4.5), door(plan.meeting_door - 0.5), glass_wall(8, 12.5))
    builder.wall("y", plan.hall_east, 0.0, plan.hall_north, panes)
    builder.wall("x", plan.east_split, plan.hall_east, LENGTH)
    for x, y in plan.pillars:
        builder.pillar(x, y)


def _furnish_hall(builder: c.Builder, furnisher: c.Furnisher, plan: _Plan, random: Random) -> None:
    """Add the counter, and furniture in the hall and the corridor."""
    for x, y in plan.pillars:
        furnisher.take((x - 0.4, x + 0.4), (y - 0.4, y + 0.4))
    furnisher.cabinet((_QUEUE_X - 1.5, _QUEUE_X + 1.1), (_COUNTER_Y, _COUNTER_Y + 0.6), 1.05)
    till = (_QUEUE_X - 1.0, _QUEUE_X - 0.6), (_COUNTER_Y + 0.1, _COUNTER_Y + 0.4)
    builder.box(*till, (0.0, 1.4))
    hall = c.Room((_WALL, plan.hall_east - _WALL), (_WALL, plan.hall_north - _WALL))
    furnisher.free_standing(hall, c.SEATS, int(random.integers(2, 5)))
    furnisher.along_walls(hall, int(random.integers(3, 7)), (1.2, 3.0), 0.8, (0.4, 2.0))
    furnisher.free_standing(hall, c.PLANT, 4)
    corridor = c.Room(
        (_WALL, LENGTH - _WALL), (plan.hall_north + _WALL, plan.corridor_north - _WALL)
    )
    furnisher.along_walls(corridor, 4, (0.8, 2.5), 0.3, (0.9, 1.9))
    furnisher.free_standing(corridor, c.PLANT, 2)


def _furnish_rooms(furnisher: c.Furnisher, plan: _Plan, random: Random) -> None:
    """Make each room an office, a store or a classroom; a meeting room and a laboratory are set."""
    uses = ("office", "store", "classroom", "office")
    north = (plan.corridor_north + _WALL, WIDTH - _WALL)
    walls = pairwise((0.0, *plan.dividers, LENGTH))
    for (x0, x1), use in zip(walls, random.permutation(uses), strict=True):
        room = c.Room((x0 + _WALL, x1 - _WALL), north)
        if use == "store":
            furnisher.along_walls(room, 7, (1.5, 2.8), 0.5, (1.8, 2.3))
            continue
        furnisher.along_walls(room, int(random.integers(1, 4)), (0.9, 2.5), 0.4, (0.9, 2.0))
        if use == "classroom":
            furnisher.free_standing(room, c.TABLE, 6)
        else:
            furnisher.free_standing(room, c.DESK, int(random.integers(2, 5)))
    east = (plan.hall_east + _WALL, LENGTH - _WALL)
    meeting = c.Room(east, (_WALL, plan.east_split - _WALL))
    furnisher.free_standing(meeting, c.MEETING_TABLE, 1)
    furnisher.along_walls(meeting, 2, (0.9, 1.5), 0.5, (0.8, 1.2))
    laboratory = c.Room(east, (plan.east_split + _WALL, plan.hall_north - _WALL))
    furnisher.along_walls(laboratory, 4, (1.5, 3.0), 0.9, (0.9, 1.6))
    furnisher.free_standing(laboratory, c.DESK, 2)


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
        spots = ((middle, 0.3), (plan.corridor_north, 0.1), (room_y, 0.4))
        places |= {name: Place(x, *spot) for name, spot in zip(names, spots, strict=True)}
        corridor[names[0]] = x
        lines.append(names)
    lines.append(tuple(sorted(corridor, key=lambda name: corridor[name])))
    return Walkways.along(places, lines)


def _robot_route(plan: _Plan) -> Floats:
    """Return the route: about the hall, the corridor end to end, and into two rooms."""
    south, north = 1.8, plan.hall_north - 1.9
    west, east = 2.2, plan.hall_east - 1.6
    corridor = plan.hall_north + 0.9
    inside = plan.corridor_north + 3.0
    arch, first, third = plan.arch - 0.7, plan.doors[0], plan.doors[2]
    return on_floor([
        (west, south), (east, south), (east, north), (arch, north), (arch, corridor),
        (LENGTH - 4.0, corridor), (third, corridor), (third, inside), (third, corridor),
        (first, corridor), (first, inside), (first, corridor), (arch, corridor), (arch, north),
        (west, north),
    ])  # fmt: skip
