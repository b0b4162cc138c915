"""People of tapered limbs, who walk, stand, sit and ride, all of them at once.

A body is made of segments between joints. Its gait follows the way it has gone, so that feet do
not slide: one turn of the phase is two steps.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.meshes.mesh import Mesh, boxes, tube_triangles, tube_vertices
from pipeline.simulation.tables import Columns, Floats, Random

SIDES = 6
_DEPTH = np.array([1.0, 0.62, 0.66, 1.0, 1, 1, 1, 1, 1, 1, 1, 1, 0.8, 0.8, 0.7])
_LIMBS = len(_DEPTH)
_RADII = np.array(
    [  # head, chest, pelvis, neck, upper and lower arms, thighs, shanks, feet, what hangs below
        [0.052, 0.056], [0.098, 0.112], [0.105, 0.098], [0.035, 0.035],
        [0.031, 0.027], [0.031, 0.027], [0.025, 0.020], [0.025, 0.020],
        [0.050, 0.037], [0.050, 0.037], [0.035, 0.026], [0.035, 0.026],
        [0.024, 0.021], [0.024, 0.021], [0.085, 0.085],
    ]
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Bodies(Columns):
    """How p people are built."""

    height: Floats  # in metres
    build: Floats  # how stout, about 1
    coat: Floats  # how long a coat or skirt hangs, as a share of the thigh; 0: none
    swing: Floats  # how far arms swing, about 1
    carried: NDArray[np.object_]  # the `Mesh` of what each carries, x ahead; perhaps nothing


@dataclass(frozen=True, slots=True)
class Postures(Columns):
    """Where p people are, and how they hold themselves."""

    place: Floats  # (p, 3), the ground under them
    yaw: Floats  # where they look
    phase: Floats  # of the gait, in radians
    stride: Floats  # how far they step out: 0 standing, 1 a brisk walk
    sitting: Floats  # 0 standing, 1 sitting
    seat: Floats  # its height above the ground
    lean: Floats  # of the upper body ahead, in radians


def draw_bodies(random: Random, count: int, burdens: float = 0.5) -> Bodies:
    """Draw people of all sizes, a share of them with bags, trolleys or prams."""
    height = np.clip(random.normal(1.71, 0.1, count), 1.45, 2.0)
    child = random.random(count) < 0.07
    height = np.where(child, random.uniform(1.0, 1.4, count), height)
    carried = np.empty(count, dtype=object)
    for number, size in enumerate(height):
        laden = random.random() < burdens
        carried[number] = _burden(random, size) if laden else Mesh.joined([])
    return Bodies(
        height=height,
        build=np.clip(random.normal(1.05, 0.13, count), 0.8, 1.5),
        coat=np.where(random.random(count) < 0.3, random.uniform(0.4, 1.2, count), 0.0),
        swing=random.uniform(0.2, 1.2, count),
        carried=carried,
    )


def _burden(random: Random, height: float) -> Mesh:
    """Draw something that a person carries, pulls or pushes."""
    u = random.uniform
    kind = random.choice(["backpack", "bag", "shoulder", "trolley", "pram", "box"],
                         p=[0.32, 0.25, 0.15, 0.14, 0.07, 0.07])  # fmt: skip
    side = random.choice([-1.0, 1.0])
    if kind == "backpack":
        return boxes([-0.2, 0, 0.7 * height, u(0.14, 0.26), u(0.26, 0.36), u(0.36, 0.55)])
    if kind == "bag":
        return boxes([0.03, side * 0.29, 0.27 * height, u(0.25, 0.42), 0.1, u(0.22, 0.36)])
    if kind == "shoulder":
        return boxes([-0.02, side * 0.24, 0.52 * height, u(0.25, 0.38), 0.12, u(0.2, 0.3)])
    if kind == "trolley":
        tall, deep = u(0.5, 0.7), u(0.2, 0.28)
        return boxes([[-0.62, side * 0.25, tall / 2 + 0.05, deep, 0.4, tall],
                      [-0.48, side * 0.25, 0.7, 0.3, 0.03, 0.03]])  # fmt: skip
    if kind == "pram":
        return boxes([[0.75, 0, 0.65, 0.75, 0.46, 0.3], [0.55, 0, 0.9, 0.35, 0.44, 0.25],
                      [0.75, 0.22, 0.25, 0.8, 0.04, 0.05], [0.75, -0.22, 0.25, 0.8, 0.04, 0.05],
                      [1.0, 0, 0.13, 0.24, 0.5, 0.24], [0.5, 0, 0.13, 0.24, 0.5, 0.24],
                      [0.3, 0, 1.0, 0.04, 0.5, 0.04]])  # fmt: skip
    return boxes([0.36, 0, 0.62 * height, u(0.25, 0.4), u(0.3, 0.5), u(0.2, 0.4)])


def limbs(bodies: Bodies, postures: Postures) -> Floats:
    """Return where each limb begins and ends, in the frame of each body: (p, limbs, 2, 3)."""
    tall = bodies.height
    phase, step = postures.phase, postures.stride
    sit = postures.sitting
    place = np.zeros((len(bodies), _LIMBS, 2, 3))
    thigh, shank = 0.245 * tall, 0.235 * tall
    hip_standing = thigh + shank + 0.05 * tall
    bob = 0.012 * tall * np.cos(2 * phase) * step - 0.015 * tall * step
    hip = (1 - sit) * (hip_standing + bob) + sit * (postures.seat + 0.09)
    sway = 0.014 * tall * np.sin(phase) * step
    root = np.stack([np.zeros_like(tall), sway, hip], axis=1)
    lean = postures.lean + 0.05 * step
    up = np.stack([np.sin(lean), np.zeros_like(lean), np.cos(lean)], axis=1)
    turn = 0.12 * np.sin(phase) * step  # shoulders turn against the hips
    place[:, 2, 0] = root + up * (-0.01 * tall)[:, None]
    place[:, 2, 1] = root + up * (0.10 * tall)[:, None]
    place[:, 1, 0] = root + up * (0.12 * tall)[:, None]
    place[:, 1, 1] = root + up * (0.25 * tall)[:, None]
    neck = root + up * (0.30 * tall)[:, None]
    place[:, 3, 0], place[:, 3, 1] = neck, neck + up * (0.05 * tall)[:, None]
    place[:, 0, 0] = neck + up * (0.075 * tall)[:, None]
    place[:, 0, 1] = neck + up * (0.115 * tall)[:, None]
    place[:, 14, 0] = root
    hang = (bodies.coat * thigh)[:, None] * np.stack([np.sin(sit), 0 * sit, -np.cos(sit)], axis=1)
    place[:, 14, 1] = root + hang
    for side, sign in ((0, 1.0), (1, -1.0)):
        aside = np.stack([np.zeros_like(tall), sign * 0.055 * tall, np.zeros_like(tall)], axis=1)
        swing = np.sin(phase + side * np.pi)
        hip_angle = (1 - sit) * 0.47 * swing * step + sit * 1.45
        lift = np.maximum(0.0, np.cos(phase + side * np.pi))
        knee = hip_angle - (1 - sit) * (0.1 + 0.85 * lift) * step - sit * 1.45
        here = root + aside
        knee_at = here + thigh[:, None] * _down(hip_angle)
        ankle = knee_at + shank[:, None] * _down(knee)
        place[:, 8 + side] = np.stack([here, knee_at], axis=1)
        place[:, 10 + side] = np.stack([knee_at, ankle], axis=1)
        toe = knee + 0.1
        foot = np.stack([np.cos(toe), 0 * toe, np.sin(toe)], axis=1)
        toes = ankle + foot * (0.1 * tall)[:, None]
        place[:, 12 + side] = np.stack([ankle - 0.02 * foot, toes], axis=1)
        shoulder = root + up * (0.27 * tall)[:, None] + 1.95 * aside * bodies.build[:, None] ** 0.5
        shoulder[:, 0] += sign * 0.1 * tall * np.sin(turn)
        arm = -0.5 * swing * step * bodies.swing + 0.25 * sit + postures.lean * 1.2
        bend = arm + 0.15 + 0.35 * step + 0.9 * sit
        elbow = shoulder + (0.17 * tall)[:, None] * _down(arm) + 0.15 * aside
        place[:, 4 + side] = np.stack([shoulder, elbow], axis=1)
        place[:, 6 + side] = np.stack([elbow, elbow + (0.19 * tall)[:, None] * _down(bend)], axis=1)
    return place


def _down(angle: Floats) -> Floats:
    """Return unit vectors that hang down, swung ahead by an angle."""
    return np.stack([np.sin(angle), np.zeros_like(angle), -np.cos(angle)], axis=1)


def people_mesh(bodies: Bodies, postures: Postures) -> tuple[Mesh, NDArray[np.int64]]:
    """Return people as triangles, and which of them each triangle belongs to."""
    count = len(bodies)
    if not count:
        return Mesh.joined([]), np.empty(0, dtype=np.int64)
    ends = limbs(bodies, postures)
    radii = _RADII * bodies.height[:, None, None] * np.ones((count, _LIMBS, 2))
    radii[:, 1:] *= bodies.build[:, None, None]
    radii[:, 14] *= np.where(bodies.coat > 0, 1.15, 0.7)[:, None]
    cosine, sine = np.cos(postures.yaw), np.sin(postures.yaw)
    turn = np.zeros((count, 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1] = cosine, -sine, sine, cosine
    turn[:, 2, 2] = 1.0
    world = np.einsum("pij,plej->plei", turn, ends) + postures.place[:, None, None]
    across = np.repeat(turn[:, None, :, 1], _LIMBS, axis=1)
    ends, radii, depth = world.reshape(-1, 2, 3), radii.reshape(-1, 2), np.tile(_DEPTH, count)
    vertices = tube_vertices(ends, radii, SIDES, across.reshape(-1, 3), depth)
    parts = [Mesh(vertices.reshape(-1, 3), tube_triangles(count * _LIMBS, SIDES))]
    owners = [np.repeat(np.arange(count), _LIMBS * 8 * SIDES)]
    for number, burden in enumerate(bodies.carried):
        if len(burden.triangles):
            x, y, z = postures.place[number]
            parts.append(burden.placed(x, y, z, float(postures.yaw[number])))
            owners.append(np.full(len(burden.triangles), number))
    return Mesh.joined(parts), np.concatenate(owners)
