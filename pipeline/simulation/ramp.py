"""A loading hall: a floor, a platform, and a ramp between them that all drive over.

All lengths are in metres.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.construction import Builder, glass_wall, window
from pipeline.simulation.furnishing import (
    MACHINE_MARGIN,
    TABLE,
    Furnisher,
    Piece,
    Room,
    queue_way,
    ways_of,
)
from pipeline.simulation.scene import MachineKind, Place, Scene, Walkways, on_floor
from pipeline.simulation.shapes import Surface

LENGTH, WIDTH = 30.0, 25.0
_WALL = 0.1  # half a wall

PLATFORM = 1.2
"""Height of the loading hall's platform above its floor."""

_FOOT, _EDGE = 10.0, 20.0  # x at which the ramp begins, and at which the platform does
_RAMP = (7.5, 16.5)  # y of its sides
_ROOF = 6.0


def _add_tall_pillar(builder: Builder, x: float, y: float) -> None:
    builder.pillar(x, y, _ROOF)


def _add_pallet(builder: Builder, x: float, y: float) -> None:
    """Add a pallet with boxes stacked on it."""
    builder.cabinet((x - 0.6, x + 0.6), (y - 0.4, y + 0.4), 0.15)
    builder.box((x - 0.55, x + 0.5), (y - 0.35, y + 0.38), (0.15, 0.9))
    builder.box((x - 0.55, x + 0.1), (y - 0.3, y + 0.3), (0.9, 1.4))


_TALL_PILLAR = Piece(0.6, 0.6, _add_tall_pillar)
_PALLET = Piece(1.2, 0.8, _add_pallet)


def ramp_scene(random: np.random.Generator, glass: bool = True) -> Scene:
    """Build a loading hall: a floor, a platform 1.2 m above it, and a ramp of 12 % between them.

    The machines drive over the ramp, as the robot and the people do.

    Parameters
    ----------
    random : numpy.random.Generator
        What varies from one hall to the next is drawn from it.
    glass : bool, optional
        Whether panes let rays pass; otherwise they are solid walls.
    """
    walkways = _walkways()
    robot_route = _robot_route()
    up, down = _over(12.6), _over(15.4)[::-1]
    turn = [(25.0, 12.6, PLATFORM), (25.0, 15.4, PLATFORM)]
    machine_route = on_floor([(4.5, 12.6), *up, *turn, *down, (4.5, 15.4)])
    queue = on_floor([(15.5 - 0.8 * slot, 4.0) for slot in range(6)])
    queue_return = on_floor([(15.5, 5.4), (10.9, 5.4)])
    builder = Builder(glass)
    _add_hall(builder)
    rounds = ((machine_route, MACHINE_MARGIN), queue_way(queue, queue_return))
    furnisher = Furnisher(builder, random, ways_of(walkways, robot_route, *rounds))
    furnisher.take((_FOOT - 1.0, _EDGE), (_RAMP[0] - 0.2, _RAMP[1] + 0.2))
    builder.cabinet((16.2, 16.8), (2.8, 5.2), 1.05)
    furnisher.take((16.2, 16.8), (2.8, 5.2))
    low = Room((_WALL, _EDGE - 1.0), (_WALL, WIDTH - _WALL))
    high = Room((_EDGE + 1.0, LENGTH - _WALL), (_WALL, WIDTH - _WALL))
    furnisher.free_standing(low, _TALL_PILLAR, 4)
    for base, room in ((0.0, low), (PLATFORM, high)):
        with builder.on(base):
            furnisher.along_walls(room, int(random.integers(4, 8)), (1.5, 3.0), 0.9, (1.0, 3.0))
            furnisher.free_standing(room, TABLE, int(random.integers(2, 5)))
            furnisher.free_standing(room, _PALLET, int(random.integers(4, 9)))
    scene = Scene(
        shapes=builder.shapes(),
        walkways=walkways,
        queue=queue,
        queue_return=queue_return,
        robot_route=robot_route,
        machine_route=machine_route,
        machines=(MachineKind.FORKLIFT, MachineKind.AGV),
        machine_speed=1.2,
        size=(LENGTH, WIDTH),
    )
    return scene.mirrored(0) if random.random() < 0.5 else scene


def _over(y: float) -> list[tuple[float, float, float]]:
    """Return the ends of a way up the ramp."""
    return [(_FOOT, y, 0.0), (_EDGE, y, PLATFORM)]


def _robot_route() -> NDArray[np.float64]:
    """Return the route: past the queue, up the ramp, about the platform, down, and back."""
    lower = [(2.0, 3.0), (7.0, 3.0), (7.0, 8.6)]
    upper = [(22.0, 8.6), (22.0, 2.0), (28.0, 2.0), (28.0, 23.0), (22.0, 23.0), (22.0, 8.6)]
    back = [(7.0, 8.6), (7.0, 22.0), (2.0, 22.0)]
    up = on_floor(_over(8.6))
    return np.concatenate(
        [on_floor(lower), up, on_floor(upper, PLATFORM), up[::-1], on_floor(back)]
    )


def _add_hall(builder: Builder) -> None:
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


def _walkways() -> Walkways:
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
