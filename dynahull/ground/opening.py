"""Slope-limited morphological opening of the levels, storey by storey."""

from functools import partial

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
from dynahull.threads import over_ranges, range_bounds

_SMALLEST_RANGE = 4_000
"""Levels; there are two calls for every growth of the disk."""


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
    bounds = range_bounds(len(heights), threads, _SMALLEST_RANGE)
    surroundings = (heights, slots, starts, lattice.neighbours)
    smaller = 1
    for disk, limit in zip(disks, p.step + p.slope * radii, strict=True):
        ring, window = offsets[smaller:disk], offsets[1:disk]
        over_ranges(partial(_erode, *surroundings, ring, storey, eroded), bounds, threads)
        over_ranges(
            partial(_open, *surroundings, window, storey, limit, eroded, opened, objects),
            bounds,
            threads,
        )
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
