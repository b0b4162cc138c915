"""A square lattice in the horizontal plane, anchored at the origin of the coordinates.

Cell (i, j) holds the points with i <= x / cell < i + 1 and j <= y / cell < j + 1, so a point falls
into the same cell whatever else is in the map. Cells are stored in blocks of 16 x 16; only blocks
that hold a point exist, so a stray point a million metres away costs one block.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from numba import types
from numba.typed import Dict

from dynahull.compilation import compiled, inlined

__all__ = [
    "Booleans",
    "Floats",
    "Integers",
    "Lattice",
    "build_lattice",
    "disk_offsets",
    "distances_of",
    "slot_at",
    "sort_heights",
    "starts_of",
]

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Booleans = npt.NDArray[np.bool_]

BLOCK_BITS = 4
"""Cells along the side of a block, as a power of two."""

BLOCK = 1 << BLOCK_BITS
_SLOTS_PER_BLOCK = BLOCK * BLOCK
_KEY_BITS = 32
_HALF_KEY = 1 << (_KEY_BITS - 1)
_LOWER_KEY = (1 << _KEY_BITS) - 1
_FARTHEST_CELL = 2.0**34
"""Cells beyond it are one: block coordinates, and a window about them, fit half a key."""


class Lattice(NamedTuple):
    """The occupied part of the lattice and the cell of every point.

    A cell is addressed by its slot: its place among the cells of the blocks that exist.
    """

    cell: float
    """Side of a cell, metres."""
    slots: Integers
    """Slot of each point, (N,)."""
    blocks: Integers
    """Block coordinates, (B, 2)."""
    neighbours: Integers
    """Blocks around each block, (B, 2 s + 1, 2 s + 1); -1 where none exists."""

    @property
    def slot_count(self) -> int:
        """Number of slots, those of empty cells included."""
        return len(self.blocks) * _SLOTS_PER_BLOCK


def build_lattice(points: Floats, cell: float, reach: float) -> Lattice:
    """Sort points into the cells of a lattice.

    Parameters
    ----------
    points : (N, 2 or more) float64 array
        Finite coordinates, metres; x and y are used.
    cell : float
        Side of a cell, metres.
    reach : float
        Metres; the widest window that will be read about a cell.
    """
    cells = np.floor(points[:, :2] / cell)
    np.clip(cells, -_FARTHEST_CELL, _FARTHEST_CELL, out=cells)
    span = int(np.ceil(reach / cell)) // BLOCK + 1
    slots, blocks, neighbours = _index_cells(cells, span)
    return Lattice(cell, slots, blocks, neighbours)


@compiled
def _index_cells(cells: Floats, span: int) -> tuple[Integers, Integers, Integers]:
    """Find the slot of each point, blocks being numbered as they appear, and their neighbours."""
    known = Dict.empty(types.int64, types.int64)
    slots = np.empty(len(cells), np.int64)
    last = np.int64(0)
    block = np.int64(-1)
    for point in range(len(cells)):
        i = np.int64(cells[point, 0])
        j = np.int64(cells[point, 1])
        key = _block_key(i >> BLOCK_BITS, j >> BLOCK_BITS)
        if block < 0 or key != last:
            block = known.get(key, np.int64(-1))
            if block < 0:
                block = np.int64(len(known))
                known[key] = block
            last = key
        slots[point] = block * _SLOTS_PER_BLOCK + (i & (BLOCK - 1)) * BLOCK + (j & (BLOCK - 1))
    blocks = np.empty((len(known), 2), np.int64)
    for key, number in known.items():
        blocks[number, 1] = ((key + _HALF_KEY) & _LOWER_KEY) - _HALF_KEY
        blocks[number, 0] = (key - blocks[number, 1]) >> _KEY_BITS
    width = 2 * span + 1
    neighbours = np.full((len(known), width, width), -1, np.int64)
    for number in range(len(blocks)):
        for a in range(width):
            for b in range(width):
                key = _block_key(blocks[number, 0] + a - span, blocks[number, 1] + b - span)
                neighbours[number, a, b] = known.get(key, np.int64(-1))
    return slots, blocks, neighbours


@compiled
def _block_key(i: int, j: int) -> int:
    """Put block coordinates into one integer: a pair takes longer to hash, and to compile."""
    return (i << _KEY_BITS) + j


@inlined
def slot_at(slot: int, di: int, dj: int, neighbours: Integers) -> int:
    """Return the slot of the cell (di, dj) away from the cell of `slot`, or -1."""
    span = neighbours.shape[1] // 2
    block = slot // _SLOTS_PER_BLOCK
    local = slot - block * _SLOTS_PER_BLOCK
    i = local // BLOCK + di
    j = local % BLOCK + dj
    other: int = neighbours[block, (i >> BLOCK_BITS) + span, (j >> BLOCK_BITS) + span]
    if other < 0:
        return -1
    return other * _SLOTS_PER_BLOCK + (i & (BLOCK - 1)) * BLOCK + (j & (BLOCK - 1))


def starts_of(slots: Integers, slot_count: int) -> Integers:
    """Where each slot's entries begin in an array sorted by slot, (slot_count + 1,)."""
    starts = np.zeros(slot_count + 1, np.int64)
    np.cumsum(np.bincount(slots, minlength=slot_count), out=starts[1:])
    return starts


@compiled
def sort_heights(heights: Floats, slots: Integers, starts: Integers) -> Floats:
    """Return the heights column by column, ascending within each."""
    place = starts[:-1].copy()
    columns = np.empty(len(heights), np.float64)
    for point in range(len(heights)):
        columns[place[slots[point]]] = heights[point]
        place[slots[point]] += 1
    for slot in range(len(starts) - 1):
        if starts[slot + 1] - starts[slot] > 1:
            columns[starts[slot] : starts[slot + 1]].sort()
    return columns


def disk_offsets(radius: float) -> Integers:
    """Cell offsets within `radius` cells, nearest first, (M, 2); the first is (0, 0)."""
    side = int(np.floor(radius))
    i, j = np.mgrid[-side : side + 1, -side : side + 1]
    offsets = np.column_stack([i.ravel(), j.ravel()]).astype(np.int64)
    squared = (offsets**2).sum(axis=1)
    order = np.lexsort([offsets[:, 1], offsets[:, 0], squared])
    return offsets[order][squared[order] <= radius * radius]


def distances_of(offsets: Integers, cell: float) -> Floats:
    """Lengths of cell offsets, metres."""
    squared: Floats = (offsets**2).sum(axis=1).astype(np.float64)
    return cell * np.sqrt(squared)
