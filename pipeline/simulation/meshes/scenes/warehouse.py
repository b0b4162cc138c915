"""A warehouse: aisles between high racks, pallets on the floor, gates, forklifts, pallet jacks."""

import numpy as np

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.building import ceiling, outer_wall, pillar
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import Floor, Lane, Stage, level
from pipeline.simulation.shapes import Surface


def warehouse(stage: Stage, told: MeshParameters) -> None:
    """Build it."""
    random, u = stage.random, stage.random.uniform
    bays, racks, levels = int(u(4, 11)), int(u(2, 7)), int(u(2, 6))
    aisle, apron = u(2.6, 4.5), u(3.5, 9)
    rack_long = bays * 2.7
    wide = racks * (aisle + 2.3) + aisle
    long = rack_long + 2 * apron
    high = levels * 1.9 + u(1.0, 3.0)
    bounds = (0.0, 0.0, wide, long)
    stage.block([-1, -1, -0.2], [wide + 1, long + 1, 0], Surface.FLOOR, albedo=u(0.15, 0.5))
    ceiling(stage, bounds, high)
    corners = [(0.0, 0.0), (wide, 0.0), (wide, long), (0.0, long)]
    for here, there in zip(corners, corners[1:] + corners[:1], strict=True):
        outer_wall(stage, here, there, 0, high)
    stage.floors.append(Floor(bounds, level(0.0)))
    fill = u(0.35, 0.95)
    aisles = [aisle / 2]
    for number in range(racks):
        x = aisle + number * (aisle + 2.3) + 1.15
        for side in (-0.6, 0.6):
            if random.random() < 0.92:
                f.rack(stage, (x + side, long / 2, 0, 0), bays, levels, fill)
        aisles.append(x + 1.15 + aisle / 2)
    for x in (0.5, wide - 0.5):
        for y in np.arange(3, long, 8):
            pillar(stage, x, y, high)
    _pallets(stage, told, wide, long, apron)
    _lanes(stage, aisles, long, apron)


def _pallets(stage: Stage, told: MeshParameters, wide: float, long: float, apron: float) -> None:
    """Put pallets, cartons and work places on the aprons, and people's desks at a wall."""
    random, u = stage.random, stage.random.uniform
    for _ in range(random.poisson(0.35 * wide * told.clutter)):
        near = random.random() < 0.5
        y = u(0.8, apron - 1.6) if near else long - u(0.8, apron - 1.6)
        f.pallet(stage, (u(1, wide - 1), y, 0, random.choice([0, np.pi / 2]) + u(-0.1, 0.1)))
    for _ in range(int(u(1, 4))):
        at = (u(2, wide - 2), 0.8, 0.0, -np.pi / 2)
        f.desk(stage, at, told.clutter)
        f.office_chair(stage, (at[0], 1.5, 0.0, -np.pi / 2))
    for _ in range(random.poisson(3 * told.clutter)):
        thing = stage.pick([f.bin_, f.cabinet, f.sign, f.shelf, f.plant])
        thing(stage, (u(1, wide - 1), long - 0.5, 0.0, -np.pi / 2))
    if random.random() < 0.5:
        y = apron - 0.6
        f.railing(stage, np.array([u(1, wide / 2), y, 0]), np.array([wide / 2 + 2, y, 0]), 1.1)


def _lanes(stage: Stage, aisles: list[float], long: float, apron: float) -> None:
    """Let forklifts go up one aisle and down another."""
    random = stage.random
    low, top = apron * 0.7, long - apron * 0.7
    for _ in range(3):
        first, second = random.choice(len(aisles), 2, replace=False)
        x0, x1 = aisles[first], aisles[second]
        line = np.array([[x0, low, 0], [x0, top, 0], [x1, top, 0], [x1, low, 0], [x0, low, 0]])
        stage.lanes.append(Lane(line, ("forklift", "forklift", "robot"), (0.8, 2.5), closed=True))
