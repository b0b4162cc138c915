"""A street of 120 metres over a hill: facades, trees, parked cars, and pavements to both sides.

The road rises to its middle and falls again, so that streets can be put end to end. All lengths are
in metres; heights are above the road.
"""

from itertools import pairwise

import numpy as np

from pipeline.simulation.construction import Builder, Span
from pipeline.simulation.movers import bicycle, car
from pipeline.simulation.scene import Place, Scene, Surface, Walkways
from pipeline.simulation.tables import Floats, Random

LENGTH, WIDTH = 120.0, 40.0
_MIDDLE = WIDTH / 2
_ROAD, _PAVEMENT = 5.0, 9.5  # from the middle to the kerb, and to the facades
_KERB = 0.12
_LANE, _PARKING = 1.6, 4.0  # middle of a lane, and of the parking strip
_TREES, _WALKING, _ROBOT = 5.7, 7.0, 8.3
_CROSSINGS = (15.0, 60.0, 105.0)
_TRANSVERSE = 3.0  # x at which the robot crosses, and as far from the other end


def street_scene(random: Random, glass: bool = True) -> Scene:
    """Draw a street: the slope of its road (2 to 6 %), houses, trees and parked cars.

    Shop windows let rays pass; without `glass` they are solid walls.
    """
    slope = random.uniform(0.02, 0.06)
    walkways = _walkways(slope)
    builder = Builder(glass)
    # Each half lies on a floor that is 0 high at its own end.
    for half, (base, rise) in enumerate(((0.0, slope), (slope * LENGTH, -slope))):
        x = (LENGTH / 2 * half, LENGTH / 2 * (half + 1))
        with builder.on(base, rise):
            builder.floor(x, (_MIDDLE - _ROAD, _MIDDLE + _ROAD))
            for side in (-1, 1):
                builder.box(x, _between(side, _ROAD, WIDTH / 2), (-0.3, _KERB), Surface.FLOOR)
            for side in (-1, 1):
                _add_houses(builder, x, side, random)
                _add_trees_and_lamps(builder, x, side, random)
                _add_parked_cars(builder, x, side, random)
    kiosk = 33.0
    with builder.on(0.0, slope):
        y = _MIDDLE + _TREES
        builder.box((kiosk, kiosk + 1.6), (y - 0.6, y + 0.6), (0.0, 2.4), Surface.FURNITURE)
    queue = [(kiosk - 0.6 - 0.8 * slot, y) for slot in range(6)]
    back = [(kiosk - 0.6, y + 1.0), (kiosk - 5.2, y + 1.0)]
    ends = 8.0, LENGTH / 2, LENGTH - 8.0
    lanes = [(x, _MIDDLE - _LANE, 0.0) for x in ends]
    lanes += [(x, _MIDDLE + _LANE, 0.0) for x in ends[::-1]]
    return Scene(
        shapes=builder.shapes(),
        walkways=walkways,
        queue=_on_hill([(*slot, _KERB) for slot in queue], slope),
        queue_return=_on_hill([(*corner, _KERB) for corner in back], slope),
        robot_route=_on_hill(_robot_route(), slope),
        machine_route=_on_hill(lanes, slope),
        machines=(car, bicycle),
        machine_speed=5.0,
        size=(LENGTH, WIDTH),
        gap=0.0,
    )


def _robot_route() -> list[tuple[float, float, float]]:
    """Return the way along one pavement, over the road, back along the other, and over again."""
    west, middle, east = _TRANSVERSE, LENGTH / 2, LENGTH - _TRANSVERSE
    south, north = _MIDDLE - _ROBOT, _MIDDLE + _ROBOT
    kerbs = _MIDDLE - _ROAD, _MIDDLE + _ROAD
    corners = [(west, south), (middle, south), (east, south), *((east, kerb) for kerb in kerbs)]
    corners += [(east, north), (middle, north), (west, north)]
    corners += [(west, kerb) for kerb in kerbs[::-1]]
    return [(x, y, _KERB) for x, y in corners]


def _on_hill(corners: list[tuple[float, float, float]], slope: float) -> Floats:
    """Return corners given by x, y and the height above the road."""
    points = np.array(corners)
    points[:, 2] += slope * np.minimum(points[:, 0], LENGTH - points[:, 0])
    return points


def _between(side: int, near: float, far: float) -> Span:
    """Return y on one side of the road, from the middle's distance to something."""
    low, high = sorted((_MIDDLE + side * near, _MIDDLE + side * far))
    return low, high


def _add_houses(builder: Builder, x: Span, side: int, random: Random) -> None:
    """Add houses side by side, each with its own height, set-back, and windows."""
    start = x[0]
    while start < x[1]:
        end = start + random.uniform(8.0, 16.0)
        if x[1] - end < 6.0:
            end = x[1]
        front = _PAVEMENT + random.uniform(0.0, 1.2)
        height = random.uniform(6.0, 14.0)
        storeys = np.arange(_KERB, height - 2.5, 3.0)
        # Windows are recesses 0.3 m deep; the ground floor's let rays into a room behind them.
        back = _between(side, front + 0.3, WIDTH / 2)
        rooms = builder.glass and random.random() < 0.5
        first = 3.0 if rooms else _KERB
        builder.box((start, end), back, (first, height), Surface.WALL)
        if rooms:
            builder.box(
                (start, end), _between(side, front + 3.0, WIDTH / 2), (0.0, 3.0), Surface.WALL
            )
            deep = _between(side, front + 0.3, front + 3.0)
            for side_wall in (start, end - 0.2):
                builder.box((side_wall, side_wall + 0.2), deep, (0.0, 3.0), Surface.WALL)
        for bottom, top in pairwise([*storeys, height]):
            for strip in ((bottom, bottom + 0.9), (bottom + 2.3, top)):
                builder.box((start, end), _between(side, front, front + 0.3), strip, Surface.WALL)
        columns = max(2, round((end - start) / 3.0) + 1)
        for middle in np.linspace(start + 0.3, end - 0.3, columns):
            column = (middle - 0.3, middle + 0.3)
            builder.box(column, _between(side, front, front + 0.3), (_KERB, height), Surface.WALL)
        start = end


def _add_trees_and_lamps(builder: Builder, x: Span, side: int, random: Random) -> None:
    """Add trees, whose crowns are many clumps of leaves, and lamp posts between them."""
    y = _MIDDLE + side * _TREES
    for place in np.arange(x[0] + 6.0, x[1] - 3.0, 10.0):
        if any(abs(place - crossing) < 2.5 for crossing in _CROSSINGS) or random.random() < 0.2:
            continue
        if side > 0 and 26.0 < place < 38.0:  # the kiosk and its queue
            continue
        trunk = random.uniform(2.4, 3.2)
        builder.cylinder(
            place, y, random.uniform(0.12, 0.25), (0.0, trunk + 1.0), Surface.VEGETATION
        )
        clumps = random.normal(size=(30, 3)) * [1.0, 1.0, 0.8] + [place, y, trunk + 1.6]
        clumps[:, 2] = np.maximum(clumps[:, 2], 2.4)  # people walk under them
        for clump, size in zip(clumps, random.uniform(0.1, 0.4, len(clumps)), strict=True):
            # The bounds of a box on a slope are above the floor, as the clump's height is.
            wide, deep, high = ((middle - size, middle + size) for middle in clump)
            builder.box(wide, deep, high, Surface.VEGETATION)
    for place in (x[0] + 11.0, x[0] + 51.0):
        builder.cylinder(place, y, 0.08, (0.0, 5.0))


def _add_parked_cars(builder: Builder, along: Span, side: int, random: Random) -> None:
    """Park cars along the kerb, but for gaps and crossings."""
    for place in np.arange(along[0] + 9.0, along[1] - 6.0, 6.0):
        free = all(abs(place - crossing) > 5.0 for crossing in _CROSSINGS)
        if not free or random.random() < 0.35:
            continue
        x, y = place + random.uniform(-0.4, 0.4), _MIDDLE + side * _PARKING
        for x0, y0, z0, x1, y1, z1, _, _ in car(random).boxes:
            builder.box((x + x0, x + x1), (y + y0, y + y1), (z0, z1), Surface.VEHICLE)


def _walkways(slope: float) -> Walkways:
    """Return the ways along both pavements, and over the road at the crossings."""
    stops = (5.0, *_CROSSINGS[:1], 40.0, *_CROSSINGS[1:2], 80.0, *_CROSSINGS[2:], 115.0)
    places, lines = {}, []
    for name, side in (("south", -1), ("north", 1)):
        for x in stops:
            height = _KERB + slope * min(x, LENGTH - x)
            places[f"{name} {x}"] = Place(x, _MIDDLE + side * _WALKING, 0.4, height)
        lines.append([f"{name} {x}" for x in stops])
    lines += [[f"south {x}", f"north {x}"] for x in _CROSSINGS]
    return Walkways.along(places, lines)
