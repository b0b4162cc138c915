"""The points of a map column by column, each from its lowest point up."""

from typing import NamedTuple

import numpy as np

from dynahull.compilation import compiled, helper
from dynahull.ground.lattice import Booleans, Floats, Integers, number_columns, starts_of
from dynahull.threads import group_bounds, over_ranges

_SMALLEST_RANGE = 20_000
"""Points."""

_RUN = 16
"""Points that are sorted by insertion."""


class Columns(NamedTuple):
    """Points ordered by column, and by height within a column."""

    heights: Floats
    """Metres, (N,)."""
    rows: Integers
    """Which point it is, (N,)."""
    starts: Integers
    """Where each column begins, (M + 1,); none is empty."""
    cells: Integers
    """Which cell each is, (M, 2)."""

    def bounds(self, threads: int) -> list[int]:
        """Cut the columns into ranges with equally many points; see `over_ranges`."""
        return group_bounds(self.starts, threads, _SMALLEST_RANGE)

    def begun_in(self, core: Booleans) -> "Columns":
        """Return the columns whose first point by row, (N,), is in the core of a tile.

        So of the tiles that know a column as a whole, just one speaks of it.
        """
        if not len(self.cells):
            return self
        own = core[np.minimum.reduceat(self.rows, self.starts[:-1])]
        counts = np.diff(self.starts)
        points = np.repeat(own, counts)
        starts = np.append(0, np.cumsum(counts[own]))
        return Columns(self.heights[points], self.rows[points], starts, self.cells[own])


def sort_columns(points: Floats, cell: float, threads: int = 1) -> Columns:
    """Sort points, (N, 3), by their cell and their height, all in metres."""
    numbers, cells = number_columns(points, cell, threads)
    starts = starts_of(numbers, len(cells))
    columns = Columns(np.empty(len(points)), np.empty(len(points), np.int64), starts, cells)
    over_ranges(
        lambda first, end: _sort_columns(points, numbers, *columns[:3], first, end),
        columns.bounds(threads),
        threads,
    )
    return columns


@compiled
def _sort_columns(
    points: Floats,
    numbers: Integers,
    heights: Floats,
    rows: Integers,
    starts: Integers,
    first_column: int,
    end_column: int,
) -> None:
    """Fill a range of columns: every thread reads all numbers and writes its own columns."""
    place = starts[first_column:end_column].copy()
    for point in range(len(numbers)):
        column = numbers[point]
        if first_column <= column < end_column:
            heights[place[column - first_column]] = points[point, 2]
            rows[place[column - first_column]] = point
            place[column - first_column] += 1
    longest = 0
    for column in range(first_column, end_column):
        longest = max(longest, starts[column + 1] - starts[column])
    spare_heights = np.empty(longest, np.float64)
    spare_rows = np.empty(longest, np.int64)
    for column in range(first_column, end_column):
        first, end = starts[column], starts[column + 1]
        _sort_column(heights, rows, first, end, spare_heights, spare_rows)


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
