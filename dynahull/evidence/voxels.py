"""Voxels of a lattice anchored at the origin of the coordinates, and the sums that they hold.

A point falls into the same voxel whatever else is in the map, and what is summed are integers: so
the voxels of a map are those of its parts, added up, to the last bit.
"""

import math
from collections.abc import Sequence
from functools import cached_property
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, helper, inlined
from dynahull.summary import Summary

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Cells = npt.NDArray[np.int32]

FARTHEST_CELL = 2.0**30
"""Cells beyond it are one: their numbers, and those of cells around them, fit 32 bits."""


class Voxels(Summary):
    """The occupied voxels of a lattice in the order of their cells, and sums over their points.

    What is summed are integers, so that no order of adding them changes a bit.
    """

    marks: ClassVar[int] = 0
    """How many of the last columns are sets of bits: these are united, not added."""

    @property
    def sums(self) -> Integers:
        """The sums, (V, C) int64."""
        return self.values

    @classmethod
    def of(cls, cells: Cells, values: Integers) -> Self:
        """Add up values by cell.

        Parameters
        ----------
        cells : (n, 3) int32 array
            In any order; a cell may come many times.
        values : (n, C) int64 array
        """
        return cls.merged([cls(cells, values)])

    @classmethod
    def merged(cls, parts: Sequence[Self]) -> Self:
        """Add up the voxels of parts of a map, at least one; a cell may come many times."""
        kind, columns = type(parts[0]), parts[0].sums.shape[1]
        cells, numbers = unique_cells(np.concatenate([part.cells for part in parts]))
        sums, first = np.zeros((len(cells), columns), np.int64), 0
        for part in parts:
            add_to(sums, part.sums, numbers[first : first + len(part)], kind.marks)
            first += len(part)
        return kind(cells, sums)

    @cached_property
    def table(self) -> npt.NDArray[np.int32]:
        """Where each voxel is found by its cell: see `find_cell`."""
        return _table_of(self.cells)

    def coarser(self) -> tuple[Self, npt.NDArray[np.int32]]:
        """Return the voxels of twice the side, and in which of them each of these lies."""
        cells, numbers = unique_cells(self.cells >> 1)
        return type(self)(cells, added(self.sums, numbers, len(cells), self.marks)), numbers

    def around(self, wanted: npt.NDArray[np.bool_] | None = None) -> Integers:
        """Return sums over the 3 x 3 x 3 voxels about each that is wanted, else zeros, (V, C)."""
        if wanted is None:
            wanted = np.ones(len(self), np.bool_)
        return _sums_around(self.cells, self.sums, wanted, self.marks)

    def connected(self) -> npt.NDArray[np.intp]:
        """Return the group of each voxel, (V,): those that touch, by a corner at least, are one."""
        _, groups = np.unique(_first_touching(self.cells, self.table), return_inverse=True)
        return np.asarray(groups)


def cells_of(points: Floats, side: float) -> Cells:
    """Return the cell of each point, (n, 3)."""
    cells = np.empty((len(points), 3), np.int32)
    _find_cells(points, side, cells)
    return cells


@compiled
def _find_cells(points: Floats, side: float, cells: Cells) -> None:
    for i in range(len(points)):
        for axis in range(3):
            cell = np.floor(points[i, axis] / side)
            cells[i, axis] = np.int32(min(max(cell, -FARTHEST_CELL), FARTHEST_CELL))


def unique_cells(cells: Cells) -> tuple[Cells, npt.NDArray[np.int32]]:
    """Return the cells that come, each once and in order, and which of them each that came is."""
    firsts, numbers = _numbered(cells, order_of(cells))
    return cells[firsts], numbers


def order_of(cells: Cells) -> npt.NDArray[np.intp]:
    """Return where the cells are that come first, second and so on."""
    if not len(cells):
        return np.zeros(0, np.intp)
    low = np.array([axis.min() for axis in cells.T], np.int64)
    spans = np.array([axis.max() for axis in cells.T], np.int64) - low + 1
    if math.prod(spans.tolist()) >= 2**63:
        return np.lexsort(cells.T[::-1])
    return np.argsort(_keys(cells, low, spans))


@compiled
def _keys(cells: Cells, low: Integers, spans: Integers) -> Integers:
    keys = np.empty(len(cells), np.int64)
    for n in range(len(cells)):
        i, j, k = cells[n, 0] - low[0], cells[n, 1] - low[1], cells[n, 2] - low[2]
        keys[n] = (i * spans[1] + j) * spans[2] + k
    return keys


@compiled
def _numbered(cells: Cells, order: npt.NDArray[np.intp]) -> tuple[Integers, npt.NDArray[np.int32]]:
    firsts = np.empty(len(order), np.int64)
    numbers = np.empty(len(order), np.int32)
    count = 0
    for n in range(len(order)):
        this, before = order[n], order[n - 1]
        same = n > 0
        for axis in range(3):
            same &= cells[this, axis] == cells[before, axis]
        if not same:
            firsts[count] = this
            count += 1
        numbers[this] = count - 1
    return firsts[:count].copy(), numbers


def added(values: Integers, numbers: npt.NDArray[np.int32], count: int, marks: int) -> Integers:
    """Add up rows of values by number, and unite the bits of the last columns, (count, C)."""
    sums = np.zeros((count, values.shape[1]), np.int64)
    add_to(sums, values, numbers, marks)
    return sums


@compiled
def add_to(sums: Integers, values: Integers, numbers: npt.NDArray[np.int32], marks: int) -> None:
    """Add rows of values to the sums of their numbers; see `added`."""
    added = values.shape[1] - marks
    for i in range(len(values)):
        for column in range(added):
            sums[numbers[i], column] += values[i, column]
        for column in range(added, values.shape[1]):
            sums[numbers[i], column] |= values[i, column]


@inlined
def hash_of(i: int, j: int, k: int) -> int:
    """Mix the numbers of a cell (Teschner et al. 2003, and Knuth's multiplicative hashing)."""
    mixed = (i * 73856093) ^ (j * 19349663) ^ (k * 83492791)
    return (mixed * 0x1E3779B97F4A7C15) >> 32


@compiled
def _table_of(cells: Cells) -> npt.NDArray[np.int32]:
    size = 16
    while size < 2 * len(cells):
        size *= 2
    table = np.full(size, -1, np.int32)
    for number in range(len(cells)):
        place = hash_of(cells[number, 0], cells[number, 1], cells[number, 2]) & (size - 1)
        while table[place] >= 0:
            place = (place + 1) & (size - 1)
        table[place] = np.int32(number)
    return table


@helper
def find_cell(i: int, j: int, k: int, cells: Cells, table: npt.NDArray[np.int32]) -> int:
    """Return the number of a voxel, -1 where it is empty."""
    place = hash_of(i, j, k) & (len(table) - 1)
    while True:
        number = table[place]
        if number < 0:
            return -1
        if cells[number, 0] == i and cells[number, 1] == j and cells[number, 2] == k:
            return int(number)
        place = (place + 1) & (len(table) - 1)


@compiled
def _sums_around(
    cells: Cells, sums: Integers, wanted: npt.NDArray[np.bool_], marks: int
) -> Integers:
    """Add up the sums of voxels that touch, each pair of them once."""
    around = np.zeros(sums.shape, np.int64)
    added = sums.shape[1] - marks
    for column in range(4, 9):  # of the nine columns of voxels about one, those not behind it
        di, dj = column // 3 - 1, column % 3 - 1
        lowest = 0
        for one in range(len(cells)):
            i, j, k = cells[one, 0] + di, cells[one, 1] + dj, cells[one, 2] - 1
            while lowest < len(cells) and _is_before(cells[lowest], i, j, k):
                lowest += 1
            other = one if column == 4 else lowest
            while (
                other < len(cells)
                and cells[other, 0] == i
                and cells[other, 1] == j
                and cells[other, 2] <= k + 2
            ):
                if wanted[one]:
                    _add(around[one], sums[other], added)
                if wanted[other] and other != one:
                    _add(around[other], sums[one], added)
                other += 1
    return around


@inlined
def _is_before(cell: Cells, i: int, j: int, k: int) -> bool:
    if cell[0] != i:
        return bool(cell[0] < i)
    return bool(cell[1] < j or (cell[1] == j and cell[2] < k))


@inlined
def _add(sums: Integers, more: Integers, added: int) -> None:
    for column in range(added):
        sums[column] += more[column]
    for column in range(added, len(sums)):
        sums[column] |= more[column]


@compiled
def _first_touching(cells: Cells, table: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Return the first voxel of the group that each voxel is in (union-find)."""
    parent = np.arange(len(cells)).astype(np.int32)
    for number in range(len(cells)):
        i, j, k = cells[number, 0], cells[number, 1], cells[number, 2]
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(-1, 2):
                    other = find_cell(i + di, j + dj, k + dk, cells, table)
                    if other < 0:
                        continue
                    one = _root(parent, number)
                    other = _root(parent, other)
                    parent[max(one, other)] = min(one, other)
    for number in range(len(cells)):
        parent[number] = _root(parent, number)
    return parent


@helper
def _root(parent: npt.NDArray[np.int32], number: int) -> int:
    while parent[number] != number:
        parent[number] = parent[parent[number]]
        number = parent[number]
    return number
