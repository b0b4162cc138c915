"""A parking garage: a low ceiling with beams, pillars, parked cars, a ramp, moving cars."""

import numpy as np

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.building import wall
from pipeline.simulation.meshes.mesh import sheet, tubes
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import Floor, Lane, Stage, level
from pipeline.simulation.meshes.vehicles import VEHICLES
from pipeline.simulation.shapes import Surface

_BAY, _DEEP, _AISLE = 2.5, 5.2, 6.0


def garage(stage: Stage, told: MeshParameters) -> None:
    """Build aisles along x with bays on both sides of each."""
    random, u = stage.random, stage.random.uniform
    bays, aisles = int(u(8, 20)), int(u(1, 4))
    long, high = bays * _BAY + 2 * _AISLE, u(2.2, 2.9)
    pitch = 2 * _DEEP + _AISLE
    wide = aisles * pitch
    bounds = (0.0, 0.0, long, wide)
    stage.block([-1, -1, -0.2], [long + 1, wide + 1, 0], Surface.FLOOR, albedo=u(0.15, 0.5))
    stage.block([0, 0, high], [long, wide, high + 0.3], Surface.CEILING)
    stage.floors.append(Floor(bounds, level(0.0)))
    corners = [(0.0, 0.0), (long, 0.0), (long, wide), (0.0, wide)]
    for here, there in zip(corners, corners[1:] + corners[:1], strict=True):
        length = float(np.hypot(there[0] - here[0], there[1] - here[1]))
        gap = ((0.5, length - 1, 1.1, high - 0.3),) if random.random() < 0.3 else ()
        wall(stage, here, there, 0, high, gap, 0.3)
    full = u(0.15, 0.95)
    for number in range(aisles):
        low = number * pitch
        for y, yaw in ((low + _DEEP / 2, np.pi / 2), (low + pitch - _DEEP / 2, -np.pi / 2)):
            _bays(stage, bays, y, yaw, full)
    _structure(stage, (long, wide, high), bays, aisles, pitch)
    _lanes(stage, long, aisles, pitch)
    for _ in range(random.poisson(5 * told.clutter)):
        x, side = u(1, long - 1), random.random() < 0.5
        at = (x, 0.5 if side else wide - 0.5, 0.0, np.pi / 2 if side else -np.pi / 2)
        stage.pick([f.bin_, f.sign, f.cabinet])(stage, at)


def _bays(stage: Stage, bays: int, y: float, yaw: float, full: float) -> None:
    random, u = stage.random, stage.random.uniform
    for bay in range(bays):
        if random.random() < full:
            x = _AISLE + (bay + 0.5) * _BAY + u(-0.15, 0.15)
            kind = str(random.choice(["car", "car", "car", "van"]))
            turn = yaw + np.pi * (random.random() < 0.4) + u(-0.03, 0.03)
            mesh = VEHICLES[kind](random)
            if mesh.vertices[:, 2].max() < 2.15:
                f.place(stage, mesh, (x, y + u(-0.2, 0.2), 0, turn), Surface.VEHICLE, u(0.05, 0.7))


def _structure(
    stage: Stage, size: tuple[float, float, float], bays: int, aisles: int, pitch: float
) -> None:
    """Build pillars between every third bay, beams, pipes, lamps, and a ramp at one end."""
    random, u = stage.random, stage.random.uniform
    long, wide, high = size
    deep = u(0.2, 0.45)
    for x in np.arange(_AISLE, _AISLE + bays * _BAY + 0.1, 3 * _BAY):
        stage.block([x - 0.15, 0, high - deep], [x + 0.15, wide, high], Surface.CEILING)
        for number in range(aisles):
            for y in (number * pitch + _DEEP - 0.2, (number + 1) * pitch - _DEEP + 0.2):
                stage.block([x - 0.2, y - 0.2, 0], [x + 0.2, y + 0.2, high], Surface.WALL)
    pipes = [
        [[1, y, high - 0.12], [long - 1, y, high - 0.12]] for y in u(0.5, wide - 0.5, int(u(1, 7)))
    ]
    stage.mesh(tubes(pipes, u(0.03, 0.1), 7), Surface.CEILING)
    if random.random() < 0.6:
        y = (aisles - 1) * pitch + _DEEP
        x = np.linspace(long - 5.9, long - 0.3, 12)
        ramp = np.empty((12, 2, 3))
        ramp[..., 0], ramp[..., 1] = x[:, None], [y + 1, y + 5]
        ramp[..., 2] = ((x - x[0]) * 0.15)[:, None]
        stage.mesh(sheet(ramp), Surface.FLOOR)
        stage.block([x[0], y + 5, 0], [x[-1], y + 5.15, 1.1], Surface.WALL)


def _lanes(stage: Stage, long: float, aisles: int, pitch: float) -> None:
    """Let cars drive round through the aisles."""
    for number in range(aisles):
        y = number * pitch + _DEEP + _AISLE / 2
        xs = np.linspace(1.5, long - 1.5, 20)
        forth = np.column_stack([xs, np.full(20, y - 1.2), 0 * xs])
        back = np.column_stack([xs[::-1], np.full(20, y + 1.2), 0 * xs])
        stage.lanes.append(
            Lane(np.concatenate([forth, back, forth[:1]]), ("car", "car", "van"), (1.5, 5))
        )
