"""A long corridor: lockers, door recesses, glass, side rooms seen through doors, bends."""

import numpy as np

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.building import ceiling, wall
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import Door, Floor, Matter, Stage, level
from pipeline.simulation.shapes import Surface


def corridor(stage: Stage, told: MeshParameters) -> None:
    """Build one along x, perhaps with a second one off it along y."""
    random, u = stage.random, stage.random.uniform
    long, wide, high = u(25, 80), u(1.8, 4.0), u(2.4, 3.6)
    depth = u(3, 7)
    bounds = (0.0, -depth, long, wide + depth)
    x0, y0, x1, y1 = bounds
    stage.block([x0 - 1, y0 - 1, -0.2], [x1 + 1, y1 + 1, 0], Surface.FLOOR, albedo=u(0.15, 0.7))
    ceiling(stage, bounds, high)
    stage.floors.append(Floor(bounds, level(0.0)))
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
            wall(stage, (x, front), (end, front), 0, high, ((begin, width, 0, 2.1),), 0.12,
                 Matter.GLASS if glass else Matter.SOLID)  # fmt: skip
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


def _room(stage: Stage, told: MeshParameters, room: tuple[float, float, float, float]) -> None:
    random, u = stage.random, stage.random.uniform
    x0, y0, x1, y1 = room
    if x1 - x0 < 1.6:
        return
    for _ in range(random.poisson(3 * told.clutter)):
        at = (u(x0 + 0.3, x1 - 0.3), u(y0 + 1.4, y1 - 1.4), 0.0, u(0, 2 * np.pi))
        kind = int(random.integers(5))
        if kind == 0:
            f.desk(stage, at, told.clutter)
        elif kind == 1:
            f.table(stage, at, int(u(1, 5)))
        else:
            (f.shelf, f.office_chair, f.plant)[kind - 2](stage, at)


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
            f.railing(stage, np.array([x, side, 0]), np.array([x + u(2, 8), side, 0]), 0.95)
        else:
            (f.plant, f.bin_, f.coat_rack, f.cabinet)[kind - 3](stage, (x, y, 0, yaw))
    if random.random() < 0.3 * told.mirrors:
        x = u(2, long - 4)
        stage.block([x, 0.065, 0.4], [x + 1.5, 0.075, 2.0], Surface.WALL, matter=Matter.MIRROR)
