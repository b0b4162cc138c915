"""Walls with openings, windows, ceilings and what hangs from them."""

import numpy as np

from pipeline.simulation.meshes import furniture
from pipeline.simulation.meshes.mesh import tubes
from pipeline.simulation.meshes.stage import Floor, Matter, Stage, level
from pipeline.simulation.scene import Surface

Place = tuple[float, float]
Bounds = tuple[float, float, float, float]
Hole = tuple[float, float, float, float]  # along the wall, width, bottom and top


def level_ground(stage: Stage, bounds: Bounds, albedo: float, beyond: float = 1.0) -> None:
    """Lay a floor to walk on, and the slab under it, which reaches farther."""
    x0, y0, x1, y1 = bounds
    low, high = [x0 - beyond, y0 - beyond, -0.2], [x1 + beyond, y1 + beyond, 0]
    stage.block(low, high, Surface.FLOOR, albedo)
    stage.floors.append(Floor(bounds, level(0.0)))


def sides(long: float, wide: float) -> list[tuple[Place, Place]]:
    """Return the ends of the four sides of a rectangle, one after the other."""
    corners = [(0.0, 0.0), (long, 0.0), (long, wide), (0.0, wide)]
    return list(zip(corners, corners[1:] + corners[:1], strict=True))


def wall(
    stage: Stage,
    start: Place,
    end: Place,
    base: float,
    high: float,
    openings: tuple[Hole, ...] = (),
    thick: float = 0.12,
    matter: Matter = Matter.SOLID,
) -> None:
    """Build a wall from place to place along x or y, its foot at `base`; one of glass has a frame.

    Each opening says where it begins along the wall, its width, and its heights above the foot.
    """
    first, last = np.array(start, dtype=np.float64), np.array(end, dtype=np.float64)
    length = float(np.linalg.norm(last - first))
    ahead = (last - first) / length
    yaw = float(np.arctan2(ahead[1], ahead[0]))
    rows, at = [], 0.0

    def panel(begin: float, stop: float, low: float, top: float) -> None:
        if stop - begin > 0.01 and top - low > 0.01:
            rows.append([(begin + stop) / 2, 0, (low + top) / 2, stop - begin, thick, top - low])

    for along, width, bottom, top in sorted(openings):
        panel(at, along, 0, high)
        panel(along, along + width, 0, bottom)
        panel(along, along + width, min(top, high), high)
        at = along + width
    panel(at, length, 0, high)
    spot = (float(first[0]), float(first[1]), base, yaw)
    if matter is Matter.GLASS:
        panes = [[x, y, z, long, 0.01, tall] for x, y, z, long, _, tall in rows]
        stage.boxes(panes, Surface.WALL, spot, matter=Matter.GLASS)
        frame = [[along, 0, high / 2, 0.05, 0.06, high] for along in np.arange(0, length + 0.1, 1.6)
                 if not any(o[0] < along < o[0] + o[1] for o in openings)]  # fmt: skip
        stage.boxes([*frame, [length / 2, 0, high - 0.04, length, 0.06, 0.08]], Surface.WALL, spot)
    elif rows:
        stage.boxes(rows, Surface.WALL, spot)


def windows(stage: Stage, length: float, high: float) -> tuple[Hole, ...]:
    """Draw a row of windows along a wall."""
    u = stage.random.uniform
    wide, gap, sill = u(0.9, 2.4), u(0.5, 1.6), u(0.0, 1.0)
    count = int((length - 0.6) / (wide + gap))
    return tuple((0.5 + n * (wide + gap), wide, sill, min(sill + u(1.2, 2.0), high - 0.15))
                 for n in range(count))  # fmt: skip


def outer_wall(stage: Stage, start: Place, end: Place, base: float, high: float) -> None:
    """Build a wall with windows, their panes and perhaps curtains."""
    random = stage.random
    length = float(np.hypot(end[0] - start[0], end[1] - start[1]))
    holes = windows(stage, length, high) if random.random() < 0.8 else ()
    wall(stage, start, end, base, high, holes, thick=0.3)
    if not holes:
        return
    yaw = float(np.arctan2(end[1] - start[1], end[0] - start[0]))
    panes = [[along + wide / 2, 0, (low + top) / 2, wide, 0.012, top - low]
             for along, wide, low, top in holes]  # fmt: skip
    stage.boxes(panes, Surface.WALL, (*start, base, yaw), matter=Matter.GLASS)
    curtains = random.random() < 0.4
    for along, wide, _, top in holes:
        if curtains and random.random() < 0.5:
            share = random.uniform(0.25, 1.0)
            inside = np.array([np.cos(yaw), np.sin(yaw)]) * (along + wide * share / 2)
            inside += 0.26 * np.array([-np.sin(yaw), np.cos(yaw)])
            at = (start[0] + inside[0], start[1] + inside[1], base, yaw - np.pi / 2)
            furniture.curtain(stage, at, wide * share, top + 0.1)


def ceiling(stage: Stage, bounds: Bounds, high: float, base: float = 0.0) -> None:
    """Build a ceiling, perhaps with beams, ducts, pipes and lamps below it."""
    random, u = stage.random, stage.random.uniform
    x0, y0, x1, y1 = bounds
    top = base + high
    stage.block([x0, y0, top], [x1, y1, top + 0.2], Surface.CEILING)
    if random.random() < 0.4:
        for x in np.arange(x0 + u(1, 3), x1, u(3, 6)):
            stage.block([x, y0, top - u(0.1, 0.3)], [x + 0.2, y1, top], Surface.CEILING)
    if random.random() < 0.5:
        y = u(y0 + 1, y1 - 1)
        stage.block([x0 + 1, y, top - 0.55], [x1 - 1, y + u(0.3, 0.6), top - 0.15], Surface.CEILING)
        pipes = [[[x0 + 1, y + d, top - 0.2], [x1 - 1, y + d, top - 0.2]] for d in (-0.4, -0.6)]
        stage.mesh(tubes(pipes, u(0.02, 0.06), 6), Surface.CEILING)
    count = int((x1 - x0) * (y1 - y0) / u(6, 30))
    hang = random.random() < 0.5 and high > 2.5
    for _ in range(min(count, 60)):
        x, y = u(x0 + 0.7, x1 - 0.7), u(y0 + 0.7, y1 - 0.7)
        if hang:
            furniture.hanging_lamp(stage, (x, y, base, 0), high)
        else:
            stage.boxes([0, 0, top - 0.06, 1.2, 0.2, 0.08], Surface.CEILING, (x, y, 0, 0))


def pillar(stage: Stage, x: float, y: float, high: float) -> None:
    """Build a round or square pillar."""
    u = stage.random.uniform
    wide = u(0.2, 0.5)
    if u() < 0.5:
        stage.mesh(tubes([[[x, y, 0], [x, y, high]]], wide * 0.6, 14), Surface.WALL)
    else:
        stage.boxes([0, 0, high / 2, wide, wide, high], Surface.WALL, (x, y, 0.0, 0.0))
