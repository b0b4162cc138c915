"""Two storeys around a hall, joined by a flight of stairs with handrails and a landing."""

import numpy as np

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.building import ceiling, outer_wall, pillar
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import Floor, Stage, level
from pipeline.simulation.shapes import Surface


def stairs(stage: Stage, told: MeshParameters) -> None:
    """Build it: the well of the stairs lies along x at y from `y0` to `y0 + broad`."""
    u = stage.random.uniform
    long, wide, storey = u(13, 26), u(8, 16), u(2.9, 3.8)
    broad, run = u(1.5, 2.4), u(0.27, 0.32)
    steps = int(np.ceil(storey / 0.17))
    x0, y0 = u(1.8, long - steps * run - 2.0), u(1.5, wide - broad - 1.5)
    x1 = x0 + steps * run
    bounds = (0.0, 0.0, long, wide)
    stage.block([-1, -1, -0.2], [long + 1, wide + 1, 0], Surface.FLOOR)
    for low, high in (  # the upper floor, without the well
        ((0.0, 0.0), (long, y0)), ((0.0, y0 + broad), (long, wide)),
        ((0.0, y0), (x0, y0 + broad)), ((x1, y0), (long, y0 + broad)),
    ):  # fmt: skip
        stage.block([*low, storey - 0.25], [*high, storey], Surface.FLOOR)
    ceiling(stage, bounds, storey, storey)
    corners = [(0.0, 0.0), (long, 0.0), (long, wide), (0.0, wide)]
    for here, there in zip(corners, corners[1:] + corners[:1], strict=True):
        outer_wall(stage, here, there, 0.0, storey)
        outer_wall(stage, here, there, storey, storey)
    _flight(stage, (x0, y0, broad), steps, run, storey)
    for base in (0.0, storey):
        stage.floors.append(Floor(bounds, level(base)))
        _things(stage, told, long, wide, base, (x0 - 1.5, y0 - 0.8, x1 + 1.5, y0 + broad + 0.8))
    for x in (long * 0.3, long * 0.7):
        pillar(stage, x, u(0.5, 1.0), 2 * storey)
    lead = np.array([[x0 - 0.8, y0 + broad / 2, 0], [x0 - 0.1, y0 + broad / 2, 0]])
    share = np.linspace(0, 1, 12)[1:-1]
    climb = np.column_stack([x0 + share * (x1 - x0), np.full(10, y0 + broad / 2), share * storey])
    top = np.array([[x1 + 0.2, y0 + broad / 2, storey], [x1 + 0.8, y0 + broad / 2, storey]])
    stage.links.append(np.concatenate([lead, climb, top]))


def _flight(
    stage: Stage, well: tuple[float, float, float], steps: int, run: float, storey: float
) -> None:
    """Build the steps, handrails beside them, and railings about the well above."""
    u = stage.random.uniform
    x0, y0, broad = well
    rise = storey / steps
    solid = u() < 0.5
    rows = []
    for step in range(steps):
        top = (step + 1) * rise
        deep = top if solid else rise * 1.3
        rows.append(
            [x0 + (step + 0.5) * run, y0 + broad / 2, top - deep / 2, run + 0.02, broad, deep]
        )
    stage.boxes(rows, Surface.FLOOR)
    x1 = x0 + steps * run
    for y in (y0 + 0.06, y0 + broad - 0.06):
        f.railing(stage, np.array([x0, y, 0]), np.array([x1, y, storey]), 0.95)
        edge = y - 0.1 if y < y0 + broad / 2 else y + 0.1
        f.railing(stage, np.array([x0, edge, storey]), np.array([x1, edge, storey]), 1.05)
    f.railing(
        stage, np.array([x0 - 0.05, y0, storey]), np.array([x0 - 0.05, y0 + broad, storey]), 1.05
    )


def _things(
    stage: Stage, told: MeshParameters, long: float, wide: float, base: float,
    kept_free: tuple[float, float, float, float],
) -> None:  # fmt: skip
    random, u = stage.random, stage.random.uniform
    low_x, low_y, top_x, top_y = kept_free
    for _ in range(random.poisson(long * wide / 25 * told.clutter)):
        x, y = u(0.8, long - 0.8), u(0.8, wide - 0.8)
        if low_x < x < top_x and low_y < y < top_y:
            continue
        at = (x, y, base, u(0, 2 * np.pi))
        kind = int(random.integers(6))
        if kind == 0:
            f.table(stage, at, int(u(2, 7)))
        else:
            (f.plant, f.bench, f.sofa, f.shelf, f.sign)[kind - 1](stage, at)
