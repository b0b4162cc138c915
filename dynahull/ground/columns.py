"""The points of a map column by column, each from its lowest point up."""

from typing import NamedTuple

import numpy as np

from dynahull.compilation import compiled, helper
from dynahull.ground.lattice import Floats, Integers, Lattice, starts_of
from dynahull.threads import group_bounds, over_ranges

__all__ = ["Columns", "first_above", "first_from", "sort_columns"]

_SMALLEST_RANGE = 20_000
"""Points."""

_RUN = 16
"""Points that are sorted by insertion."""


class Columns(NamedTuple):
    """Points ordered by slot, and by height within a slot."""

    heights: Floats
    """Metres, (N,)."""
    rows: Integers
    """Which point it is, (N,)."""
    starts: Integers
    """Where the column of each slot begins, (slots + 1,)."""

    def bounds(self, threads: int) -> list[int]:
        """Cut the slots into ranges with equally many points; see `over_ranges`."""
        return group_bounds(self.starts, threads, _SMALLEST_RANGE)


def sort_columns(points: Floats, lattice: Lattice, threads: int = 1) -> Columns:
    """Sort points by their cell and their height.

    Parameters
    ----------
    points : (N, 3) float64 array
        Metres.
    lattice : Lattice
        Their cells.
    threads : int
        They change nothing about the result.
    """
    starts = starts_of(lattice.slots, lattice.slot_count)
    columns = Columns(np.empty(len(points)), np.empty(len(points), np.int64), starts)
    over_ranges(
        lambda first, end: _sort_columns(points, lattice.slots, *columns, first, end),
        columns.bounds(threads),
        threads,
    )
    return columns


@compiled
def _sort_columns(
    points: Floats,
    slots: Integers,
    heights: Floats,
    rows: Integers,
    starts: Integers,
    first_slot: int,
    end_slot: int,
) -> None:
    """Fill a range of slots: every thread reads all slots and writes its own columns."""
    place = starts[first_slot:end_slot].copy()
    for point in range(len(slots)):
        slot = slots[point]
        if first_slot <= slot < end_slot:
            heights[place[slot - first_slot]] = points[point, 2]
            rows[place[slot - first_slot]] = point
            place[slot - first_slot] += 1
    longest = 0
    for slot in range(first_slot, end_slot):
        longest = max(longest, starts[slot + 1] - starts[slot])
    spare_heights = np.empty(longest, np.float64)
    spare_rows = np.empty(longest, np.int64)
    for slot in range(first_slot, end_slot):
        _sort_column(heights, rows, starts[slot], starts[slot + 1], spare_heights, spare_rows)


# NumPy's sorts are slow to compile, and one that moves the rows along needs another array of them.
@helper
def _sort_column(
    heights: Floats,
    rows: Integers,
    first: int,
    end: int,
    spare_heights: Floats,
    spare_rows: Integers,
) -> None:
    """Sort by height: short runs by insertion, then merged two by two."""
    for run in range(first, end, _RUN):
        for place in range(run + 1, min(run + _RUN, end)):
            height, row = heights[place], rows[place]
            free = place
            while free > run and heights[free - 1] > height:
                heights[free], rows[free] = heights[free - 1], rows[free - 1]
                free -= 1
            heights[free], rows[free] = height, row
    length = _RUN
    while length < end - first:
        for left in range(first, end - length, 2 * length):
            _merge(
                heights,
                rows,
                left,
                left + length,
                min(left + 2 * length, end),
                spare_heights,
                spare_rows,
            )
        length *= 2


@helper
def _merge(
    heights: Floats,
    rows: Integers,
    left: int,
    right: int,
    end: int,
    spare_heights: Floats,
    spare_rows: Integers,
) -> None:
    """Merge two neighbouring runs; the left one is put aside."""
    if heights[right - 1] <= heights[right]:
        return
    count = right - left
    for place in range(count):
        spare_heights[place] = heights[left + place]
        spare_rows[place] = rows[left + place]
    taken, place = 0, left
    while taken < count:
        if right < end and heights[right] < spare_heights[taken]:
            heights[place], rows[place] = heights[right], rows[right]
            right += 1
        else:
            heights[place], rows[place] = spare_heights[taken], spare_rows[taken]
            taken += 1
        place += 1


@helper
def first_from(heights: Floats, first: int, end: int, height: float) -> int:
    """Return the first place in a sorted range with at least this height, or its end."""
    while first < end:
        middle = (first + end) >> 1
        if heights[middle] < height:
            first = middle + 1
        else:
            end = middle
    return first


@helper
def first_above(heights: Floats, first: int, end: int, height: float) -> int:
    """Return the first place in a sorted range above this height, or its end."""
    while first < end:
        middle = (first + end) >> 1
        if heights[middle] <= height:
            first = middle + 1
        else:
            end = middle
    return first
