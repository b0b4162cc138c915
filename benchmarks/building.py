"""A two-storey building with a ramp, sampled as a scanner would: known ground, for the benchmark.

Everything is drawn from one seed. Surfaces carry 1 to 2 cm of noise; the density falls with the
distance from a path; the floor under furniture is occluded; walkers leave trails of ghosts.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = ["Building", "simulate_building"]

Floats = npt.NDArray[np.float64]

LENGTH, WIDTH = 20.0, 12.0
STOREY = 3.2
"""Height of the upper floor above the lower one, metres."""
SLAB = 0.3
_LOWEST_CUPBOARD = 1.0


class Building(NamedTuple):
    """Points, metres, (N, 3), and which of them lie on a floor, a ramp or the stairs."""

    points: Floats
    floor: npt.NDArray[np.bool_]
    upper: npt.NDArray[np.bool_]
    ramp: npt.NDArray[np.bool_]
    clear: npt.NDArray[np.bool_]
    """Points of other things more than 5 cm from the height of either floor: beyond doubt."""


def simulate_building(
    seed: int = 0, *, ramp_slope: float = 0.12, ceilings: bool = True, density: float = 250.0
) -> Building:
    """Build two storeys joined by a ramp outside, with furniture, walls and ghosts.

    Parameters
    ----------
    seed : int
        Seed of every draw.
    ramp_slope : float
        Rise over distance of the ramp.
    ceilings : bool
        Whether the undersides of slab and roof are seen.
    density : float
        Points per square metre near the scanner's path.
    """
    random = np.random.default_rng(seed)
    parts: list[tuple[Floats, str]] = []
    for base, name in ((0.0, "lower"), (STOREY, "upper")):
        tables = _furniture(random, base)
        floor = _plane(random, (0, LENGTH), (0, WIDTH), base, density)
        for x, y, _, half in tables:
            under = (abs(floor[:, 0] - x) < half) & (abs(floor[:, 1] - y) < half)
            floor = floor[~under | (random.random(len(floor)) < 0.3)]
        parts.append((floor, name))
        parts += [(_box(random, *table, density), "object") for table in tables]
        parts += [(wall, "object") for wall in _walls(random, base, density)]
        parts.append((_ghosts(random, base), "object"))
        if ceilings:
            top = base + STOREY - SLAB
            parts.append((_plane(random, (0, LENGTH), (0, WIDTH), top, density * 0.6), "object"))
    parts.append((_ramp(random, ramp_slope, density), "ramp"))
    parts.append((_plane(random, (-12, 0), (-4, WIDTH), 0.0, density * 0.5), "lower"))
    points = np.concatenate([part for part, _ in parts])
    names = np.concatenate([np.full(len(part), name) for part, name in parts])
    points[:, 2] += random.normal(0, 0.012, len(points))
    points[:, :2] += random.normal(0, 0.005, (len(points), 2))
    order = random.permutation(len(points))
    points, names = points[order], names[order]
    from_floor = np.minimum(np.abs(points[:, 2]), np.abs(points[:, 2] - STOREY))
    clear = (names == "object") & (from_floor > 0.05)
    return Building(points, names != "object", names == "upper", names == "ramp", clear)


def _thin(random: np.random.Generator, points: Floats) -> Floats:
    """Drop points the more the farther they lie from the scanner's path along the middle."""
    away = np.abs(points[:, 1] - WIDTH / 2)
    return points[random.random(len(points)) < 1 / (1 + (away / 4) ** 2)]


def _plane(
    random: np.random.Generator,
    x: tuple[float, float],
    y: tuple[float, float],
    z: float,
    density: float,
) -> Floats:
    count = int((x[1] - x[0]) * (y[1] - y[0]) * density)
    points = np.column_stack(
        [random.uniform(*x, count), random.uniform(*y, count), np.full(count, z)]
    )
    return _thin(random, points)


def _furniture(
    random: np.random.Generator, base: float
) -> list[tuple[float, float, tuple[float, float], float]]:
    """Tables, beds and cupboards: place, bottom and top, half-width."""
    pieces = []
    for _ in range(14):
        x, y = random.uniform(1.2, LENGTH - 1.2), random.uniform(1.2, WIDTH - 1.2)
        top = base + float(random.choice([0.45, 0.75, 0.75, 1.1, 1.9]))
        half = float(random.uniform(0.3, 0.9))
        pieces.append((x, y, (base, top), half))
    return pieces


def _box(
    random: np.random.Generator,
    x: float,
    y: float,
    span: tuple[float, float],
    half: float,
    density: float,
) -> Floats:
    """Sample the top of a piece of furniture, and its legs (tables) or sides (cupboards)."""
    bottom, top = span
    count = int(4 * half * half * density)
    lid = np.column_stack([random.uniform(-half, half, (count, 2)), np.full(count, top)])
    if top - bottom < _LOWEST_CUPBOARD:
        count = int(density * (top - bottom))
        corners = random.choice([-half, half], (count, 2))
        legs = np.column_stack([corners, random.uniform(bottom, top, count)])
        return _thin(random, np.concatenate([lid, legs]) + np.array([x, y, 0.0]))
    count = int(8 * half * (top - bottom) * density * 0.5)
    along = random.uniform(-half, half, count)
    side = random.choice([-half, half], count)
    swap = random.random(count) < 0.5
    sides = np.column_stack(
        [
            np.where(swap, along, side),
            np.where(swap, side, along),
            random.uniform(bottom, top, count),
        ]
    )
    return _thin(random, np.concatenate([lid, sides]) + np.array([x, y, 0.0]))


def _walls(random: np.random.Generator, base: float, density: float) -> list[Floats]:
    """Outer walls and one partition with a door."""
    walls = []
    low, high = base, base + STOREY - SLAB
    for axis, place, length in ((0, 0.0, LENGTH), (0, WIDTH, LENGTH), (1, 0.0, WIDTH),
                                (1, LENGTH, WIDTH), (1, 8.0, WIDTH)):  # fmt: skip
        count = int(length * (high - low) * density * 0.7)
        along = random.uniform(0, length, count)
        z = random.uniform(low, high, count)
        points = np.empty((count, 3))
        points[:, axis], points[:, 1 - axis], points[:, 2] = along, place, z
        if place == 8.0:
            points = points[abs(points[:, 1] - 6) > 0.6]
        walls.append(points)
    return walls


def _ghosts(random: np.random.Generator, base: float) -> Floats:
    """Trails of two walkers, from feet to head."""
    trails = []
    for _ in range(2):
        start, end = random.uniform([1, 1], [LENGTH - 1, WIDTH - 1], (2, 2))
        way = random.random((6000, 1))
        trail = start + way * (end - start) + random.normal(0, 0.15, (6000, 2))
        trails.append(np.column_stack([trail, base + random.uniform(0.0, 1.75, 6000)]))
    return np.concatenate(trails)


def _ramp(random: np.random.Generator, slope: float, density: float) -> Floats:
    """Ramp along the long side, 2.5 m wide, from the ground up to the upper floor."""
    length = STOREY / slope
    count = int(length * 2.5 * density * 0.5)
    x = random.uniform(0, length, count)
    y = random.uniform(-2.8, -0.3, count)
    return np.column_stack([x, y, x * slope])
