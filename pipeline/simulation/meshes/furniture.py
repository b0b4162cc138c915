"""Things that stand in rooms, each placed at x, y, z and turned by a yaw (x ahead, y left)."""

from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from pipeline.simulation.meshes.mesh import Mesh, boxes, corners, leaves, sheet, tubes
from pipeline.simulation.meshes.stage import At, Seat, Stage
from pipeline.simulation.scene import Surface


def desk(stage: Stage, at: At, clutter: float = 1.0) -> None:
    """Place a desk with legs, a screen, a lamp and things on it; one sits at -x."""
    u = stage.random.uniform
    long, deep, high = u(1.2, 1.8), u(0.65, 0.85), u(0.7, 0.78)
    rows = [[0, 0, high, deep, long, 0.03]]
    if u() < 0.5:
        rows += [[0, s * (long / 2 - 0.03), high / 2, deep * 0.9, 0.03, high] for s in (-1, 1)]
    else:
        legs = corners(deep / 2 - 0.04, long / 2 - 0.05)
        rows += [[x, y, high / 2, 0.05, 0.05, high] for x, y in legs]
    if u() < 0.5:
        rows.append([0.05, u(0.3, 0.5) * long * 0.7, 0.3, deep * 0.7, 0.4, 0.58])
    for y in ([0.0], [-0.3, 0.3], [0.1], [])[int(u(0, 4))]:
        wide = u(0.45, 0.65)
        rows += [
            [0.18, y, high + 0.3, 0.04, wide, wide * 0.58],
            [0.2, y, high + 0.1, 0.05, 0.05, 0.2],
            [0.18, y, high + 0.02, 0.2, 0.24, 0.02],
        ]
    for _ in range(stage.random.poisson(4 * clutter)):
        size = u(0.05, 0.3, 3) * [1, 1, 0.8]
        rows.append([u(-0.35, 0.35) * deep, u(-0.45, 0.45) * long, high + size[2] / 2, *size])
    stage.boxes(rows, at=at)


def office_chair(stage: Stage, at: At) -> None:
    """Place a swivel chair on a star of five, a seat among those that can be taken."""
    u = stage.random.uniform
    seat = u(0.43, 0.52)
    angles = u(0, 2 * np.pi) + 2 * np.pi * np.arange(5) / 5
    star = [[[0, 0, 0.09], [0.3 * np.cos(a), 0.3 * np.sin(a), 0.06]] for a in angles]
    back = [-0.22, 0, seat + 0.38, 0.06, 0.42, u(0.4, 0.65)]
    parts = [
        boxes([[0, 0, seat, 0.46, 0.46, 0.07], back]),
        tubes([[[0, 0, 0.1], [0, 0, seat]]], 0.03, 5),
        tubes(star, 0.022, 4),
    ]
    if u() < 0.5:
        parts.append(boxes([[0, s * 0.26, seat + 0.2, 0.28, 0.05, 0.04] for s in (-1, 1)]))
    stage.mesh(Mesh.joined(parts), at=at)
    stage.seats.append(Seat(*at, seat))


def chair(stage: Stage, at: At) -> None:
    """Place a chair with four thin legs."""
    u = stage.random.uniform
    legs = [[[x, y, 0], [x * 0.9, y * 0.9, 0.44]] for x, y in corners(0.2, 0.2)]
    back = boxes([[0, 0, 0.45, 0.42, 0.42, 0.04], [-0.2, 0, u(0.7, 0.78), 0.03, 0.4, u(0.15, 0.4)]])
    posts = tubes([[[-0.2, y, 0.45], [-0.21, y, 0.85]] for y in (-0.18, 0.18)], 0.014, 4)
    stage.mesh(Mesh.joined([back, posts, tubes(legs, 0.015, 4)]), at=at)
    stage.seats.append(Seat(*at))


def table(stage: Stage, at: At, chairs: int = 4) -> None:
    """Place a table with chairs around it."""
    u = stage.random.uniform
    long, deep = max(0.8, 0.35 * chairs), u(0.7, 1.1)
    rows = [[0, 0, 0.74, deep, long, 0.04]]
    legs = corners(deep / 2 - 0.08, long / 2 - 0.08)
    rows += [[x, y, 0.36, 0.06, 0.06, 0.72] for x, y in legs]
    for _ in range(stage.random.poisson(2)):
        top = [u(-0.3, 0.3) * deep, u(-0.4, 0.4) * long, 0.83]
        rows.append([*top, u(0.05, 0.3), u(0.05, 0.3), 0.14])
    stage.boxes(rows, at=at)
    x, y, z, yaw = at
    cosine, sine = np.cos(yaw), np.sin(yaw)
    for number in range(chairs):
        side = 1 if number % 2 else -1
        along = ((number // 2 + 0.5) / max(1, (chairs + 1) // 2) - 0.5) * long
        out = side * (deep / 2 + u(0.1, 0.45))
        facing = yaw + (np.pi if side > 0 else 0) + u(-0.4, 0.4)
        spot = (x + out * cosine - along * sine, y + out * sine + along * cosine, z, facing)
        (chair if u() < 0.7 else office_chair)(stage, spot)


def shelf(stage: Stage, at: At, long: float = 1.0) -> None:
    """Place a shelf with boards, and books and boxes with gaps; its back at -x."""
    u = stage.random.uniform
    high, deep = u(1.2, 2.3), u(0.28, 0.4)
    boards = int(u(3, 6))
    rows = [[0, s * long / 2, high / 2, deep, 0.025, high] for s in (-1, 1)]
    if u() < 0.6:
        rows.append([-deep / 2, 0, high / 2, 0.01, long, high])
    for board in range(boards + 1):
        z = 0.05 + board * (high - 0.07) / boards
        rows.append([0, 0, z, deep, long, 0.025])
        y = -long / 2 + 0.03
        while board < boards and y < long / 2 - 0.1:
            wide = u(0.03, 0.3)
            if u() < 0.65:
                tall = u(0.12, 0.9) * (high / boards - 0.05)
                middle = [u(-0.05, 0.05), y + wide / 2, z + tall / 2]
                rows.append([*middle, deep * u(0.5, 0.9), wide, tall])
            y += wide + (u(0, 0.3) if u() < 0.3 else 0.005)
    stage.boxes(rows, at=at)


def cabinet(stage: Stage, at: At) -> None:
    """Place a closed cabinet, perhaps with things on top."""
    u = stage.random.uniform
    tall = u(0.7, 2.0)
    rows = [[0, 0, tall / 2, u(0.4, 0.6), u(0.5, 1.2), tall]]
    for _ in range(stage.random.poisson(1.2)):
        size = u(0.1, 0.4, 3)
        rows.append([0, u(-0.3, 0.3), tall + size[2] / 2, *size])
    stage.boxes(rows, at=at)


def sofa(stage: Stage, at: At) -> None:
    """Place a sofa for two or three."""
    long = stage.random.uniform(1.4, 2.3)
    rows = [[0, 0, 0.22, 0.85, long, 0.42], [-0.36, 0, 0.5, 0.2, long, 0.6]]
    rows += [[0, s * long / 2, 0.32, 0.85, 0.16, 0.62] for s in (-1, 1)]
    stage.boxes(rows, at=at)
    _seat_two(stage, at, long, 0.42)


def _seat_two(stage: Stage, at: At, long: float, height: float) -> None:
    x, y, z, yaw = at
    for s in (-0.25, 0.25):
        seat = (x - s * long * np.sin(yaw), y + s * long * np.cos(yaw))
        stage.seats.append(Seat(*seat, z, yaw, height))


def plant(stage: Stage, at: At, high: float | None = None) -> None:
    """Place a plant in a pot: a stem and many small leaves."""
    random, u = stage.random, stage.random.uniform
    tall = u(0.6, 2.2) if high is None else high
    pot = u(0.12, 0.25)
    stage.mesh(tubes([[[0, 0, 0.1], [0, 0, 0.3]]], [[pot * 0.8, pot]], 8), at=at)
    crown = tall - 0.35
    wide = u(0.15, 0.5)
    count = int(u(2, 8))
    tips = [[*u(-0.6, 0.6, 2) * wide, 0.35 + u(0.3, 1) * crown] for _ in range(count)]
    stems = tubes([[[0, 0, 0.3], tip] for tip in tips], 0.008, 3)
    count, reach = int(60 + 250 * wide * tall), [wide, wide, crown / 2]
    foliage = leaves(random, count, reach, u(0.03, 0.12), u(0, 0.6))
    foliage = foliage.placed(0, 0, 0.35 + crown / 2)
    stage.mesh(Mesh.joined([stems, foliage]), Surface.VEGETATION, at)


def curtain(stage: Stage, at: At, long: float, high: float) -> None:
    """Place a wavy curtain along y."""
    u = stage.random.uniform
    y = np.linspace(-long / 2, long / 2, max(8, int(long / 0.05)))
    z = np.linspace(u(0.02, 0.15), high, 8)
    fold = u(0.03, 0.07) * np.sin(2 * np.pi * y / u(0.15, 0.3))
    fold += 0.02 * stage.random.normal(size=len(y))
    grid = np.empty((len(y), len(z), 3))
    grid[..., 0] = fold[:, None] * np.linspace(1.2, 0.6, len(z))
    grid[..., 1], grid[..., 2] = y[:, None], z
    stage.mesh(sheet(grid), at=at)


def hanging_lamp(stage: Stage, at: At, ceiling: float) -> None:
    """Place a lamp on a thin cable."""
    drop = stage.random.uniform(0.2, min(1.6, 0.4 * ceiling))
    cable = tubes([[[0, 0, ceiling], [0, 0, ceiling - drop]]], 0.006, 3)
    shade = tubes([[[0, 0, ceiling - drop - 0.1], [0, 0, ceiling - drop]]], [[0.2, 0.06]], 8)
    stage.mesh(Mesh.joined([cable, shade]), at=at)


def railing(stage: Stage, start: ArrayLike, end: ArrayLike, high: float = 1.05) -> None:
    """Place a handrail on posts between two places, with bars, wires or a pane's frame."""
    u = stage.random.uniform
    first, last, up = np.array(start), np.array(end), np.array([0, 0, high])
    length = float(np.linalg.norm(last - first))
    posts = np.linspace(0, 1, max(2, int(length / 1.2) + 1))
    bars = np.linspace(0, 1, max(2, int(length / u(0.1, 0.2))) if u() < 0.6 else 0)
    feet = first + posts[:, None] * (last - first)
    lines = [[foot, foot + up] for foot in feet]
    feet = first + bars[:, None] * (last - first)
    lines += [[foot + 0.1 * up, foot + 0.95 * up] for foot in feet]
    rails = (1.0, 0.1 if len(bars) else 0.5)
    lines += [[first + height * up, last + height * up] for height in rails]
    radii = np.repeat([0.022, 0.008, 0.022], [len(posts), len(bars), len(rails)])
    stage.mesh(tubes(np.array(lines), radii[:, None], 4))


def counter(stage: Stage, at: At, long: float = 3.0) -> None:
    """Place a counter with things and screens on it."""
    u = stage.random.uniform
    rows = [[0, 0, 0.52, 0.6, long, 1.04], [0.15, 0, 1.07, 0.5, long, 0.05]]
    for _ in range(stage.random.poisson(1.5 * long)):
        size = u(0.08, 0.4, 3)
        rows.append([u(-0.2, 0.3), u(-0.45, 0.45) * long, 1.1 + size[2] / 2, *size])
    stage.boxes(rows, at=at)


def bench(stage: Stage, at: At) -> None:
    """Place a bench of boards, perhaps with a back."""
    u = stage.random.uniform
    long = u(1.2, 2.2)
    rows = [[x, 0, 0.44, 0.12, long, 0.035] for x in (-0.16, 0, 0.16)]
    rows += [[0, s * (long / 2 - 0.15), 0.22, 0.4, 0.06, 0.42] for s in (-1, 1)]
    if u() < 0.6:
        rows += [[-0.24, 0, z, 0.03, long, 0.1] for z in (0.62, 0.78)]
    stage.boxes(rows, at=at)
    _seat_two(stage, at, long, 0.45)


def bin_(stage: Stage, at: At) -> None:
    """Place a round bin or barrel."""
    u = stage.random.uniform
    wide, tall = u(0.14, 0.3), u(0.35, 1.0)
    stage.mesh(tubes([[[0, 0, wide * 0.6], [0, 0, tall - wide * 0.6]]], wide, 10), at=at)


def sign(stage: Stage, at: At) -> None:
    """Place a board on thin legs: a flip chart, an easel or a sandwich board."""
    u = stage.random.uniform
    high, wide = u(0.9, 1.8), u(0.4, 0.9)
    board = boxes([0, 0, high - u(0.3, 0.4), 0.02, wide, u(0.5, 0.7)])
    ends = (-wide / 2, wide / 2)
    lines = [[[0, y, 0], [0, y, high]] for y in ends]
    lines += [[[-0.25, y, 0.02], [0.25, y, 0.02]] for y in ends]
    stage.mesh(Mesh.joined([board, tubes(lines, 0.012, 4)]), at=at)


def coat_rack(stage: Stage, at: At) -> None:
    """Place a coat rack with coats on it: much like a person."""
    u = stage.random.uniform
    cross = [[[-0.25, 0, 0.03], [0.25, 0, 0.03]], [[0, -0.25, 0.03], [0, 0.25, 0.03]]]
    parts = [tubes([[[0, 0, 0], [0, 0, 1.8]]], 0.02, 5), tubes(cross, 0.02, 4)]
    for angle in u(0, 2 * np.pi, int(u(0, 4))):
        foot = 0.14 * np.array([np.cos(angle), np.sin(angle), 0])
        ends = np.array([foot + [0, 0, u(0.6, 0.9)], foot * 0.8 + [0, 0, 1.5]])
        parts.append(tubes(ends, [[0.12, 0.09]], 7))
    stage.mesh(Mesh.joined(parts), at=at)


def pallet(stage: Stage, at: At) -> None:
    """Place a pallet with boxes that leave gaps."""
    u = stage.random.uniform
    rows = [[0, y, 0.07, 1.2, 0.12, 0.14] for y in (-0.35, 0, 0.35)]
    rows.append([0, 0, 0.13, 1.2, 0.8, 0.03])
    tall = u(0.0, 1.6)
    z = 0.15
    while z < tall:
        layer = u(0.2, 0.45)
        for x, y in product((-0.4, 0.0, 0.4), (-0.2, 0.2)):
            if u() < 0.9:
                middle = [x + u(-0.02, 0.02), y + u(-0.02, 0.02), z + layer / 2]
                rows.append([*middle, u(0.33, 0.4), u(0.33, 0.4), layer])
        z += layer
    stage.boxes(rows, at=at)


def rack(stage: Stage, at: At, bays: int, levels: int, fill: float) -> None:
    """Place a pallet rack along y with uprights, beams, and pallets with gaps."""
    random, u = stage.random, stage.random.uniform
    wide, deep, floor = 2.7, 1.05, u(1.5, 1.9)
    long, high = bays * wide, levels * floor
    rows = []
    for y in -long / 2 + np.arange(bays + 1) * wide:
        rows += [[x, y, high / 2, 0.09, 0.09, high] for x in (-deep / 2, deep / 2)]
        rows += [[0, y, z, deep, 0.04, 0.04] for z in np.arange(0.4, high, 0.9)]
    for number in range(1, levels + 1):
        z = number * floor - 0.1
        rows += [[x, 0, z, 0.05, long, 0.1] for x in (-deep / 2, deep / 2)]
    for number in range(levels):
        for slot in range(bays * 3):
            if random.random() > fill:
                continue
            y = -long / 2 + (slot + 0.5) * wide / 3
            size = [u(0.8, 1.1), u(0.6, 0.85), u(0.2, floor - 0.35)]
            z = number * floor + (0.0 if number else 0.02)
            rows.append([0, y, z + 0.07, 1.1, 0.8, 0.13])
            rows.append([u(-0.05, 0.05), y, z + 0.14 + size[2] / 2, *size])
    stage.boxes(rows, at=at)


def bicycle_stand(stage: Stage, at: At, count: int) -> None:
    """Place hoops in a row."""
    lines = []
    for y in 0.8 * (np.arange(count) - count / 2):
        (low, top), (far_low, far_top) = ([[x, y, z] for z in (0, 0.8)] for x in (-0.3, 0.3))
        lines += [[low, top], [far_low, far_top], [top, far_top]]
    stage.mesh(tubes(lines, 0.025, 4), at=at)


def tree(stage: Stage, at: At, high: float | None = None, fine: float = 1.0) -> None:
    """Place a tree with a trunk, boughs and a crown of leaves in clumps."""
    random, u = stage.random, stage.random.uniform
    tall = u(4, 12) if high is None else high
    trunk = u(0.2, 0.45) * tall
    wide = u(0.18, 0.32) * tall
    thick = 0.014 * tall + 0.04
    lines = [[[0, 0, 0], [u(-0.1, 0.1), u(-0.1, 0.1), trunk]], [[0, 0, trunk], [0, 0, 0.8 * tall]]]
    radii = [[thick, thick * 0.8], [thick * 0.8, thick * 0.2]]
    clumps = []
    for _ in range(int(u(6, 14))):
        middle = np.array([*random.normal(scale=0.45 * wide, size=2), u(trunk * 0.95, 0.95 * tall)])
        fork = u(trunk * 0.8, min(middle[2], 0.8 * tall) + 0.1)
        lines.append([[0, 0, fork], middle.tolist()])
        radii.append([thick * 0.4, thick * 0.12])
        size = u(0.3, 0.55, 3) * wide * [1, 1, 0.8]
        count = int(fine * 260 * size[0] * size[1] + 60)
        clumps.append(leaves(random, count, size, u(0.06, 0.16), u(0.1, 0.6)).placed(*middle))
    stage.mesh(tubes(lines, np.array(radii), 6), Surface.VEGETATION, at)
    if u() < 0.9:  # or bare, as in winter
        stage.mesh(Mesh.joined(clumps), Surface.VEGETATION, at)


def hedge(stage: Stage, start: ArrayLike, end: ArrayLike, high: float) -> None:
    """Place a hedge of leaves between two places."""
    random = stage.random
    first, last = np.array(start), np.array(end)
    count = int(float(np.linalg.norm(last - first)) / 0.7) + 1
    reach, parts = [0.55, 0.4, high / 2], []
    for share in (np.arange(count) + 0.5) / count:
        x, y, z = first + share * (last - first)
        clump = leaves(random, int(160 * high), reach, random.uniform(0.05, 0.1), 0.6)
        parts.append(clump.placed(x, y, z + high / 2))
    stage.mesh(Mesh.joined(parts), Surface.VEGETATION)


def bush(stage: Stage, at: At, size: float = 1.0) -> None:
    """Place a bush."""
    random, u = stage.random, stage.random.uniform
    wide, tall = size * u(0.4, 1.3), size * u(0.5, 1.8)
    count, reach = int(250 * wide * tall) + 50, [wide, wide * u(0.6, 1), tall / 2]
    clump = leaves(random, count, reach, u(0.04, 0.1), u(0.2, 0.7))
    stage.mesh(clump.placed(0, 0, tall / 2), Surface.VEGETATION, at)
