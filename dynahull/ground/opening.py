"""Slope-limited morphological opening of the levels, storey by storey."""

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

__all__ = ["stand_out"]


def stand_out(levels: Levels, lattice: Lattice, p: SlopeParameters, storey: float) -> Booleans:
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
    offsets = disk_offsets(p.window / p.cell)
    distances = distances_of(offsets, p.cell)
    radii = p.cell * np.arange(1, int(p.window / p.cell) + 1)
    return _stand_out(
        levels.heights,
        levels.slots,
        starts_of(levels.slots, lattice.slot_count),
        lattice.neighbours,
        offsets,
        np.searchsorted(distances, radii, side="right"),
        p.step + p.slope * radii,
        storey,
    )


@compiled
def _stand_out(
    heights: Floats,
    slots: Integers,
    starts: Integers,
    neighbours: Integers,
    offsets: Integers,
    disks: Integers,
    limits: Floats,
    storey: float,
) -> Booleans:
    eroded = heights.copy()
    opened = heights.copy()
    objects = np.zeros(len(heights), np.bool_)
    ring = 1
    for growth in range(len(disks)):
        disk = disks[growth]
        _erode(eroded, heights, slots, starts, neighbours, offsets[ring:disk], storey)
        ring = disk
        for level in range(len(heights)):
            highest = eroded[level]
            for k in range(1, disk):
                if highest >= opened[level]:
                    break
                slot = slot_at(slots[level], offsets[k, 0], offsets[k, 1], neighbours)
                if slot < 0:
                    continue
                for other in range(starts[slot], starts[slot + 1]):
                    if -storey <= heights[other] - heights[level] <= storey / 2:
                        highest = max(highest, eroded[other])
                        break
            lowered = min(highest, opened[level])
            if opened[level] - lowered > limits[growth]:
                objects[level] = True
            opened[level] = lowered
    return objects


@compiled
def _erode(
    eroded: Floats,
    heights: Floats,
    slots: Integers,
    starts: Integers,
    neighbours: Integers,
    ring: Integers,
    storey: float,
) -> None:
    """Widen the erosion by a ring: that by a disk is that by the smaller one, and the ring's."""
    for level in range(len(heights)):
        for k in range(len(ring)):
            slot = slot_at(slots[level], ring[k, 0], ring[k, 1], neighbours)
            if slot < 0:
                continue
            for other in range(starts[slot], starts[slot + 1]):
                if abs(heights[other] - heights[level]) <= storey:
                    eroded[level] = min(eroded[level], heights[other])
                    break
