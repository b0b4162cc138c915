"""A small room: a laboratory, a class room or a shop, for a sensor that stands still."""

import numpy as np

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.building import ceiling, outer_wall, wall
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import Door, Floor, Matter, Stage, level
from pipeline.simulation.shapes import Surface


def room(stage: Stage, told: MeshParameters) -> None:
    """Build it, with a passage behind one wall that is seen through its door."""
    random, u = stage.random, stage.random.uniform
    long, wide, high = u(4.5, 14), u(4, 11), u(2.4, 4.2)
    passage = u(1.5, 3)
    bounds = (0.0, 0.0, long, wide + passage)
    stage.block(
        [-1, -1, -0.2], [long + 1, wide + passage + 1, 0], Surface.FLOOR, albedo=u(0.15, 0.7)
    )
    ceiling(stage, bounds, high)
    stage.floors.append(Floor(bounds, level(0.0)))
    outer_wall(stage, (0, 0), (long, 0), 0, high)
    outer_wall(stage, (long, 0), (long, wide + passage), 0, high)
    wall(stage, (0, wide + passage), (long, wide + passage), 0, high)
    wall(stage, (0, 0), (0, wide + passage), 0, high)
    begin, width = u(0.4, long - 1.8), u(0.85, 1.3)
    matter = Matter.GLASS if random.random() < 0.4 * told.glass else Matter.SOLID
    wall(stage, (0, wide), (long, wide), 0, high, ((begin, width, 0, 2.1),), 0.12, matter)
    stage.doors.append(Door(begin, wide, 0, 0, width, 2.06))
    _middle(stage, told, long, wide)
    _edges(stage, told, long, wide)
    if random.random() < told.mirrors:
        low = u(0.5, wide - 2)
        stage.block([0.07, low, u(0.1, 0.6)], [0.08, low + u(0.6, 1.5), 1.9], Surface.WALL,
                    matter=Matter.MIRROR)  # fmt: skip


def _middle(stage: Stage, told: MeshParameters, long: float, wide: float) -> None:
    """Leave the middle free, or put rows of desks, one table, or scattered chairs there."""
    random, u = stage.random, stage.random.uniform
    kind = int(random.integers(4))
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


def _edges(stage: Stage, told: MeshParameters, long: float, wide: float) -> None:
    """Put shelves, desks and cabinets along the walls."""
    random, u = stage.random, stage.random.uniform
    for _ in range(random.poisson(7 * told.clutter)):
        side = int(random.integers(3))
        at = [
            (0.35, u(0.5, wide - 0.5), 0.0, 0.0),
            (u(0.5, long - 0.5), 0.35, 0.0, np.pi / 2),
            (long - 0.35, u(0.5, wide - 0.5), 0.0, np.pi),
        ][side]
        things = [f.shelf, f.cabinet, f.plant, f.coat_rack, f.sofa, f.bin_, f.chair, f.desk]
        stage.pick(things)(stage, at)
