"""A hall: pillars, counters, benches, railings, plants, glass, and room for a crowd."""

import numpy as np

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.building import ceiling, outer_wall, pillar, wall
from pipeline.simulation.meshes.mesh import tubes
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import Floor, Matter, Stage, level
from pipeline.simulation.shapes import Surface


def lobby(stage: Stage, told: MeshParameters) -> None:
    """Build it."""
    random, u = stage.random, stage.random.uniform
    long, wide, high = u(18, 42), u(13, 30), u(3.0, 8.0)
    bounds = (0.0, 0.0, long, wide)
    stage.block([-8, -8, -0.2], [long + 8, wide + 8, 0], Surface.FLOOR, albedo=u(0.15, 0.7))
    ceiling(stage, bounds, high)
    corners = [(0.0, 0.0), (long, 0.0), (long, wide), (0.0, wide)]
    for here, there in zip(corners, corners[1:] + corners[:1], strict=True):
        length = float(np.hypot(there[0] - here[0], there[1] - here[1]))
        if random.random() < 0.4 * told.glass + 0.1:
            wall(stage, here, there, 0, high, ((length / 2, 1.8, 0, 2.2),), 0.1, Matter.GLASS)
        else:
            outer_wall(stage, here, there, 0, high)
    stage.floors.append(Floor(bounds, level(0.0)))
    _pillars(stage, long, wide, high)
    _counters(stage, long, wide)
    _islands(stage, told, long, wide)
    _railings(stage, long, wide)
    _upper_floor(stage, long, wide, high)


def _pillars(stage: Stage, long: float, wide: float, high: float) -> None:
    u = stage.random.uniform
    if u() < 0.75:
        pitch = u(4.5, 9)
        for x in np.arange(pitch / 2, long, pitch):
            for y in np.arange(pitch / 2, wide, pitch):
                if u() < 0.9:
                    pillar(stage, x, y, high)


def _counters(stage: Stage, long: float, wide: float) -> None:
    """Put counters along one side, with a queue between tapes before the first."""
    random, u = stage.random, stage.random.uniform
    for number in range(int(u(1, 4))):
        x = u(3, long - 3)
        size = u(2, 5)
        f.counter(stage, (x, 1.5, 0, np.pi / 2), size)
        if random.random() < 0.7:
            stage.boxes([0, 0, 1.1, 0.4, size, 2.2], Surface.FURNITURE, (x, 0.4, 0, np.pi / 2))
        if not number:
            slots = np.arange(8)
            stage.queue = np.column_stack([np.full(8, x), 2.4 + 0.8 * slots, np.zeros(8)])
            if random.random() < 0.6:
                _tapes(stage, x, 2.6)


def _tapes(stage: Stage, x: float, y: float) -> None:
    """Put posts with tape between them on both sides of a queue."""
    lines, radii = [], []
    for side in (-0.6, 0.6):
        posts = y + np.arange(4) * 1.6
        for post in posts:
            lines.append([[x + side, post, 0], [x + side, post, 0.95]])
            radii.append([0.03, 0.03])
        for height in (0.9, 0.86):
            lines.append([[x + side, posts[0], height], [x + side, posts[-1], height]])
            radii.append([0.015, 0.015])
    stage.mesh(tubes(lines, np.array(radii), 5), Surface.FURNITURE)


def _islands(stage: Stage, told: MeshParameters, long: float, wide: float) -> None:
    """Scatter tables, benches, sofas, plants, boards and shelves."""
    random, u = stage.random, stage.random.uniform
    for _ in range(random.poisson(long * wide / 45 * told.clutter)):
        at = (u(1.5, long - 1.5), u(4, wide - 1.5), 0.0, u(0, 2 * np.pi))
        kind = random.integers(8)
        if kind == 0:
            f.table(stage, at, int(u(2, 9)))
        elif kind == 1:
            f.sofa(stage, at)
        elif kind in (2, 3):
            f.bench(stage, at)
        elif kind == 4:
            for _ in range(int(u(1, 5))):
                f.plant(stage, (at[0] + u(-0.6, 0.6), at[1] + u(-0.6, 0.6), 0, 0), u(0.6, 2.6))
        elif kind == 5:
            f.sign(stage, at)
        elif kind == 6:
            f.shelf(stage, at, u(1, 2.5))
        else:
            f.bin_(stage, at)
    for _ in range(random.poisson(6 * told.clutter)):
        side = random.random() < 0.5
        at = (u(1, long - 1), 0.4 if side else wide - 0.4, 0.0, np.pi / 2 if side else -np.pi / 2)
        stage.pick([f.plant, f.cabinet, f.shelf, f.coat_rack, f.chair])(stage, at)


def _railings(stage: Stage, long: float, wide: float) -> None:
    u = stage.random.uniform
    for _ in range(int(u(0, 4))):
        x, y, length = u(2, long - 4), u(5, wide - 2), u(2, 6)
        along = (
            np.array([length, 0, 0]) if u() < 0.5 else np.array([0, min(length, wide - 1 - y), 0])
        )
        start = np.array([x, y, 0.0])
        f.railing(stage, start, start + along)


def _upper_floor(stage: Stage, long: float, wide: float, high: float) -> None:
    """Put a gallery along one wall where the hall is high."""
    u = stage.random.uniform
    if high < 5.5 or u() < 0.4:
        return
    deep, floor = u(2, 4), u(2.9, 3.4)
    stage.block([0, wide - deep, floor - 0.25], [long, wide, floor], Surface.FLOOR)
    f.railing(stage, np.array([0, wide - deep, floor]), np.array([long, wide - deep, floor]))
