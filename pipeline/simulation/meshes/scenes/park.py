"""A park or a campus: rolling ground, paths, trees, bushes, benches, fences, a building or two."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.mesh import Mesh, boxes, leaves, sheet, tubes
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import Floor, Lane, Stage
from pipeline.simulation.shapes import Surface

Height = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]


def park(stage: Stage, told: MeshParameters) -> None:
    """Build it."""
    random, u = stage.random, stage.random.uniform
    side = u(40, 100)
    height = _terrain(random, side)
    x = np.linspace(-10, side + 10, 80)
    grid = np.empty((80, 80, 3))
    grid[..., 0], grid[..., 1] = x[:, None], x
    grid[..., 2] = height(grid[..., 0], grid[..., 1])
    stage.mesh(sheet(grid), Surface.FLOOR, albedo=u(0.2, 0.6))
    stage.floors.append(Floor((0.0, 0.0, side, side), height))

    def at(x: float, y: float) -> f.At:
        return (x, y, float(height(np.array(x), np.array(y))), u(0, 2 * np.pi))

    for _ in range(random.poisson(side * side / u(60, 300))):
        f.tree(stage, at(u(0, side), u(0, side)), u(3.5, 14), 0.6)
    for _ in range(random.poisson(side / 4 * told.clutter)):
        thing = stage.pick([f.bush, f.bench, f.bin_, f.sign, f.bush, f.table])
        thing(stage, at(u(1, side - 1), u(1, side - 1)))
    _grass(stage, height, side)
    _edges(stage, height, side)
    _path(stage, height, side)


def _terrain(random: np.random.Generator, side: float) -> Height:
    """Draw a sum of long waves, with slopes of a few per cent up to a fifth."""
    waves = random.normal(size=(4, 2)) * 2 * np.pi / side
    phases = random.uniform(0, 2 * np.pi, 4)
    steep = random.uniform(0.01, 0.12) / np.linalg.norm(waves, axis=1)

    def height(x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        angle = np.multiply.outer(x, waves[:, 0]) + np.multiply.outer(y, waves[:, 1]) + phases
        rise: NDArray[np.float64] = np.sin(angle) @ steep * 0.5
        return rise

    return height


def _grass(stage: Stage, height: Height, side: float) -> None:
    """Let grass grow in patches."""
    random, u = stage.random, stage.random.uniform
    parts: list[Mesh] = []
    for _ in range(int(u(0, 40))):
        middle = u(0, side, 2)
        place = middle + random.normal(scale=u(0.5, 2.0), size=(150, 2))
        z = height(place[:, 0], place[:, 1])
        blades = leaves(random, 150, [0.01, 0.01, 0.01], u(0.05, 0.2), 0.0)
        shift = np.repeat(np.column_stack([place, z + 0.05]), 3, axis=0)
        parts.append(Mesh(blades.vertices + shift, blades.triangles))
    if parts:
        stage.mesh(Mesh.joined(parts), Surface.VEGETATION)


def _edges(stage: Stage, height: Height, side: float) -> None:
    """Put fences, hedges and buildings about the park."""
    random, u = stage.random, stage.random.uniform
    corners = np.array([[0, 0], [side, 0], [side, side], [0, side]], dtype=np.float64)
    for here, there in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        kind = random.random()
        marks = here + np.linspace(0, 1, 13)[:, None] * (there - here)
        places = np.column_stack([marks, height(marks[:, 0], marks[:, 1])])
        if kind < 0.35:
            for first, second in pairwise(places):
                f.railing(stage, first, second, 1.3)
        elif kind < 0.6:
            high = u(1.0, 2.2)
            for first, second in pairwise(places):
                f.hedge(stage, first, second, high)
        elif kind < 0.85:
            middle = places[6]
            yaw = float(np.arctan2(*(there - here)[::-1]))
            stage.boxes([0, 0, 2, u(12, 30), 1.0, u(8, 24)], Surface.WALL, (*middle, yaw))
    for _ in range(int(u(0, 3))):
        x, y = u(10, side - 10, 2)
        z = float(height(np.array(x), np.array(y)))
        stage.mesh(boxes([0, 0, 2, u(5, 10), u(4, 8), 7]).placed(x, y, z, u(0, 3)), Surface.WALL)


def _path(stage: Stage, height: Height, side: float) -> None:
    """Let cyclists cross, and put lamps beside their way."""
    random, u = stage.random, stage.random.uniform
    x = np.linspace(0, side, 60)
    y = side / 2 + u(0.05, 0.3) * side * np.sin(x * u(0.03, 0.12) + u(0, 6))
    line = np.column_stack([x, y, height(x, y)])
    stage.lanes.append(Lane(line, ("bicycle", "bicycle", "robot"), (3, 8)))
    for number in range(4, 56, int(random.integers(6, 14))):
        foot = line[number] + [0, 2.2, 0]
        stage.mesh(tubes([[foot, foot + [0, 0, u(3, 5)]]], 0.05, 6), Surface.FURNITURE)
