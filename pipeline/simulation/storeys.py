"""Two storeys of 630 square metres each, joined by a ramp in a lane along their side.

All lengths are in metres.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.construction import Builder, glass_wall, passage, window
from pipeline.simulation.furnishing import (
    DESK,
    MACHINE_MARGIN,
    PILLAR,
    PLANT,
    SEATS,
    Furnisher,
    Room,
    queue_way,
    ways_of,
)
from pipeline.simulation.scene import MachineKind, Place, Scene, Walkways, on_floor
from pipeline.simulation.shapes import Surface

LENGTH, WIDTH = 30.0, 25.0
_WALL = 0.1  # half a wall

STOREY = 3.2
"""Height of the upper floor of the two storeys above the lower one."""

_LANE = 4.0  # width of the ramp's lane, along the south side
_LANDING = 2.5  # length of the flat part at either end of the lane
_HALL = Room((_WALL, LENGTH - _WALL), (_LANE + _WALL, WIDTH - _WALL))


def storeys_scene(random: np.random.Generator, glass: bool = True) -> Scene:
    """Build two storeys, each a hall with a partition, and a ramp in a lane along their side.

    The ramp rises by 3.2 m over 25 m: 12.8 %. The robot goes up it and down again, people too.

    Parameters
    ----------
    random : numpy.random.Generator
        What varies from one building to the next is drawn from it.
    glass : bool, optional
        Whether panes let rays pass; otherwise they are solid walls.
    """
    walkways = _walkways()
    robot_route = _robot_route()
    machine_route = on_floor([(5.5, 10.0), (20.0, 10.0), (20.0, 18.0), (5.5, 18.0)])
    queue = on_floor([(26.5, 19.0 - 0.8 * slot) for slot in range(6)])
    queue_return = on_floor([(27.8, 19.0), (27.8, 14.4)])
    builder = Builder(glass)
    _add_building(builder)
    rounds = ((machine_route, MACHINE_MARGIN), queue_way(queue, queue_return))
    furnisher = Furnisher(builder, random, ways_of(walkways, robot_route, *rounds))
    builder.cabinet((25.5, 27.4), (19.7, 20.3), 1.05)
    furnisher.take((25.5, 27.4), (19.7, 20.3))
    _furnish(furnisher, random)
    with builder.on(STOREY):
        _furnish(Furnisher(builder, random, ways_of(walkways, robot_route)), random)
    scene = Scene(
        shapes=builder.shapes(),
        walkways=walkways,
        queue=queue,
        queue_return=queue_return,
        robot_route=robot_route,
        machine_route=machine_route,
        machines=(MachineKind.AGV, MachineKind.FORKLIFT),
        machine_speed=1.0,
        size=(LENGTH, WIDTH),
    )
    return scene.mirrored(0) if random.random() < 0.5 else scene


def _robot_route() -> NDArray[np.float64]:
    """Return the route: about the lower hall, up the ramp, about the upper hall, and down."""
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
    return np.concatenate([on_floor(lower), on_floor(upper, STOREY), on_floor([foot])])


def _furnish(furnisher: Furnisher, random: np.random.Generator) -> None:
    """Furnish one storey, to either side of its partition."""
    furnisher.take((LENGTH / 2 - 0.3, LENGTH / 2 + 0.3), _HALL.y)
    furnisher.free_standing(_HALL, PILLAR, 5)
    furnisher.free_standing(_HALL, SEATS, int(random.integers(3, 6)))
    furnisher.free_standing(_HALL, DESK, int(random.integers(3, 7)))
    furnisher.free_standing(_HALL, PLANT, 4)
    furnisher.along_walls(_HALL, int(random.integers(5, 9)), (1.0, 3.0), 0.6, (0.9, 2.0))


def _add_building(builder: Builder) -> None:
    """Add floors, walls, and the ramp between the landings."""
    clear = STOREY - 0.3
    builder.floor((0, LENGTH), (0, WIDTH))
    builder.ceiling((0, LENGTH), (_LANE, WIDTH), clear)
    ways_in = {
        0.0: passage(0.4, 2.4),
        STOREY: passage(LENGTH - 2.4, LENGTH - 0.4),
    }
    for base, way_in in ways_in.items():
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
            openings = (
                passage(_LANE + 1.0, _LANE + 7.5),
                glass_wall(_LANE + 8.0, _LANE + 12.0),
                passage(WIDTH - 8.5, WIDTH - 1.0),
            )
            builder.wall("y", LENGTH / 2, _LANE, WIDTH, openings, clear)
    slope = STOREY / (LENGTH - 2 * _LANDING)
    with builder.on(-slope * _LANDING, slope):
        builder.floor((_LANDING, LENGTH - _LANDING), (0, _LANE))


def _walkways() -> Walkways:
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
