"""Which levels are ground: they go on around them, and are no ceilings and no tops of objects."""

from functools import partial

import numpy as np

from dynahull.compilation import compiled, helper
from dynahull.ground.columns import Columns, Levels, first_from
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
from dynahull.ground.parameters import SlopeParameters
from dynahull.ground.reach import FLAT_RADIUS
from dynahull.summary import Summary
from dynahull.threads import over_items, over_ranges

_SMALLEST_RANGE = 2_000
"""Levels."""

_STRIDE = 2
"""Every second cell is looked at for what stands on a floor: enough, in a quarter of the time."""

_MARGIN = 0.3
"""Metres above or beneath a surface that belong to the surface: a slab, a carpet, noise."""

_UNDER_SHARE = 0.1
"""A surface with less than this share of its columns over something is the lowest there is."""

_ABOVE_SHARE = 0.03
_ABOVE_TO_BENEATH = 0.3
"""Least columns with something above a floor: of all, and of those with something beneath it."""


def are_flat(levels: Levels, lattice: Lattice, p: SlopeParameters, threads: int = 1) -> Booleans:
    """Tell which levels go on in the cells about them.

    A cell continues a level if it holds one no more than `step + continuity * distance` higher or
    lower. At least `flatness` of the occupied cells must, and they must spread over an area: those
    that continue the foot of a wall lie on a line. Where nothing stands on the lowest level
    half the spread will do, so that the separate rings of a distant scan count.
    """
    offsets = disk_offsets(FLAT_RADIUS)[1:]
    starts = starts_of(levels.slots, lattice.slot_count)
    reaches = p.step + p.expert.continuity * distances_of(offsets, p.expert.cell)
    share, breadth = p.expert.flatness, 0.0 if p.clearance is None else p.expert.breadth
    flat = np.empty(len(levels.heights), np.bool_)
    about = (starts, lattice.neighbours, offsets, reaches)
    look = partial(_are_flat, levels, *about, share, breadth, flat)
    over_items(look, len(flat), threads, _SMALLEST_RANGE)
    return flat


@compiled
def _are_flat(
    levels: Levels,
    starts: Integers,
    neighbours: Integers,
    offsets: Integers,
    reaches: Floats,
    share: float,
    breadth: float,
    flat: Booleans,
    first_level: int,
    end_level: int,
) -> None:
    heights, occupied = levels.heights, 0
    around = np.empty(len(offsets), np.int64)
    cells = np.empty(len(offsets), np.int64)
    last = -1
    for level in range(first_level, end_level):
        if levels.slots[level] != last:
            # the levels of a column have the same cells about them
            last = levels.slots[level]
            occupied = 0
            for k in range(len(offsets)):
                slot = slot_at(last, offsets[k, 0], offsets[k, 1], neighbours)
                if starts[slot] < starts[slot + 1]:
                    around[occupied], cells[occupied] = k, slot
                    occupied += 1
        continued = 0
        u = v = uu = uv = vv = 0.0
        for place in range(occupied):
            if continued + occupied - place < share * occupied:
                break
            k, slot = around[place], cells[place]
            for other in range(starts[slot], starts[slot + 1]):
                if abs(heights[other] - heights[level]) <= reaches[k]:
                    i, j = float(offsets[k, 0]), float(offsets[k, 1])
                    continued += 1
                    u += i
                    v += j
                    uu += i * i
                    uv += i * j
                    vv += j * j
                    break
        wanted = breadth / 2 if levels.bare[level] else breadth
        flat[level] = continued >= share * occupied and (
            wanted == 0 or _breadth(continued + 1.0, u, v, uu, uv, vv) >= wanted
        )


@helper
def _breadth(n: float, su: float, sv: float, suu: float, suv: float, svv: float) -> float:
    """Return the smaller variance along the principal axes, from sums over n cells."""
    a = suu / n - (su / n) ** 2
    b = suv / n - su * sv / (n * n)
    c = svv / n - (sv / n) ** 2
    return (a + c) / 2 - np.sqrt(((a - c) / 2) ** 2 + b * b)


def outlines(columns: Columns, clearance: float, threads: int = 1) -> Summary:
    """Return heights of each column, ascending, (n, 1), that answer what `are_floors` asks.

    It asks for the lowest and the highest point, and whether there is one in a range of heights. A
    point lies in no range that neither the next one beneath it that is kept lies in, nor the next
    above, if these two are nearer to each other than the range is long; half of that is asked here,
    as ranges are rounded.
    """
    gap = min(2 * _MARGIN, clearance / 2) / 2
    kept = np.zeros(len(columns.heights), np.bool_)
    over_ranges(partial(_mark_outline, columns, gap, kept), columns.bounds(threads), threads)
    numbers = np.searchsorted(columns.starts, np.flatnonzero(kept), side="right") - 1
    return Summary(columns.cells[numbers], columns.heights[kept][:, None])


@compiled
def _mark_outline(
    columns: Columns, gap: float, kept: Booleans, first_column: int, end_column: int
) -> None:
    heights, starts = columns.heights, columns.starts
    for column in range(first_column, end_column):
        place, last = starts[column], starts[column + 1] - 1
        kept[place] = True
        while place < last:
            following = place + 1
            while following < last and heights[following + 1] - heights[place] <= gap:
                following += 1
            kept[following] = True
            place = following


def are_floors(
    levels: Levels,
    heights: Floats,
    starts: Integers,
    lattice: Lattice,
    p: SlopeParameters,
    clearance: float,
    threads: int = 1,
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
    heights : (n,) float64 array
        Of the lattice's columns, as `outlines` returns them, metres.
    starts : (slots + 1,) int64 array
        Where those of each slot begin.
    """
    offsets = disk_offsets(p.expert.storey_radius / p.expert.cell / _STRIDE) * _STRIDE
    reaches = _MARGIN + p.slope * distances_of(offsets, p.expert.cell)
    floors = np.zeros(len(levels.heights), np.bool_)
    about = (heights, starts, lattice.neighbours, offsets, reaches)
    look = partial(_are_floors, levels, *about, clearance, floors)
    over_items(look, len(floors), threads, _SMALLEST_RANGE)
    return floors


@compiled
def _are_floors(
    levels: Levels,
    columns: Floats,
    starts: Integers,
    neighbours: Integers,
    offsets: Integers,
    reaches: Floats,
    clearance: float,
    floors: Booleans,
    first_level: int,
    end_level: int,
) -> None:
    for level in range(first_level, end_level):
        own, z = levels.slots[level], levels.heights[level]
        if _rests_on_something(own, z, columns, starts, neighbours, clearance):
            continue
        occupied, surface, under, beneath, above = 0, 0, 0, 0, 0
        for k in range(len(offsets)):
            slot = slot_at(own, offsets[k, 0], offsets[k, 1], neighbours)
            if starts[slot] == starts[slot + 1]:
                continue
            first, end = starts[slot], starts[slot + 1]
            bottom, top = z - reaches[k], z + reaches[k]
            occupied += 1
            if columns[end - 1] > top:
                above += 1
            if columns[first] > top or columns[end - 1] < bottom:
                continue
            lowest = first
            if columns[first] < bottom:
                lowest = first_from(columns, first, end, bottom)
                if columns[lowest] > top:
                    continue
            surface += 1
            if lowest > first:
                under += 1
                if _is_filled(columns, first, end, z, clearance):
                    beneath += 1
        floors[level] = under < _UNDER_SHARE * surface or (
            above >= _ABOVE_SHARE * occupied and above >= _ABOVE_TO_BENEATH * beneath
        )


@helper
def _is_filled(columns: Floats, first: int, end: int, z: float, clearance: float) -> bool:
    """Whether a point lies between half and the whole clearance under z: deeper than a slab."""
    if columns[first] > z - clearance / 2:
        return False
    lowest = first_from(columns, first, end, z - clearance)
    return lowest < end and columns[lowest] <= z - clearance / 2


@helper
def _rests_on_something(
    slot: int, z: float, columns: Floats, starts: Integers, neighbours: Integers, clearance: float
) -> bool:
    """Whether two of three columns next to a level are filled beneath it."""
    occupied, filled = 0, 0
    for di in range(-1, 2):
        for dj in range(-1, 2):
            other = slot_at(slot, di, dj, neighbours)
            if starts[other] == starts[other + 1]:
                continue
            occupied += 1
            if _is_filled(columns, starts[other], starts[other + 1], z, clearance):
                filled += 1
    return 3 * filled >= 2 * occupied


def stand_out(
    levels: Levels, lattice: Lattice, p: SlopeParameters, storey: float, threads: int = 1
) -> Booleans:
    """Tell which levels belong to objects that stand on the ground.

    After Pingel, Clarke and McBride (2013), section 2.2: the surface is opened by disks whose
    radius r grows by a cell up to `window`; a level that one growth of the disk lowers by more than
    `step + slope * r` belongs to an object. A hill is lowered little by little and stays,
    a table or a house is lowered at once.

    Their surface has one height a cell; ours may have several. Two levels see each other if
    their heights are at most `storey` metres apart, and of a column only the lowest of those is
    seen. Looking up, half of that is the limit: beyond it begins the next storey. Cells
    without a level are passed over, not filled.
    """
    offsets = disk_offsets(p.window / p.expert.cell)
    radii = p.expert.cell * np.arange(1, int(p.window / p.expert.cell) + 1)
    disks = np.searchsorted(distances_of(offsets, p.expert.cell), radii, side="right")
    heights, slots = levels.heights, levels.slots
    starts = starts_of(slots, lattice.slot_count)
    eroded, opened = heights.copy(), heights.copy()
    objects = np.zeros(len(heights), np.bool_)
    surroundings = (heights, slots, starts, lattice.neighbours)
    smaller = 1
    for disk, limit in zip(disks, p.step + p.slope * radii, strict=True):
        ring, window = offsets[smaller:disk], offsets[1:disk]
        erode = partial(_erode, *surroundings, ring, storey, eroded)
        open_ = partial(_open, *surroundings, window, storey, limit, eroded, opened, objects)
        for step in (erode, open_):
            over_items(step, len(heights), threads, _SMALLEST_RANGE)
        smaller = disk
    return objects


@compiled
def _erode(
    heights: Floats,
    slots: Integers,
    starts: Integers,
    neighbours: Integers,
    ring: Integers,
    storey: float,
    eroded: Floats,
    first_level: int,
    end_level: int,
) -> None:
    """Widen the erosion by a ring: that by a disk is that by the smaller one, and the ring's."""
    for level in range(first_level, end_level):
        lowest = eroded[level]
        for k in range(len(ring)):
            slot = slot_at(slots[level], ring[k, 0], ring[k, 1], neighbours)
            for other in range(starts[slot], starts[slot + 1]):
                if abs(heights[other] - heights[level]) <= storey:
                    lowest = min(lowest, heights[other])
                    break
        eroded[level] = lowest


@compiled
def _open(
    heights: Floats,
    slots: Integers,
    starts: Integers,
    neighbours: Integers,
    window: Integers,
    storey: float,
    limit: float,
    eroded: Floats,
    opened: Floats,
    objects: Booleans,
    first_level: int,
    end_level: int,
) -> None:
    """Lower the opened surface to the dilation of the eroded one, and say what that lowers."""
    for level in range(first_level, end_level):
        if objects[level]:
            continue
        highest = eroded[level]
        for k in range(len(window)):
            if highest >= opened[level]:
                break
            slot = slot_at(slots[level], window[k, 0], window[k, 1], neighbours)
            for other in range(starts[slot], starts[slot + 1]):
                if -storey <= heights[other] - heights[level] <= storey / 2:
                    highest = max(highest, eroded[other])
                    break
        lowered = min(highest, opened[level])
        objects[level] = opened[level] - lowered > limit
        opened[level] = lowered
