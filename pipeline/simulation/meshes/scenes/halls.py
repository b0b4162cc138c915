"""Scenes of halls: a lobby, stairs between two storeys, a garage, a warehouse."""

import numpy as np

from pipeline.simulation.meshes import furniture as f
from pipeline.simulation.meshes.building import (
    ceiling,
    level_ground,
    outer_wall,
    pillar,
    sides,
    wall,
)
from pipeline.simulation.meshes.mesh import sheet, tubes
from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.stage import At, Floor, Lane, Matter, Stage, Thing, level
from pipeline.simulation.meshes.vehicles import VEHICLES
from pipeline.simulation.scene import Surface

_BAY, _DEEP, _AISLE = 2.5, 5.2, 6.0


def lobby(stage: Stage, told: MeshParameters) -> None:
    """Build a hall: pillars, counters, benches, railings, plants, glass, and room for a crowd."""
    random, u = stage.random, stage.random.uniform
    long, wide, high = u(18, 42), u(13, 30), u(3.0, 8.0)
    bounds = (0.0, 0.0, long, wide)
    level_ground(stage, bounds, u(0.15, 0.7), beyond=8.0)
    ceiling(stage, bounds, high)
    for here, there in sides(long, wide):
        length = float(np.hypot(there[0] - here[0], there[1] - here[1]))
        if random.random() < 0.4 * told.glass + 0.1:
            wall(stage, here, there, 0, high, ((length / 2, 1.8, 0, 2.2),), 0.1, Matter.GLASS)
        else:
            outer_wall(stage, here, there, 0, high)
    if u() < 0.75:
        pitch = u(4.5, 9)
        for x in np.arange(pitch / 2, long, pitch):
            for y in np.arange(pitch / 2, wide, pitch):
                if u() < 0.9:
                    pillar(stage, x, y, high)
    _counters(stage, long)
    _islands(stage, told, long, wide)
    for _ in range(int(u(0, 4))):
        x, y, length = u(2, long - 4), u(5, wide - 2), u(2, 6)
        end = (x + length, y) if u() < 0.5 else (x, y + min(length, wide - 1 - y))
        f.railing(stage, [x, y, 0], [*end, 0])
    if high >= 5.5 and u() >= 0.4:  # a gallery along one wall
        deep, floor = u(2, 4), u(2.9, 3.4)
        stage.block([0, wide - deep, floor - 0.25], [long, wide, floor], Surface.FLOOR)
        f.railing(stage, [0, wide - deep, floor], [long, wide - deep, floor])


def _counters(stage: Stage, long: float) -> None:
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
                posts, lines = 2.6 + np.arange(4) * 1.6, []
                for tape in (x - 0.6, x + 0.6):
                    lines += [[[tape, post, 0], [tape, post, 0.95]] for post in posts]
                    ends = posts[[0, -1]]
                    lines += [[[tape, y, high] for y in ends] for high in (0.9, 0.86)]
                radii = np.tile([0.03] * 4 + [0.015] * 2, 2)
                stage.mesh(tubes(lines, radii[:, None], 5))


def _islands(stage: Stage, told: MeshParameters, long: float, wide: float) -> None:
    """Scatter tables, benches, sofas, plants, boards and shelves."""
    random, u = stage.random, stage.random.uniform

    def plants(stage: Stage, at: At) -> None:
        for _ in range(int(u(1, 5))):
            f.plant(stage, (at[0] + u(-0.6, 0.6), at[1] + u(-0.6, 0.6), 0, 0), u(0.6, 2.6))

    things: list[Thing] = [
        lambda stage, at: f.table(stage, at, int(u(2, 9))), f.sofa, f.bench, f.bench, plants,
        f.sign, lambda stage, at: f.shelf(stage, at, u(1, 2.5)), f.bin_,
    ]  # fmt: skip
    for _ in range(random.poisson(long * wide / 45 * told.clutter)):
        at = (u(1.5, long - 1.5), u(4, wide - 1.5), 0.0, u(0, 2 * np.pi))
        stage.pick(things)(stage, at)
    for _ in range(random.poisson(6 * told.clutter)):
        side = random.random() < 0.5
        at = (u(1, long - 1), 0.4 if side else wide - 0.4, 0.0, np.pi / 2 if side else -np.pi / 2)
        stage.pick([f.plant, f.cabinet, f.shelf, f.coat_rack, f.chair])(stage, at)


def stairs(stage: Stage, told: MeshParameters) -> None:
    """Build two storeys and stairs, whose well lies along x at y from `y0` to `y0 + broad`."""
    random, u = stage.random, stage.random.uniform
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
    for here, there in sides(long, wide):
        outer_wall(stage, here, there, 0.0, storey)
        outer_wall(stage, here, there, storey, storey)
    _flight(stage, (x0, y0, broad), steps, run, storey)
    things: list[Thing] = [
        lambda stage, at: f.table(stage, at, int(u(2, 7))),
        *(f.plant, f.bench, f.sofa, f.shelf, f.sign),
    ]
    for base in (0.0, storey):
        stage.floors.append(Floor(bounds, level(base)))
        for _ in range(random.poisson(long * wide / 25 * told.clutter)):
            x, y = u(0.8, long - 0.8), u(0.8, wide - 0.8)
            if not (x0 - 1.5 < x < x1 + 1.5 and y0 - 0.8 < y < y0 + broad + 0.8):
                at = (x, y, base, u(0, 2 * np.pi))
                stage.pick(things)(stage, at)
    for x in (long * 0.3, long * 0.7):
        pillar(stage, x, u(0.5, 1.0), 2 * storey)
    share = np.linspace(0, 1, 12)[1:-1]
    along = [x0 - 0.8, x0 - 0.1, *(x0 + share * (x1 - x0)), x1 + 0.2, x1 + 0.8]
    up = [0.0, 0.0, *(share * storey), storey, storey]
    stage.links.append(np.column_stack([along, np.full(len(along), y0 + broad / 2), up]))


def _flight(
    stage: Stage, well: tuple[float, float, float], steps: int, run: float, storey: float
) -> None:
    """Build the steps, handrails beside them, and railings about the well above."""
    u = stage.random.uniform
    x0, y0, broad = well
    rise, middle = storey / steps, y0 + broad / 2
    solid = u() < 0.5
    rows = []
    for step in range(steps):
        x, top = x0 + (step + 0.5) * run, (step + 1) * rise
        deep = top if solid else rise * 1.3
        rows.append([x, middle, top - deep / 2, run + 0.02, broad, deep])
    stage.boxes(rows, Surface.FLOOR)
    x1 = x0 + steps * run
    for y in (y0 + 0.06, y0 + broad - 0.06):
        f.railing(stage, [x0, y, 0], [x1, y, storey], 0.95)
        edge = y - 0.1 if y < middle else y + 0.1
        f.railing(stage, [x0, edge, storey], [x1, edge, storey], 1.05)
    f.railing(stage, [x0 - 0.05, y0, storey], [x0 - 0.05, y0 + broad, storey], 1.05)


def garage(stage: Stage, told: MeshParameters) -> None:
    """Build a garage: aisles along x with bays on both sides of each."""
    random, u = stage.random, stage.random.uniform
    bays, aisles = int(u(8, 20)), int(u(1, 4))
    long, high = bays * _BAY + 2 * _AISLE, u(2.2, 2.9)
    pitch = 2 * _DEEP + _AISLE
    wide = aisles * pitch
    level_ground(stage, (0.0, 0.0, long, wide), u(0.15, 0.5))
    stage.block([0, 0, high], [long, wide, high + 0.3], Surface.CEILING)
    for here, there in sides(long, wide):
        length = float(np.hypot(there[0] - here[0], there[1] - here[1]))
        gap = ((0.5, length - 1, 1.1, high - 0.3),) if random.random() < 0.3 else ()
        wall(stage, here, there, 0, high, gap, 0.3)
    full = u(0.15, 0.95)
    xs = np.linspace(1.5, long - 1.5, 20)
    for number in range(aisles):
        low = number * pitch
        for y, yaw in ((low + _DEEP / 2, np.pi / 2), (low + pitch - _DEEP / 2, -np.pi / 2)):
            _bays(stage, bays, y, yaw, full)
        round_trip = np.concatenate([xs, xs[::-1], xs[:1]])
        aside = np.repeat([-1.2, 1.2, -1.2], [20, 20, 1])
        line = np.column_stack([round_trip, low + _DEEP + _AISLE / 2 + aside, 0 * round_trip])
        stage.lanes.append(Lane(line, ("car", "car", "van"), (1.5, 5)))
    deep = u(0.2, 0.45)  # of beams, between every third bay
    for x in np.arange(_AISLE, _AISLE + bays * _BAY + 0.1, 3 * _BAY):
        stage.block([x - 0.15, 0, high - deep], [x + 0.15, wide, high], Surface.CEILING)
        for number in range(aisles):
            for y in (number * pitch + _DEEP - 0.2, (number + 1) * pitch - _DEEP + 0.2):
                stage.block([x - 0.2, y - 0.2, 0], [x + 0.2, y + 0.2, high], Surface.WALL)
    top = high - 0.12
    pipes = [[[1, y, top], [long - 1, y, top]] for y in u(0.5, wide - 0.5, int(u(1, 7)))]
    stage.mesh(tubes(pipes, u(0.03, 0.1), 7), Surface.CEILING)
    if random.random() < 0.6:  # a ramp at one end
        y = (aisles - 1) * pitch + _DEEP
        x = np.linspace(long - 5.9, long - 0.3, 12)
        up = (x - x[0]) * 0.15
        ramp = np.stack([np.column_stack([x, 0 * x + y + edge, up]) for edge in (1, 5)], axis=1)
        stage.mesh(sheet(ramp), Surface.FLOOR)
        stage.block([x[0], y + 5, 0], [x[-1], y + 5.15, 1.1], Surface.WALL)
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
                stage.mesh(mesh, Surface.VEHICLE, (x, y + u(-0.2, 0.2), 0, turn), u(0.05, 0.7))


def warehouse(stage: Stage, told: MeshParameters) -> None:
    """Build a warehouse: aisles between high racks, pallets on the floor, forklifts."""
    random, u = stage.random, stage.random.uniform
    bays, racks, levels = int(u(4, 11)), int(u(2, 7)), int(u(2, 6))
    aisle, apron = u(2.6, 4.5), u(3.5, 9)
    rack_long = bays * 2.7
    wide = racks * (aisle + 2.3) + aisle
    long = rack_long + 2 * apron
    high = levels * 1.9 + u(1.0, 3.0)
    bounds = (0.0, 0.0, wide, long)
    level_ground(stage, bounds, u(0.15, 0.5))
    ceiling(stage, bounds, high)
    for here, there in sides(wide, long):
        outer_wall(stage, here, there, 0, high)
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
    for _ in range(random.poisson(0.35 * wide * told.clutter)):
        near = random.random() < 0.5
        y = u(0.8, apron - 1.6) if near else long - u(0.8, apron - 1.6)
        f.pallet(stage, (u(1, wide - 1), y, 0, random.choice([0, np.pi / 2]) + u(-0.1, 0.1)))
    for _ in range(int(u(1, 4))):  # work places at a wall
        at = (u(2, wide - 2), 0.8, 0.0, -np.pi / 2)
        f.desk(stage, at, told.clutter)
        f.office_chair(stage, (at[0], 1.5, 0.0, -np.pi / 2))
    for _ in range(random.poisson(3 * told.clutter)):
        thing = stage.pick([f.bin_, f.cabinet, f.sign, f.shelf, f.plant])
        thing(stage, (u(1, wide - 1), long - 0.5, 0.0, -np.pi / 2))
    if random.random() < 0.5:
        y = apron - 0.6
        f.railing(stage, [u(1, wide / 2), y, 0], [wide / 2 + 2, y, 0], 1.1)
    low, top = apron * 0.7, long - apron * 0.7
    for _ in range(3):  # forklifts go up one aisle and down another
        x0, x1 = np.array(aisles)[random.choice(len(aisles), 2, replace=False)]
        line = np.array([[x0, low, 0], [x0, top, 0], [x1, top, 0], [x1, low, 0], [x0, low, 0]])
        stage.lanes.append(Lane(line, ("forklift", "forklift", "robot"), (0.8, 2.5), closed=True))
