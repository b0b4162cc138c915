"""An office floor: corridors, rooms with desks, meeting rooms behind glass, a kitchen."""

import numpy as np

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.building import ceiling, outer_wall, wall
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import Door, Floor, Matter, Stage, level
from pipeline.simulation.shapes import Surface

_DOOR = 2.1


def office(stage: Stage, told: MeshParameters) -> None:
    """Build it."""
    u = stage.random.uniform
    long, rows = u(16, 38), int(u(1, 3))
    high, corridor = u(2.4, 3.4), u(1.6, 2.8)
    stage_rows: list[tuple[float, float, float]] = []
    y = 0.0
    for _ in range(rows):
        depth = u(3.2, 6.5)
        stage_rows.append((y, y + depth, 1.0))
        y += depth + corridor
        second = u(3.2, 6.5)
        stage_rows.append((y, y + second, -1.0))
        y += second
    wide = y
    bounds = (0.0, 0.0, long, wide)
    stage.block([-1, -1, -0.2], [long + 1, wide + 1, 0], Surface.FLOOR, albedo=u(0.15, 0.7))
    ceiling(stage, bounds, high)
    corners = [(0.0, 0.0), (long, 0.0), (long, wide), (0.0, wide)]
    for here, there in zip(corners, corners[1:] + corners[:1], strict=True):
        outer_wall(stage, here, there, 0.0, high)
    stage.floors.append(Floor(bounds, level(0.0)))
    for low, top, side in stage_rows:
        _rooms(stage, told, long, low, top, side, high)
    _corridors(stage, told, long, stage_rows)


def _rooms(
    stage: Stage,
    told: MeshParameters,
    long: float,
    low: float,
    top: float,
    side: float,
    high: float,
) -> None:
    """Divide one row into rooms; `side` says where the corridor is: 1 above, -1 below."""
    random, u = stage.random, stage.random.uniform
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
        glass = random.random() < 0.6 * told.glass
        matter = Matter.GLASS if glass else Matter.SOLID
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
            at = end - 0.08
            stage.block(
                [at - 0.01, low + 1, 0.6], [at, low + 1.8, 1.9], Surface.WALL, matter=Matter.MIRROR
            )
        x = end


def _furnish(
    stage: Stage, told: MeshParameters, room: tuple[float, float, float, float], kind: str
) -> None:
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
        _against_a_wall(stage, room)


def _against_a_wall(stage: Stage, room: tuple[float, float, float, float]) -> None:
    random, u = stage.random, stage.random.uniform
    x0, y0, x1, y1 = room
    side = int(random.integers(4))
    x = (u(x0, x1), x1 - 0.3, u(x0, x1), x0 + 0.3)[side]
    y = (y0 + 0.3, u(y0, y1), y1 - 0.3, u(y0, y1))[side]
    at = (x, y, 0.0, (np.pi / 2, np.pi, -np.pi / 2, 0.0)[side])
    thing = stage.pick([f.plant, f.cabinet, f.shelf, f.bin_, f.sign, f.coat_rack, f.chair, f.plant])
    thing(stage, at)


def _corridors(
    stage: Stage, told: MeshParameters, long: float, rows: list[tuple[float, float, float]]
) -> None:
    """Put plants, cabinets and bins along the corridors, close to their walls."""
    random, u = stage.random, stage.random.uniform
    for first, second in zip(rows[::2], rows[1::2], strict=True):
        for _ in range(random.poisson(0.15 * long * told.clutter)):
            low = random.random() < 0.5
            y = first[1] + 0.3 if low else second[0] - 0.3
            at = (u(1, long - 1), y, 0.0, np.pi / 2 if low else -np.pi / 2)
            stage.pick([f.plant, f.bin_, f.cabinet, f.bench, f.sign])(stage, at)
