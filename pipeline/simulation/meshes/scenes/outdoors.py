"""Scenes without a roof: a street, a park."""

from itertools import pairwise

import numpy as np

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.building import wall
from pipeline.simulation.meshes.mesh import Mesh, leaves, sheet, tubes
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import At, Floor, Height, Lane, Matter, Stage
from pipeline.simulation.meshes.vehicles import VEHICLES
from pipeline.simulation.scene import Surface
from pipeline.simulation.tables import Floats, Random

_KERB = 0.12
_STOREY = 3.1


def street(stage: Stage, told: MeshParameters) -> None:
    """Build a street along x, its carriageway about y = 0."""
    random, u = stage.random, stage.random.uniform
    long = u(70, 180)
    half = u(3.0, 6.0)
    pavements = [u(2.0, 5.0), u(2.0, 5.0)]
    slope = u(-0.04, 0.04) if random.random() < 0.6 else 0.0
    green = u(0.3, 1.0) if random.random() < 0.5 else 0.2  # gardens instead of houses
    along = np.linspace(-60, long + 60, 60)
    north, south = (half + wide + 25 for wide in pavements)
    across = [-south, -half - 0.01, -half, half, half + 0.01, north]
    rise = slope * along[:, None] + [_KERB, _KERB, 0, 0, _KERB, _KERB]
    ground = np.stack([*np.broadcast_arrays(along[:, None], across, rise)], axis=-1)
    stage.mesh(sheet(ground), Surface.FLOOR, albedo=u(0.1, 0.4))
    for side, wide in zip((1.0, -1.0), pavements, strict=True):
        inner, outer = half, half + wide
        _facades(stage, long, side, outer, slope, green)
        _parked(stage, long, side, inner, slope)
        _pavement_things(stage, told.clutter, long, side, inner, outer, slope)
        bounds = (0.0, min(side * inner, side * outer), long, max(side * inner, side * outer))
        stage.floors.append(Floor(bounds, lambda x, y: _KERB + slope * x))
    stage.floors.append(Floor((0.0, -half + 0.1, long, half - 0.1), lambda x, y: slope * x))
    for x in (0.1 * long, 0.5 * long, 0.9 * long):  # where one may cross
        stage.links.append(np.array([[x, y, slope * x] for y in np.linspace(-half, half, 7)]))
    lane = half * 0.32
    for y, turn in ((lane, -1), (-lane, 1)):
        xs = np.linspace(-40, long + 40, 40)[::turn]
        line = np.column_stack([xs, np.full(40, y), slope * xs])
        stage.lanes.append(Lane(line, ("car", "car", "van", "bicycle", "bus"), (4, 12)))
    if told.sensor_height > 1.3:
        xs = np.linspace(2, long - 2, 40)
        stage.robot_lane = Lane(np.column_stack([xs, np.full(40, -lane), slope * xs]), (), (3, 9))
        stage.lanes = stage.lanes[:1]


def _facades(
    stage: Stage, long: float, side: float, edge: float, slope: float, green: float
) -> None:
    """Put houses side by side, with recesses, windows, balconies and gaps with fences."""
    random, u = stage.random, stage.random.uniform
    x = -20.0
    while x < long + 20:
        wide = u(6, 20)
        base = slope * (x + wide / 2) + _KERB
        if random.random() < green:
            _garden(stage, x, x + wide, side, edge, base)
        else:
            back = u(0, 3.0) if random.random() < 0.4 else 0.0
            _house(stage, (x, x + wide), side, edge + back, base)
        x += wide


def _house(stage: Stage, along: tuple[float, float], side: float, edge: float, base: float) -> None:
    """Build a front with windows, and what is seen through them: a back wall and floors."""
    u = stage.random.uniform
    x0, x1 = along
    floors = int(u(1, 6))
    high = floors * _STOREY
    sill, pitch = u(0.8, 1.1), u(1.8, 3.2)
    holes: list[tuple[float, float, float, float]] = []
    for start in np.arange(0.6, x1 - x0 - 1.6, pitch):
        width = min(u(0.8, 1.4), pitch - 0.3)
        holes.append((float(start), width, 0.1 if u() < 0.2 else sill, 2.4))
    for floor in range(floors):
        z = base + floor * _STOREY
        front = side * (edge + 0.17)
        wall(stage, (x0, front), (x1, front), z, _STOREY, tuple(holes), 0.35)
        for start, width, low, top in holes:
            pane = [x0 + start + width / 2, side * (edge + 0.3), z + (low + top) / 2]
            stage.boxes([*pane, width, 0.02, top - low], Surface.WALL, matter=Matter.GLASS)
            if floor and u() < 0.06:
                left, right, y = x0 + start - 0.4, x0 + start + width + 0.4, side * (edge - 1)
                slab = [(left + right) / 2, side * (edge - 0.5), z, right - left, 1.0, 0.15]
                stage.boxes(slab, Surface.WALL)
                f.railing(stage, [left, y, z], [right, y, z])
    middle = (x0 + x1) / 2
    inner = [[middle, side * (edge + 4), base + high / 2, x1 - x0, 0.2, high]]
    inner += [[x, side * (edge + 2), base + high / 2, 0.2, 4, high] for x in (x0, x1)]
    ceilings = base + np.arange(1, floors + 1) * _STOREY
    inner += [[middle, side * (edge + 2), z, x1 - x0, 4, 0.2] for z in ceilings]
    stage.boxes(inner, Surface.WALL)


def _garden(stage: Stage, x0: float, x1: float, side: float, edge: float, base: float) -> None:
    """Leave a gap with a fence, a hedge or nothing; trees, bushes and grass are behind it."""
    random, u = stage.random, stage.random.uniform
    start, end = np.array([x0, side * edge, base]), np.array([x1, side * edge, base])
    border = random.random()
    if border < 0.4:
        f.hedge(stage, start, end, u(0.8, 1.9))
    elif border < 0.75:
        f.railing(stage, start, end, u(0.9, 1.8))
    wild = u(0, 1)
    for _ in range(int(u(1, 5) + 8 * wild)):
        at = (u(x0 + 1, x1 - 1), side * (edge + u(0.5, 9)), base, u(0, 3))
        if random.random() < 0.35:
            f.tree(stage, at)
        else:
            f.bush(stage, at, u(0.7, 2.2))
    tufts = np.column_stack([u(x0, x1, 60), side * (edge + u(0, 9, 60)), np.full(60, base)])
    for foot in tufts[: int(60 * wild)]:
        blades = leaves(random, 25, [0.4, 0.4, 0.15], u(0.05, 0.15), 0.0)
        stage.mesh(blades.placed(*foot), Surface.VEGETATION)
    if random.random() < 0.7:
        low, high = [x0, side * (edge + 12), base], [x1, side * (edge + 12) + 0.3, base + u(2, 6)]
        stage.block(low, high, Surface.WALL)


def _parked(stage: Stage, long: float, side: float, kerb: float, slope: float) -> None:
    """Park cars along the kerb, with gaps."""
    random, u = stage.random, stage.random.uniform
    if kerb < 3.8:
        return
    share = u(0.1, 0.9)
    x = 2.0
    while x < long - 3:
        if random.random() < share:
            kind = str(random.choice(["car", "car", "car", "van"]))
            yaw = (0 if side < 0 else np.pi) + u(-0.03, 0.03)
            at = (x + 2.5, side * (kerb - 1.1), slope * x, yaw)
            stage.mesh(VEHICLES[kind](random), Surface.VEHICLE, at, u(0.05, 0.7))
        x += u(5.4, 7.2)


def _pavement_things(
    stage: Stage, clutter: float, long: float, side: float, inner: float, outer: float, slope: float
) -> None:
    random, u = stage.random, stage.random.uniform
    trees = random.random() < 0.5
    for x in np.arange(u(2, 10), long, u(7, 18)):
        base = _KERB + slope * x
        at = (x, side * (inner + 0.5), base, 0.0)
        if trees and outer - inner > 2.4:
            f.tree(stage, at, u(5, 11))
        else:
            lamp = [[[0, 0, 0], [0, 0, 6.5]], [[0, 0, 6.5], [0, -side * 1.2, 6.7]]]
            stage.mesh(tubes(lamp, 0.06, 7), at=at)
    for _ in range(random.poisson(long / 9 * clutter)):
        x = u(1, long - 1)
        kerb_side = random.random() < 0.5
        y = side * (inner + 0.35 if kerb_side else outer - 0.4)
        at = (x, y, _KERB + slope * x, np.pi / 2 * -side)
        kind = int(random.integers(8))
        if kind == 0:
            f.bench(stage, at)
        elif kind == 1:
            f.bin_(stage, at)
        elif kind == 2:
            f.bicycle_stand(stage, (at[0], at[1], at[2], 0.0), int(u(2, 6)))
            stage.mesh(VEHICLES["bicycle"](random), Surface.VEHICLE, (x, y, at[2], u(0, 3)))
        elif kind == 3:
            feet = x + 1.4 * np.arange(int(u(2, 8)))
            stage.mesh(tubes([[[x, y, at[2]], [x, y, at[2] + 0.9]] for x in feet], 0.05, 7))
        elif kind == 4:
            stage.mesh(tubes([[[0, 0, 0], [0, 0, 2.6]]], 0.03, 5), at=at)
            stage.boxes([0, 0, 2.4, 0.02, 0.6, 0.6], at=at)
        elif kind == 5:
            f.bush(stage, at)
        elif kind == 6:
            f.plant(stage, at)
        else:
            f.table(stage, (x, side * (outer - 0.8), at[2], 0.0), 2)


def park(stage: Stage, told: MeshParameters) -> None:
    """Build a park: rolling ground, paths, trees, bushes, benches, fences, a building or two."""
    random, u = stage.random, stage.random.uniform
    side = u(40, 100)
    height = _terrain(random, side)
    line = np.linspace(-10, side + 10, 80)
    x, y = np.meshgrid(line, line, indexing="ij")
    stage.mesh(sheet(np.stack([x, y, height(x, y)], axis=-1)), Surface.FLOOR, albedo=u(0.2, 0.6))
    stage.floors.append(Floor((0.0, 0.0, side, side), height))

    def at(x: float, y: float) -> At:
        return (x, y, float(height(np.array(x), np.array(y))), u(0, 2 * np.pi))

    for _ in range(random.poisson(side * side / u(60, 300))):
        f.tree(stage, at(u(0, side), u(0, side)), u(3.5, 14), 0.6)
    for _ in range(random.poisson(side / 4 * told.clutter)):
        thing = stage.pick([f.bush, f.bench, f.bin_, f.sign, f.bush, f.table])
        thing(stage, at(u(1, side - 1), u(1, side - 1)))
    parts: list[Mesh] = []  # grass in patches
    for _ in range(int(u(0, 40))):
        middle = u(0, side, 2)
        place = middle + random.normal(scale=u(0.5, 2.0), size=(150, 2))
        z = height(place[:, 0], place[:, 1])
        blades = leaves(random, 150, [0.01, 0.01, 0.01], u(0.05, 0.2), 0.0)
        shift = np.repeat(np.column_stack([place, z + 0.05]), 3, axis=0)
        parts.append(Mesh(blades.vertices + shift, blades.triangles))
    if parts:
        stage.mesh(Mesh.joined(parts), Surface.VEGETATION)
    _edges(stage, height, side)
    x = np.linspace(0, side, 60)
    y = side / 2 + u(0.05, 0.3) * side * np.sin(x * u(0.03, 0.12) + u(0, 6))  # a path
    line = np.column_stack([x, y, height(x, y)])
    stage.lanes.append(Lane(line, ("bicycle", "bicycle", "robot"), (3, 8)))
    for number in range(4, 56, int(random.integers(6, 14))):  # lamps beside the path
        foot = line[number] + [0, 2.2, 0]
        stage.mesh(tubes([[foot, foot + [0, 0, u(3, 5)]]], 0.05, 6))


def _terrain(random: Random, side: float) -> Height:
    """Draw a sum of long waves, with slopes of a few per cent up to a fifth."""
    waves = random.normal(size=(4, 2)) * 2 * np.pi / side
    phases = random.uniform(0, 2 * np.pi, 4)
    steep = random.uniform(0.01, 0.12) / np.linalg.norm(waves, axis=1)

    def height(x: Floats, y: Floats) -> Floats:
        angle = np.multiply.outer(x, waves[:, 0]) + np.multiply.outer(y, waves[:, 1]) + phases
        rise: Floats = np.sin(angle) @ steep * 0.5
        return rise

    return height


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
        stage.boxes([0, 0, 2, u(5, 10), u(4, 8), 7], Surface.WALL, (x, y, z, u(0, 3)))
