"""Scenes on two levels with a ramp between them: two storeys, and a loading hall.

All lengths are in metres.
"""

from dataclasses import replace

import numpy as np

from pipeline.simulation import construction as c
from pipeline.simulation.construction import glass_wall, passage, window
from pipeline.simulation.movers import automated_vehicle, forklift
from pipeline.simulation.scene import Place, Scene, Surface, Walkways, on_floor
from pipeline.simulation.tables import Random

LENGTH, WIDTH = 30.0, 25.0
_WALL = 0.1  # half a wall

STOREY = 3.2  # height of the upper floor of the two storeys above the lower one

_LANE = 4.0  # width of the ramp's lane, along the south side
_LANDING = 2.5  # length of the flat part at either end of the lane
_UPSTAIRS = c.Room((_WALL, LENGTH - _WALL), (_LANE + _WALL, WIDTH - _WALL))

PLATFORM = 1.2  # height of the loading hall's platform above its floor

_FOOT, _EDGE = 10.0, 20.0  # x at which its ramp begins, and at which the platform does
_RAMP = (7.5, 16.5)  # y of its sides
_ROOF = 6.0


def storeys_scene(random: Random, glass: bool = True) -> Scene:
    """Build two storeys of 630 m², each a hall with a partition, and a ramp in a lane beside them.

    The ramp rises by 3.2 m over 25 m: 12.8 %. The robot goes up it and down again, people too.
    Panes let rays pass; without `glass` they are solid walls.
    """
    lane, inside, north = _LANE / 2, _LANE + 2.5, WIDTH - 3.0
    west, east = 1.4, LENGTH - 1.4
    foot, head = (_LANDING, lane), (LENGTH - _LANDING, lane)
    lower = [
        (west, lane), (west, inside), (west, north), (24.0, north), (24.0, inside),
        (west, inside), (west, lane), foot,
    ]  # fmt: skip
    upper = [
        head, (east, lane), (east, inside), (east, north), (5.0, north), (5.0, inside),
        (east, inside), (east, lane), head,
    ]  # fmt: skip
    scene = Scene(
        walkways=_ways_of_storeys(),
        queue=on_floor([(26.5, 19.0 - 0.8 * slot) for slot in range(6)]),
        queue_return=on_floor([(27.8, 19.0), (27.8, 14.4)]),
        robot_route=np.concatenate([on_floor(lower), on_floor(upper, STOREY), on_floor([foot])]),
        machine_route=on_floor([(5.5, 10.0), (20.0, 10.0), (20.0, 18.0), (5.5, 18.0)]),
        machines=(automated_vehicle, forklift),
        machine_speed=1.0,
        size=(LENGTH, WIDTH),
    )
    builder = c.Builder(glass)
    _add_building(builder)
    furnisher = c.Furnisher(builder, random, scene)
    furnisher.cabinet((25.5, 27.4), (19.7, 20.3), 1.05)
    _furnish_storey(furnisher, random)
    with builder.on(STOREY):
        _furnish_storey(c.Furnisher(builder, random, scene, rounds=False), random)
    scene = replace(scene, shapes=builder.shapes())
    return scene.mirrored(0) if random.random() < 0.5 else scene


def _furnish_storey(furnisher: c.Furnisher, random: Random) -> None:
    """Furnish one storey, to either side of its partition."""
    furnisher.take((LENGTH / 2 - 0.3, LENGTH / 2 + 0.3), _UPSTAIRS.y)
    furnisher.free_standing(_UPSTAIRS, c.PILLAR, 5)
    furnisher.free_standing(_UPSTAIRS, c.SEATS, int(random.integers(3, 6)))
    furnisher.free_standing(_UPSTAIRS, c.DESK, int(random.integers(3, 7)))
    furnisher.free_standing(_UPSTAIRS, c.PLANT, 4)
    furnisher.along_walls(_UPSTAIRS, int(random.integers(5, 9)), (1.0, 3.0), 0.6, (0.9, 2.0))


def _add_building(builder: c.Builder) -> None:
    """Add floors, walls, and the ramp between the landings."""
    clear = STOREY - 0.3
    builder.floor((0, LENGTH), (0, WIDTH))
    builder.ceiling((0, LENGTH), (_LANE, WIDTH), clear)
    ways_in = ((0.0, passage(0.4, 2.4)), (STOREY, passage(LENGTH - 2.4, LENGTH - 0.4)))
    for base, way_in in ways_in:
        with builder.on(base):
            if base:
                builder.box((0, LENGTH), (_LANE, WIDTH), (-0.1, 0.0), Surface.FLOOR)
                builder.floor((LENGTH - _LANDING, LENGTH), (0, _LANE))
                builder.ceiling((0, LENGTH), (0, WIDTH))
            builder.wall("x", 0.0, 0.0, LENGTH, (), STOREY)
            builder.wall("x", WIDTH, 0.0, LENGTH, (window(2, 8), window(18, 26)), STOREY)
            builder.wall("y", 0.0, 0.0, WIDTH, (window(10, 14), glass_wall(17, 20)), STOREY)
            builder.wall("y", LENGTH, 0.0, WIDTH, (window(8, 14),), STOREY)
            builder.wall("x", _LANE, 0.0, LENGTH, (way_in,), clear)
            south, north = passage(_LANE + 1.0, _LANE + 7.5), passage(WIDTH - 8.5, WIDTH - 1.0)
            openings = (south, glass_wall(_LANE + 8.0, _LANE + 12.0), north)
            builder.wall("y", LENGTH / 2, _LANE, WIDTH, openings, clear)
    slope = STOREY / (LENGTH - 2 * _LANDING)
    with builder.on(-slope * _LANDING, slope):
        builder.floor((_LANDING, LENGTH - _LANDING), (0, _LANE))


def _ways_of_storeys() -> Walkways:
    """Return a loop on each storey, and the way over the ramp between them."""
    lane = _LANE / 2
    places = {
        "foot": Place(_LANDING, lane, 0.0),
        "landing": Place(1.4, lane, 0.2),
        "way in": Place(1.4, _LANE, 0.2),
        "south-west": Place(3.5, 7.0, 0.4),
        "south": Place(15.0, 7.5, 0.5),
        "south-east": Place(22.0, 7.5, 0.5),
        "east": Place(23.0, 14.0, 0.5),
        "north-east": Place(23.0, 20.4, 0.5),
        "north": Place(15.0, 20.4, 0.5),
        "north-west": Place(3.5, 20.4, 0.5),
        "head": Place(LENGTH - _LANDING, lane, 0.0, STOREY),
        "upper landing": Place(LENGTH - 1.4, lane, 0.2, STOREY),
        "upper way in": Place(LENGTH - 1.4, _LANE, 0.2, STOREY),
        "upper south-east": Place(LENGTH - 3.5, 7.0, 0.5, STOREY),
        "upper south": Place(15.0, 7.5, 0.5, STOREY),
        "upper west": Place(7.0, 7.5, 0.5, STOREY),
        "upper north-west": Place(7.0, 20.4, 0.5, STOREY),
        "upper north": Place(15.0, 20.4, 0.5, STOREY),
        "upper north-east": Place(LENGTH - 3.5, 20.4, 0.5, STOREY),
    }
    names = list(places)
    lower = [*names[2:10], "south-west"]
    upper = [*names[12:], "upper south-east"]
    ramp = ["way in", "landing", "foot", "head", "upper landing", "upper way in"]
    return Walkways.along(places, [lower, ramp, upper])


def _add_pallet(builder: c.Builder, x: float, y: float) -> None:
    """Add a pallet with boxes stacked on it."""
    builder.box((x - 0.6, x + 0.6), (y - 0.4, y + 0.4), (0.0, 0.15))
    builder.box((x - 0.55, x + 0.5), (y - 0.35, y + 0.38), (0.15, 0.9))
    builder.box((x - 0.55, x + 0.1), (y - 0.3, y + 0.3), (0.9, 1.4))


_TALL_PILLAR = c.Piece(0.6, 0.6, lambda builder, x, y: builder.pillar(x, y, _ROOF))
_PALLET = c.Piece(1.2, 0.8, _add_pallet)


def ramp_scene(random: Random, glass: bool = True) -> Scene:
    """Build a loading hall: a floor, a platform 1.2 m above it, and a ramp of 12 % between them.

    The machines drive over the ramp, as the robot and the people do. Panes let rays pass; without
    `glass` they are solid walls.
    """
    up, lane, back = (on_floor([(_FOOT, y, 0.0), (_EDGE, y, PLATFORM)]) for y in (8.6, 12.6, 15.4))
    lower = on_floor([(2.0, 3.0), (7.0, 3.0), (7.0, 8.6)])
    upper = [(22.0, 8.6), (22.0, 2.0), (28.0, 2.0), (28.0, 23.0), (22.0, 23.0), (22.0, 8.6)]
    home = on_floor([(7.0, 8.6), (7.0, 22.0), (2.0, 22.0)])
    turn = [(25.0, 12.6, PLATFORM), (25.0, 15.4, PLATFORM)]
    scene = Scene(
        walkways=_ways_of_hall(),
        queue=on_floor([(15.5 - 0.8 * slot, 4.0) for slot in range(6)]),
        queue_return=on_floor([(15.5, 5.4), (10.9, 5.4)]),
        robot_route=np.concatenate([lower, up, on_floor(upper, PLATFORM), up[::-1], home]),
        machine_route=on_floor([(4.5, 12.6), *lane, *turn, *back[::-1], (4.5, 15.4)]),
        machines=(forklift, automated_vehicle),
        machine_speed=1.2,
        size=(LENGTH, WIDTH),
    )
    builder = c.Builder(glass)
    _add_hall(builder)
    furnisher = c.Furnisher(builder, random, scene)
    furnisher.take((_FOOT - 1.0, _EDGE), (_RAMP[0] - 0.2, _RAMP[1] + 0.2))
    furnisher.cabinet((16.2, 16.8), (2.8, 5.2), 1.05)
    low = c.Room((_WALL, _EDGE - 1.0), (_WALL, WIDTH - _WALL))
    high = c.Room((_EDGE + 1.0, LENGTH - _WALL), (_WALL, WIDTH - _WALL))
    furnisher.free_standing(low, _TALL_PILLAR, 4)
    for base, room in ((0.0, low), (PLATFORM, high)):
        with builder.on(base):
            furnisher.along_walls(room, int(random.integers(4, 8)), (1.5, 3.0), 0.9, (1.0, 3.0))
            furnisher.free_standing(room, c.TABLE, int(random.integers(2, 5)))
            furnisher.free_standing(room, _PALLET, int(random.integers(4, 9)))
    scene = replace(scene, shapes=builder.shapes())
    return scene.mirrored(0) if random.random() < 0.5 else scene


def _add_hall(builder: c.Builder) -> None:
    """Add floor, platform, ramp, roof, and walls with gates."""
    height = _ROOF
    builder.floor((0, LENGTH), (0, WIDTH))
    builder.box((_EDGE, LENGTH), (0, WIDTH), (0.0, PLATFORM), Surface.FLOOR)
    slope = PLATFORM / (_EDGE - _FOOT)
    with builder.on(-slope * _FOOT, slope):
        # Down to the floor, so that nothing is seen under it.
        builder.box((_FOOT, _EDGE), _RAMP, (-PLATFORM, 0.0), Surface.FLOOR)
    builder.ceiling((0, LENGTH), (0, WIDTH), height)
    builder.wall("x", 0.0, 0.0, LENGTH, (window(3, 8), window(11, 15)), height)
    builder.wall("x", WIDTH, 0.0, LENGTH, (window(3, 8), window(11, 15)), height)
    builder.wall("y", 0.0, 0.0, WIDTH, (glass_wall(10, 12.5),), height)
    builder.wall("y", LENGTH, 0.0, WIDTH, (), height)


def _ways_of_hall() -> Walkways:
    """Return a loop on the floor, one on the platform, and the ramp between them."""
    places = {
        "west": Place(4.0, 10.5, 0.4),
        "south-west": Place(4.5, 6.5, 0.5),
        "south": Place(9.0, 7.0, 0.4),
        "before the ramp": Place(8.5, 10.5, 0.3),
        "north": Place(9.0, 18.5, 0.5),
        "north-west": Place(4.5, 19.0, 0.5),
        "foot": Place(_FOOT, 10.5, 0.0),
        "head": Place(_EDGE, 10.5, 0.0, PLATFORM),
        "on the platform": Place(23.5, 10.5, 0.3, PLATFORM),
        "platform south": Place(25.0, 5.0, 0.6, PLATFORM),
        "platform north": Place(25.0, 20.0, 0.6, PLATFORM),
    }
    lines = [
        ("west", "south-west", "south", "before the ramp", "north", "north-west", "west"),
        ("west", "before the ramp", "foot", "head", "on the platform", "platform south"),
        ("on the platform", "platform north", "platform south"),
    ]
    return Walkways.along(places, lines)
