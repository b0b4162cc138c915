"""Scenes of rooms: an office floor, a long corridor, a small room."""

import numpy as np

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.building import ceiling, level_ground, outer_wall, sides, wall
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import Door, Matter, Stage, Thing
from pipeline.simulation.scene import Surface

_DOOR = 2.1

_Room = tuple[float, float, float, float]  # x0, y0, x1, y1
_Row = tuple[float, float, float]  # y0, y1, and where the corridor is: 1 above, -1 below


def office(stage: Stage, told: MeshParameters) -> None:
    """Build an office floor: corridors, rooms with desks, meeting rooms behind glass, a kitchen."""
    random, u = stage.random, stage.random.uniform
    long, pairs = u(16, 38), int(u(1, 3))
    high, corridor = u(2.4, 3.4), u(1.6, 2.8)
    rows: list[_Row] = []
    wide = 0.0
    for side in (1.0, -1.0) * pairs:
        depth = u(3.2, 6.5)
        rows.append((wide, wide + depth, side))
        wide += depth + (corridor if side > 0 else 0.0)
    bounds = (0.0, 0.0, long, wide)
    level_ground(stage, bounds, u(0.15, 0.7))
    ceiling(stage, bounds, high)
    for here, there in sides(long, wide):
        outer_wall(stage, here, there, 0.0, high)
    for row in rows:
        _rooms(stage, told, long, row, high)
    for first, second in zip(rows[::2], rows[1::2], strict=True):
        for _ in range(random.poisson(0.15 * long * told.clutter)):
            low = random.random() < 0.5
            y = first[1] + 0.3 if low else second[0] - 0.3
            at = (u(1, long - 1), y, 0.0, np.pi / 2 if low else -np.pi / 2)
            stage.pick([f.plant, f.bin_, f.cabinet, f.bench, f.sign])(stage, at)


def _rooms(stage: Stage, told: MeshParameters, long: float, row: _Row, high: float) -> None:
    """Divide one row into rooms."""
    random, u = stage.random, stage.random.uniform
    low, top, side = row
    front = top if side > 0 else low
    if random.random() < 0.12:  # open plan
        _furnish(stage, told, (0.3, low, long - 0.3, top), "desks")
        return
    x = 0.0
    while x < long - 2.5:
        end = x + u(2.6, 8.0)
        if end > long - 2.6:
            end = long
        width = u(0.85, 1.1) if random.random() < 0.85 else u(1.5, min(2.4, end - x - 0.5))
        along = u(0.2, max(0.25, end - x - width - 0.2))
        matter = Matter.GLASS if random.random() < 0.6 * told.glass else Matter.SOLID
        wall(stage, (x, front), (end, front), 0, high, ((along, width, 0, _DOOR),), 0.12, matter)
        if end < long:
            wall(stage, (end, low), (end, top), 0, high)
        hinge = (x + along, front)
        if width < 1.2:
            if random.random() < 0.5:
                stage.doors.append(Door(*hinge, 0.0, 0.0, width, _DOOR))
            else:  # a leaf that stands open all the time
                leaf = [width / 2, 0, 1.02, width, 0.045, 2.03]
                stage.boxes(leaf, Surface.FURNITURE, (*hinge, 0.0, -side * u(1.2, 2.0)))
        kind = str(random.choice(["desks", "desks", "meeting", "store", "kitchen", "lounge"]))
        _furnish(stage, told, (x + 0.2, low + 0.2, end - 0.2, top - 0.2), kind)
        if random.random() < 0.3 * told.mirrors:
            first, last = [end - 0.08 - 0.01, low + 1, 0.6], [end - 0.08, low + 1.8, 1.9]
            stage.block(first, last, Surface.WALL, matter=Matter.MIRROR)
        x = end


def _furnish(stage: Stage, told: MeshParameters, room: _Room, kind: str) -> None:
    random, u = stage.random, stage.random.uniform
    x0, y0, x1, y1 = room
    if x1 - x0 < 1.5 or y1 - y0 < 1.5:
        return
    middle = ((x0 + x1) / 2, (y0 + y1) / 2)
    if kind == "desks":
        for x in np.arange(x0 + 0.9, x1 - 0.7, u(1.9, 2.8)):
            for y in np.arange(y0 + 1.0, y1 - 0.8, u(1.7, 2.4)):
                if random.random() < 0.75:
                    yaw = float(random.choice([0, np.pi]))
                    f.desk(stage, (x, y, 0, yaw), told.clutter)
                    off = u(0.45, 0.9)
                    seat = (x - off * np.cos(yaw), y - off * np.sin(yaw), 0, yaw + u(-0.7, 0.7))
                    f.office_chair(stage, seat)
    elif kind == "meeting":
        f.table(stage, (*middle, 0, float(random.choice([0, np.pi / 2]))), int(u(4, 11)))
        stage.boxes([0, 0, 1.5, 0.05, 1.6, 1.0], Surface.FURNITURE, (x0 + 0.1, middle[1], 0, 0))
    elif kind == "store":
        for x in np.arange(x0 + 0.6, x1 - 0.6, 1.6):
            f.shelf(stage, (x, y0 + 0.25, 0, np.pi / 2), u(0.8, 1.4))
            if y1 - y0 > 3:
                f.shelf(stage, (x, y1 - 0.25, 0, -np.pi / 2), u(0.8, 1.4))
    elif kind == "kitchen":
        f.counter(stage, (x0 + 0.35, middle[1], 0, 0), min(3.0, y1 - y0 - 0.5))
        f.table(stage, (*middle, 0, u(0, np.pi)), int(u(2, 6)))
    else:
        f.sofa(stage, (x0 + 0.6, middle[1], 0, 0))
        f.table(stage, (*middle, 0, u(0, np.pi)), int(u(0, 3)))
    for _ in range(random.poisson(2.0 * told.clutter)):
        side = int(random.integers(4))
        x = (u(x0, x1), x1 - 0.3, u(x0, x1), x0 + 0.3)[side]
        y = (y0 + 0.3, u(y0, y1), y1 - 0.3, u(y0, y1))[side]
        at = (x, y, 0.0, (np.pi / 2, np.pi, -np.pi / 2, 0.0)[side])
        stage.pick([f.plant, f.cabinet, f.shelf, f.bin_, f.sign, f.coat_rack, f.chair, f.plant])(
            stage, at
        )


def corridor(stage: Stage, told: MeshParameters) -> None:
    """Build a corridor: lockers, door recesses, glass, side rooms seen through doors."""
    random, u = stage.random, stage.random.uniform
    long, wide, high = u(25, 80), u(1.8, 4.0), u(2.4, 3.6)
    depth = u(3, 7)
    bounds = (0.0, -depth, long, wide + depth)
    x0, y0, x1, y1 = bounds
    level_ground(stage, bounds, u(0.15, 0.7))
    ceiling(stage, bounds, high)
    for here, there in (((x0, y0), (x1, y0)), ((x0, y1), (x1, y1))):
        wall(stage, here, there, 0, high, thick=0.25)
    for x in (x0, x1):
        matter = Matter.GLASS if random.random() < 0.5 * told.glass else Matter.SOLID
        wall(stage, (x, y0), (x, y1), 0, high, thick=0.2, matter=matter)
    for front, back, side in ((0.0, y0, -1.0), (wide, y1, 1.0)):
        _side(stage, told, long, (front, back, side), high)
    _along_the_walls(stage, told, long, wide)


def _side(
    stage: Stage, told: MeshParameters, long: float, line: tuple[float, float, float], high: float
) -> None:
    """Build one side: walls, recesses, glass fronts and rooms behind them."""
    random, u = stage.random, stage.random.uniform
    front, back, side = line
    x = 0.0
    while x < long - 2:
        end = min(x + u(3, 9), long)
        kind = random.random()
        if kind < 0.25:  # a blind stretch
            wall(stage, (x, front), (end, front), 0, high)
        elif kind < 0.4:  # a recess
            deep = front + side * u(0.3, 1.2)
            wall(stage, (x, deep), (end, deep), 0, high)
            for edge in (x, end):
                wall(stage, (edge, min(front, deep)), (edge, max(front, deep)), 0, high)
        else:
            glass = random.random() < 0.5 * told.glass
            width = u(0.85, 1.2)
            begin = u(0.3, max(0.35, end - x - width - 0.3))
            shut = random.random() < 0.35
            matter = Matter.GLASS if glass else Matter.SOLID
            hole = (begin, width, 0, _DOOR)
            wall(stage, (x, front), (end, front), 0, high, (hole,), 0.12, matter)
            leaf = [width / 2, 0, 1.03, width, 0.045, 2.06]
            if shut:
                recess = front + side * 0.1
                stage.boxes(leaf, Surface.FURNITURE, (x + begin, recess, 0, 0))
            elif random.random() < 0.5:
                stage.doors.append(Door(x + begin, front, 0, 0, width, 2.06))
            else:
                stage.boxes(leaf, Surface.FURNITURE, (x + begin, front, 0, side * u(0.9, 2.0)))
            if not shut or glass:
                _room(stage, told, (x + 0.4, min(front, back), end - 0.4, max(front, back)))
        if end < long:
            wall(stage, (end, min(front, back)), (end, max(front, back)), 0, high)
        x = end


def _room(stage: Stage, told: MeshParameters, room: _Room) -> None:
    random, u = stage.random, stage.random.uniform
    x0, y0, x1, y1 = room
    if x1 - x0 < 1.6:
        return
    things: list[Thing] = [
        lambda stage, at: f.desk(stage, at, told.clutter),
        lambda stage, at: f.table(stage, at, int(u(1, 5))),
        *(f.shelf, f.office_chair, f.plant),
    ]
    for _ in range(random.poisson(3 * told.clutter)):
        at = (u(x0 + 0.3, x1 - 0.3), u(y0 + 1.4, y1 - 1.4), 0.0, u(0, 2 * np.pi))
        stage.pick(things)(stage, at)


def _along_the_walls(stage: Stage, told: MeshParameters, long: float, wide: float) -> None:
    """Put lockers, benches, plants, handrails and boards on both sides."""
    random, u = stage.random, stage.random.uniform
    for _ in range(random.poisson(long / 7 * told.clutter)):
        low = random.random() < 0.5
        y, yaw = (0.28, np.pi / 2) if low else (wide - 0.28, -np.pi / 2)
        x = u(1, long - 2)
        kind = int(random.integers(7))
        if kind == 0:
            count = int(u(2, 12))
            rows = [[0, n * 0.3, 0.92, 0.42, 0.29, u(1.78, 1.84)] for n in range(count)]
            stage.boxes(rows, Surface.FURNITURE, (x, y, 0, yaw))
        elif kind == 1 and wide > 2.2:
            f.bench(stage, (x, y, 0, yaw))
        elif kind == 2:
            side = 0.12 if low else wide - 0.12
            f.railing(stage, [x, side, 0], [x + u(2, 8), side, 0], 0.95)
        else:
            (f.plant, f.bin_, f.coat_rack, f.cabinet)[kind - 3](stage, (x, y, 0, yaw))
    if random.random() < 0.3 * told.mirrors:
        x = u(2, long - 4)
        stage.block([x, 0.065, 0.4], [x + 1.5, 0.075, 2.0], Surface.WALL, matter=Matter.MIRROR)


def room(stage: Stage, told: MeshParameters) -> None:
    """Build a small room, with a passage behind one wall that is seen through its door."""
    random, u = stage.random, stage.random.uniform
    long, wide, high = u(4.5, 14), u(4, 11), u(2.4, 4.2)
    passage = u(1.5, 3)
    bounds = (0.0, 0.0, long, wide + passage)
    level_ground(stage, bounds, u(0.15, 0.7))
    ceiling(stage, bounds, high)
    outer_wall(stage, (0, 0), (long, 0), 0, high)
    outer_wall(stage, (long, 0), (long, wide + passage), 0, high)
    wall(stage, (0, wide + passage), (long, wide + passage), 0, high)
    wall(stage, (0, 0), (0, wide + passage), 0, high)
    begin, width = u(0.4, long - 1.8), u(0.85, 1.3)
    matter = Matter.GLASS if random.random() < 0.4 * told.glass else Matter.SOLID
    wall(stage, (0, wide), (long, wide), 0, high, ((begin, width, 0, _DOOR),), 0.12, matter)
    stage.doors.append(Door(begin, wide, 0, 0, width, 2.06))
    kind = int(random.integers(4))  # of the middle: free, rows of desks, one table, chairs
    if kind == 1:
        for x in np.arange(1.6, long - 1.2, u(1.6, 2.4)):
            for y in np.arange(1.3, wide - 1.5, u(1.5, 2.2)):
                if random.random() < 0.8:
                    f.desk(stage, (x, y, 0, 0), told.clutter)
                    f.chair(stage, (x - 0.7, y, 0, u(-0.4, 0.4)))
    elif kind == 2:
        f.table(stage, (long / 2, wide / 2, 0, u(0, np.pi)), int(u(2, 11)))
    elif kind == 3:
        for _ in range(random.poisson(6 * told.clutter)):
            at = (u(1, long - 1), u(1, wide - 1), 0.0, u(0, 2 * np.pi))
            stage.pick([f.chair, f.office_chair, f.bin_, f.sign])(stage, at)
    for _ in range(random.poisson(7 * told.clutter)):  # along the walls
        side = int(random.integers(3))
        west, south, east = u(0.5, wide - 0.5), u(0.5, long - 0.5), u(0.5, wide - 0.5)
        x, y = ((0.35, west), (south, 0.35), (long - 0.35, east))[side]
        at = (x, y, 0.0, side * np.pi / 2)
        things = [f.shelf, f.cabinet, f.plant, f.coat_rack, f.sofa, f.bin_, f.chair, f.desk]
        stage.pick(things)(stage, at)
    if random.random() < told.mirrors:
        low = u(0.5, wide - 2)
        stage.block([0.07, low, u(0.1, 0.6)], [0.08, low + u(0.6, 1.5), 1.9], Surface.WALL,
                    matter=Matter.MIRROR)  # fmt: skip
