"""The points of a map column by column, each from its lowest point up, and their levels.

Levels are layers of points with free height above them.
"""

from functools import partial
from typing import NamedTuple

import numpy as np

from dynahull.compilation import compiled, helper
from dynahull.ground.lattice import Booleans, Floats, Integers, Lattice, number_columns, starts_of
from dynahull.summary import Summary
from dynahull.threads import group_bounds, over_ranges

_SMALLEST_RANGE = 20_000
"""Points."""

_FEWEST_FOR_SPREAD = 3


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
    numbers, cells = number_columns(points, cell)
    starts = starts_of(numbers, len(cells))

    sort = partial(_sorted_rows, points[:, 2].copy(), numbers, starts)
    bounds = group_bounds(starts, threads, _SMALLEST_RANGE)
    rows = np.concatenate(over_ranges(sort, bounds, threads))
    return Columns(points[rows, 2], rows, starts, cells)


@compiled
def _sorted_rows(
    heights: Floats, numbers: Integers, starts: Integers, first_column: int, end_column: int
) -> Integers:
    """Return the points of a range of columns by column, by height, and then by row."""
    begin = starts[first_column]
    rows = np.empty(starts[end_column] - begin, np.int64)
    place = starts[first_column:end_column] - begin
    for row in range(len(numbers)):
        column = numbers[row] - first_column
        if 0 <= column < len(place):
            rows[place[column]] = row
            place[column] += 1
    for column in range(first_column, end_column):
        own = rows[starts[column] - begin : starts[column + 1] - begin]
        own[:] = own[np.argsort(heights[own], kind="mergesort")]
    return rows


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


class Levels(NamedTuple):
    """Levels sorted by column, ascending within a column."""

    heights: Floats
    """Mean height of a level's points, metres, (L,)."""
    spreads: Floats
    """Standard deviation of their heights, metres, (L,); -1 where there are fewer than three."""
    slots: Integers
    """Slot of the level's column, (L,)."""
    bare: Booleans
    """Whether the level is the lowest of its column and has free height above it, (L,)."""

    def keep(self, mask: Booleans) -> "Levels":
        """Return the levels where `mask` holds."""
        return Levels(self.heights[mask], self.spreads[mask], self.slots[mask], self.bare[mask])


def levels_of(summary: Summary, lattice: Lattice) -> Levels:
    """Return the levels that were found in the columns of a lattice, whose cells are theirs."""
    order = np.argsort(lattice.slots, kind="stable")
    heights, spreads, bare = summary.values[order].T.copy()
    return Levels(heights, spreads, lattice.slots[order], bare > 0)


def find_levels(
    columns: Columns, thickness: float, clearance: float, clutter: float, threads: int = 1
) -> Summary:
    """Find the levels of every column.

    Of each, mean and spread of its heights, and whether it is the lowest of its column and has free
    height above it: see `Levels`.

    A level is a layer of at most `thickness` metres above whose top the next `clearance` metres
    hold no more than `clutter` times its own points; of layers that overlap the fullest stands,
    the lowest if equal. The lowest layer of a column is a level in any case: what stands on a
    floor hides none of the lowest floor.
    """
    find = partial(_find_levels, columns.heights, columns.starts, thickness, clearance, clutter)
    found = over_ranges(find, columns.bounds(threads), threads)
    heights, spreads, numbers, bare = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return Summary(columns.cells[numbers], np.column_stack([heights, spreads, bare]))


@compiled
def _find_levels(
    columns: Floats,
    starts: Integers,
    thickness: float,
    clearance: float,
    clutter: float,
    first_column: int,
    end_column: int,
) -> tuple[Floats, Floats, Integers, Booleans]:
    most = starts[end_column] - starts[first_column]
    heights = np.empty(most, np.float64)
    spreads = np.empty(most, np.float64)
    numbers = np.empty(most, np.int64)
    bare = np.empty(most, np.bool_)
    found = 0
    for column in range(first_column, end_column):
        first, end = starts[column], starts[column + 1]
        top = first
        while top < end and columns[top] <= columns[first] + thickness:
            top += 1
        kept_first, kept_top, kept_bare = first, top, False
        top, above = first, first
        for bottom in range(first, end):
            while top < end and columns[top] <= columns[bottom] + thickness:
                top += 1
            above = max(above, top)
            while above < end and columns[above] <= columns[top - 1] + clearance:
                above += 1
            if above - top > clutter * (top - bottom):
                continue
            if columns[bottom] > columns[kept_top - 1]:
                heights[found], spreads[found] = _mean_and_spread(columns, kept_first, kept_top)
                numbers[found], bare[found] = column, kept_bare
                found += 1
                kept_first, kept_top, kept_bare = bottom, top, False
            elif top - bottom > kept_top - kept_first:
                kept_first, kept_top = bottom, top
            kept_bare = kept_bare or bottom == first
        heights[found], spreads[found] = _mean_and_spread(columns, kept_first, kept_top)
        numbers[found], bare[found] = column, kept_bare
        found += 1
    return heights[:found], spreads[:found], numbers[:found], bare[:found]


@helper
def _mean_and_spread(heights: Floats, first: int, end: int) -> tuple[float, float]:
    # relative to the lowest point: the result does not lose digits far from z = 0
    lowest = heights[first]
    total = 0.0
    squares = 0.0
    for place in range(first, end):
        rise = heights[place] - lowest
        total += rise
        squares += rise * rise
    mean = total / (end - first)
    if end - first < _FEWEST_FOR_SPREAD:
        return lowest + mean, -1.0
    return lowest + mean, np.sqrt(max(squares / (end - first) - mean * mean, 0.0))
