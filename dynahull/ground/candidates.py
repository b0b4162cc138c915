"""Which levels may be floors: those that go on around them, and those that are no ceilings."""

import numpy as np

from dynahull.compilation import compiled
from dynahull.ground.lattice import (
    Booleans,
    Floats,
    Integers,
    Lattice,
    disk_offsets,
    distances_of,
    slot_at,
    starts_of,
)
from dynahull.ground.levels import Levels
from dynahull.ground.parameters import SlopeParameters

__all__ = ["FLAT_RADIUS", "are_flat", "are_floors"]

FLAT_RADIUS = 2.9
"""Cells; the neighbourhood in which a level must go on."""

_STRIDE = 2
"""Every second cell is looked at for what stands on a floor: enough, in a quarter of the time."""

_MARGIN = 0.3
"""Metres above or beneath a surface that belong to the surface: a slab, a carpet, noise."""

_UNDER_SHARE = 0.1
"""A surface with less than this share of its columns over something is the lowest there is."""

_ABOVE_SHARE = 0.03
_ABOVE_TO_BENEATH = 0.3
"""Least columns with something above a floor: of all, and of those with something beneath it."""


def are_flat(levels: Levels, lattice: Lattice, p: SlopeParameters) -> Booleans:
    """Tell which levels go on in the cells about them.

    A cell continues a level if it holds one no more than `step + continuity * distance` higher or
    lower. At least `flatness` of the occupied cells must, and they must spread over an area: those
    that continue the foot of a wall lie on a line. Where nothing stands on the lowest level
    half the spread will do, so that the separate rings of a distant scan count.
    """
    offsets = disk_offsets(FLAT_RADIUS)
    return _are_flat(
        levels.heights,
        levels.slots,
        levels.bare,
        starts_of(levels.slots, lattice.slot_count),
        lattice.neighbours,
        offsets,
        p.step + p.continuity * distances_of(offsets, p.cell),
        p.flatness,
        0.0 if p.clearance is None else p.breadth,
    )


@compiled
def _are_flat(
    heights: Floats,
    slots: Integers,
    bare: Booleans,
    starts: Integers,
    neighbours: Integers,
    offsets: Integers,
    reaches: Floats,
    share: float,
    breadth: float,
) -> Booleans:
    flat = np.zeros(len(heights), np.bool_)
    cells = np.empty((len(offsets), 2), np.float64)
    for level in range(len(heights)):
        cells[0] = 0.0
        occupied, continued = 0, 0
        for k in range(1, len(offsets)):
            slot = slot_at(slots[level], offsets[k, 0], offsets[k, 1], neighbours)
            if slot < 0 or starts[slot] == starts[slot + 1]:
                continue
            occupied += 1
            for other in range(starts[slot], starts[slot + 1]):
                if abs(heights[other] - heights[level]) <= reaches[k]:
                    continued += 1
                    cells[continued, 0] = offsets[k, 0]
                    cells[continued, 1] = offsets[k, 1]
                    break
        wanted = breadth / 2 if bare[level] else breadth
        flat[level] = continued >= share * occupied and (
            wanted == 0 or _breadth(cells[: continued + 1]) >= wanted
        )
    return flat


@compiled
def _breadth(cells: Floats) -> float:
    """Return the smaller variance along the principal axes."""
    n = len(cells)
    su = sv = suu = suv = svv = 0.0
    for k in range(n):
        u, v = cells[k]
        su += u
        sv += v
        suu += u * u
        suv += u * v
        svv += v * v
    a = suu / n - (su / n) ** 2
    b = suv / n - su * sv / (n * n)
    c = svv / n - (sv / n) ** 2
    return (a + c) / 2 - np.sqrt(((a - c) / 2) ** 2 + b * b)


def are_floors(
    levels: Levels,
    columns: Floats,
    starts: Integers,
    lattice: Lattice,
    p: SlopeParameters,
    clearance: float,
) -> Booleans:
    """Tell floors from ceilings, and from the tops of solid things.

    Things stand on a floor; beneath a ceiling they stand or hang. Of the columns within
    `storey_radius` four numbers are counted: those that hold the surface, those of them with a
    point under it at any depth, those with one between half and the whole `clearance` under it,
    and the columns with a point above the surface. A level is a floor if little lies under it,
    or if the last number is not small, nor small against the third. The top of a wall, a tree or
    a van, whose own columns are full beneath it, is no floor.

    Parameters
    ----------
    levels : Levels
        Those to judge.
    columns, starts : arrays
        The heights of all points, column by column, as `find_levels` takes them.
    lattice : Lattice
        Where the columns are.
    p : SlopeParameters
        `storey_radius`, `slope` and `cell` are used.
    clearance : float
        Metres.
    """
    offsets = disk_offsets(p.storey_radius / p.cell / _STRIDE) * _STRIDE
    return _are_floors(
        levels.heights,
        levels.slots,
        columns,
        starts,
        lattice.neighbours,
        offsets,
        _MARGIN + p.slope * distances_of(offsets, p.cell),
        clearance,
    )


@compiled
def _are_floors(
    heights: Floats,
    slots: Integers,
    columns: Floats,
    starts: Integers,
    neighbours: Integers,
    offsets: Integers,
    reaches: Floats,
    clearance: float,
) -> Booleans:
    floors = np.zeros(len(heights), np.bool_)
    for level in range(len(heights)):
        z = heights[level]
        if _rests_on_something(slots[level], z, columns, starts, neighbours, clearance):
            continue
        occupied, surface, under, beneath, above = 0, 0, 0, 0, 0
        for k in range(len(offsets)):
            slot = slot_at(slots[level], offsets[k, 0], offsets[k, 1], neighbours)
            if slot < 0 or starts[slot] == starts[slot + 1]:
                continue
            occupied += 1
            column = columns[starts[slot] : starts[slot + 1]]
            if column[-1] > z + reaches[k]:
                above += 1
            lowest = np.searchsorted(column, z - reaches[k])
            if lowest == len(column) or column[lowest] > z + reaches[k]:
                continue
            surface += 1
            if lowest > 0:
                under += 1
                if _is_filled(column, z, clearance):
                    beneath += 1
        floors[level] = under < _UNDER_SHARE * surface or (
            above >= _ABOVE_SHARE * occupied and above >= _ABOVE_TO_BENEATH * beneath
        )
    return floors


@compiled
def _is_filled(column: Floats, z: float, clearance: float) -> bool:
    """Whether a point lies between half and the whole clearance under z: deeper than a slab."""
    first = np.searchsorted(column, z - clearance)
    return bool(first < len(column) and column[first] <= z - clearance / 2)


@compiled
def _rests_on_something(
    slot: int, z: float, columns: Floats, starts: Integers, neighbours: Integers, clearance: float
) -> bool:
    """Whether two of three columns next to a level are filled beneath it."""
    occupied, filled = 0, 0
    for di in range(-1, 2):
        for dj in range(-1, 2):
            other = slot_at(slot, di, dj, neighbours)
            if other < 0 or starts[other] == starts[other + 1]:
                continue
            occupied += 1
            if _is_filled(columns[starts[other] : starts[other + 1]], z, clearance):
                filled += 1
    return 3 * filled >= 2 * occupied
