"""Things on wheels, and dogs: rigid meshes about the origin, x ahead, on the ground."""

from collections.abc import Callable

import numpy as np

from pipeline.simulation.meshes.mesh import Mesh, boxes, corners, extruded, tubes
from pipeline.simulation.tables import Random


def car(random: Random) -> Mesh:
    """Make a car: hatchback, saloon or estate."""
    u = random.uniform
    length, width, height = u(3.7, 4.9), u(1.65, 1.9), u(1.4, 1.7)
    bonnet, belt, sill = u(0.7, 0.85), u(0.88, 1.0), u(0.16, 0.24)
    half, rear = length / 2, u(0.02, 0.28) * length
    body = [
        [-half, sill + 0.1], [-half + 0.1, belt], [half * 0.35, belt], [half - 0.25, bonnet],
        [half, bonnet - 0.25], [half - 0.05, sill + 0.05], [half * 0.9, sill], [-half * 0.9, sill],
    ]  # fmt: skip
    cabin = [
        [-half + rear, belt], [-half + rear + 0.4, height - 0.05], [-half + rear + 0.8, height],
        [half * 0.05, height - 0.02], [half * 0.45, belt],
    ]  # fmt: skip
    wheels = _wheels(0.62 * half, width, u(0.3, 0.35))
    return Mesh.joined([extruded(body, width), extruded(cabin, width * 0.86), wheels])


def van(random: Random) -> Mesh:
    """Make a delivery van."""
    u = random.uniform
    length, width, height = u(4.8, 6.5), u(1.9, 2.1), u(1.9, 2.7)
    half = length / 2
    side = [
        [-half, 0.3], [-half, height], [half - 1.6, height], [half - 0.8, 1.15],
        [half, 0.95], [half, 0.3],
    ]  # fmt: skip
    return Mesh.joined([extruded(side, width), _wheels(0.62 * half, width, 0.34)])


def bus(random: Random) -> Mesh:
    """Make a bus or a lorry."""
    u = random.uniform
    length, height = u(7.0, 12.0), u(2.8, 3.4)
    body = boxes([0, 0, height / 2 + 0.2, length, 2.5, height - 0.3])
    return Mesh.joined([body, _wheels(0.35 * length, 2.5, 0.48)])


def bicycle(random: Random) -> Mesh:
    """Make a bicycle, without its rider."""
    radius, base = random.uniform(0.31, 0.35), random.uniform(0.98, 1.12)
    angle = np.linspace(0, 2 * np.pi, 13)
    parts = []
    for x in (-base / 2, base / 2):
        across, up = x + radius * np.cos(angle), radius + radius * np.sin(angle)
        rim = np.column_stack([across, 0 * angle, up])
        parts.append(tubes(np.stack([rim[:-1], rim[1:]], axis=1), 0.022, 4))
    hub, front = [-base / 2, 0, radius], [base / 2, 0, radius]
    pedal, seat, head = [-0.08, 0, 0.3], [-0.2, 0, 0.92], [base / 2 - 0.16, 0, 0.9]
    lines = [
        [hub, pedal], [pedal, seat], [hub, seat], [pedal, head], [head, front], [seat, head],
        [[base / 2 - 0.22, -0.28, 1.03], [base / 2 - 0.22, 0.28, 1.03]],
    ]  # fmt: skip
    parts.append(tubes(lines, 0.02, 4))
    return Mesh.joined(parts)


def forklift(random: Random) -> Mesh:
    """Make a forklift with a mast, a cage, a driver's outline, and perhaps a load."""
    u = random.uniform
    parts = [
        boxes([[-0.3, 0, 0.55, 1.6, 1.05, 0.75], [-0.9, 0, 0.9, 0.45, 1.0, 0.5],
               [0.75, 0.28, 0.05, 1.1, 0.12, 0.05], [0.75, -0.28, 0.05, 1.1, 0.12, 0.05],
               [-0.35, 0, 2.1, 1.1, 0.95, 0.05]]),
        tubes([[[x, y, 0.9], [x * 0.8 - 0.1, y, 2.1]] for x in (-0.8, 0.25) for y in (-0.45, 0.45)],
              0.035, 4),
        boxes([[0.6, 0.33, 1.05, 0.12, 0.09, 2.1], [0.6, -0.33, 1.05, 0.12, 0.09, 2.1],
               [0.6, 0, u(0.5, 1.9), 0.08, 0.7, 0.1], [-0.35, 0, 1.25, 0.35, 0.45, 0.6]]),
        tubes([[[-0.33, 0, 1.65], [-0.33, 0, 1.73]]], 0.11),
        _wheels(0.5, 1.0, 0.28),
    ]  # fmt: skip
    if random.random() < 0.6:
        parts.append(boxes([1.2, 0, 0.2 + u(0.3, 0.6), 1.0, u(0.9, 1.2), u(0.5, 1.1)]))
    return Mesh.joined(parts)


def robot(random: Random) -> Mesh:
    """Make a low robot, a cart or a pallet jack."""
    u = random.uniform
    length, width = u(0.5, 1.4), u(0.45, 0.9)
    rows = [[0, 0, 0.2, length, width, u(0.2, 0.35)]]
    if random.random() < 0.6:
        rows.append([0, 0, 0.35 + 0.25, length * 0.8, width * 0.85, u(0.2, 0.6)])
    if random.random() < 0.5:
        rows.append([-length / 2, 0, 0.7, 0.05, width * 0.7, 0.9])
    return boxes(rows)


def dog(random: Random) -> Mesh:
    """Make a dog."""
    size = random.uniform(0.6, 1.15)
    steps = [(x, y, x + random.uniform(-0.1, 0.1)) for x, y in corners(0.25, 0.08)]
    legs = [[[x, y, 0.38], [foot, y, 0.02]] for x, y, foot in steps]
    neck, muzzle = [[0.3, 0, 0.5], [0.42, 0, 0.62]], [[0.42, 0, 0.64], [0.56, 0, 0.6]]
    tail = [[-0.35, 0, 0.5], [-0.55, 0, 0.62]]
    thin = tubes([neck, muzzle, tail, *legs], [[0.07, 0.07]] * 2 + [[0.03, 0.02]] * 5)
    body = Mesh.joined([tubes([[[-0.28, 0, 0.45], [0.28, 0, 0.47]]], 0.12), thin])
    return Mesh(body.vertices * size, body.triangles)


def chair(random: Random) -> Mesh:
    """Make a chair that somebody pushes elsewhere."""
    legs = [[[x, y, 0], [x, y, 0.45]] for x, y in corners(0.2, 0.2)]
    seat = [[0, 0, 0.45, 0.44, 0.44, 0.05], [-0.21, 0, 0.72, 0.04, 0.42, random.uniform(0.3, 0.5)]]
    return Mesh.joined([boxes(seat), tubes(legs, 0.016, 4)])


def crate(random: Random) -> Mesh:
    """Make a crate, a bin or a carton that somebody carries elsewhere."""
    size = random.uniform(0.3, 0.9, 3)
    return boxes([0, 0, size[2] / 2, *size])


def _wheels(apart: float, width: float, radius: float) -> Mesh:
    """Make four wheels."""
    places = corners(apart, width / 2 - radius)
    ends = [[[x, y - 0.02, radius], [x, y + 0.02, radius]] for x, y in places]
    return tubes(ends, radius * 0.95, 10)


VEHICLES: dict[str, Callable[[Random], Mesh]] = {
    make.__name__: make for make in (car, van, bus, bicycle, forklift, robot, dog, chair, crate)
}
"""What makes each kind."""
