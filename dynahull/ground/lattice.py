"""A square lattice in the horizontal plane, anchored at the origin of the coordinates.

Cell (i, j) holds the points with i <= x / cell < i + 1 and j <= y / cell < j + 1, so a point falls
into the same cell whatever else is in the map. Cells are stored in blocks of 16 x 16; only blocks
that hold a point exist, so a stray point a million metres away costs one block.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, helper, inlined
from dynahull.threads import over_ranges, range_bounds

Floats = npt.NDArray[np.float64]
Integers = npt.NDArray[np.int64]
Booleans = npt.NDArray[np.bool_]

BLOCK_BITS = 4
"""Cells along the side of a block, as a power of two."""

BLOCK = 1 << BLOCK_BITS
_SLOT_BITS = 2 * BLOCK_BITS
_SLOTS_PER_BLOCK = 1 << _SLOT_BITS
_KEY_BITS = 32
_HALF_KEY = 1 << (_KEY_BITS - 1)
_LOWER_KEY = (1 << _KEY_BITS) - 1
_NO_KEY = np.iinfo(np.int64).min
_FIRST_TABLE = 256
_SMALLEST_RANGE = 20_000
"""Points."""

FARTHEST_CELL = 2.0**34
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
    """Block coordinates, ascending, (B, 2)."""
    neighbours: Integers
    """First slots of the blocks around each block, (B, 2 s + 1, 2 s + 1).

    Blocks that do not exist share one more block, the last, which holds no point.
    """

    @property
    def slot_count(self) -> int:
        """Number of slots, those of empty cells included."""
        return (len(self.blocks) + 1) * _SLOTS_PER_BLOCK


def build_lattice(points: Floats, cell: float, reach: float, threads: int = 1) -> Lattice:
    """Sort points into the cells of a lattice.

    Parameters
    ----------
    points : (N, 2 or more) float64 array
        Finite coordinates, metres; x and y are used.
    reach : float
        Metres; the widest window that will be read about a cell.
    """
    slots = np.empty(len(points), np.int64)
    bounds = range_bounds(len(points), threads, _SMALLEST_RANGE)
    found = over_ranges(
        lambda first, end: _find_blocks(points, cell, first, end, slots), bounds, threads
    )
    keys, numbers = np.unique(np.concatenate(found), return_inverse=True)
    # each range has numbered its blocks as they came
    parts = dict(
        zip(bounds, np.split(numbers, np.cumsum([len(part) for part in found])), strict=True)
    )
    over_ranges(
        lambda first, end: _renumber_blocks(slots, parts[first], first, end), bounds, threads
    )
    blocks = np.empty((len(keys), 2), np.int64)
    blocks[:, 1] = ((keys + _HALF_KEY) & _LOWER_KEY) - _HALF_KEY
    blocks[:, 0] = (keys - blocks[:, 1]) >> _KEY_BITS
    return Lattice(cell, slots, blocks, _neighbours(keys, int(np.ceil(reach / cell)) // BLOCK + 1))


def lattice_of_cells(cells: Integers, cell: float, reach: float) -> Lattice:
    """Return the lattice of some cells, (n, 2), which may come several times, and their slots."""
    lattice = build_lattice(cells.astype(np.float64), 1.0, reach / cell)
    return lattice._replace(cell=cell)


def number_columns(points: Floats, cell: float, threads: int = 1) -> tuple[Integers, Integers]:
    """Return the number of each point's cell among those occupied, (N,), and these, (M, 2)."""
    lattice = build_lattice(points, cell, 0.0, threads)
    occupied = np.zeros(lattice.slot_count, np.bool_)
    occupied[lattice.slots] = True
    slots = np.flatnonzero(occupied)
    within = np.column_stack([(slots >> BLOCK_BITS) & (BLOCK - 1), slots & (BLOCK - 1)])
    cells = (lattice.blocks[slots >> _SLOT_BITS] << BLOCK_BITS) + within
    return (np.cumsum(occupied) - 1)[lattice.slots], cells


def _neighbours(keys: Integers, span: int) -> Integers:
    """Find the first slots of the blocks up to `span` away from each block."""
    along = np.arange(-span, span + 1)
    wanted = keys[:, None, None] + (along[:, None] << _KEY_BITS) + along
    blocks = np.searchsorted(keys, wanted)
    known = np.append(keys, _NO_KEY)
    blocks[known[blocks] != wanted] = len(keys)
    return blocks << _SLOT_BITS


@compiled
def _find_blocks(points: Floats, cell: float, first: int, end: int, slots: Integers) -> Integers:
    """Return the keys of the blocks of a range of points, in the order they appear.

    They are found in a table by a hash of the key. A slot says the cell within the block and,
    until the blocks of all ranges are known, the block's place among those of this range.
    """
    keys = np.empty(_FIRST_TABLE // 2, np.int64)
    table = _empty_table(_FIRST_TABLE)
    found = 0
    last, block = np.int64(_NO_KEY), 0
    for point in range(first, end):
        i = cell_of(points[point, 0], cell)
        j = cell_of(points[point, 1], cell)
        key = _block_key(i >> BLOCK_BITS, j >> BLOCK_BITS)
        if key != last:
            last = key
            if found == len(keys):
                keys, table = _enlarged(keys)
            place = _place_of(key, keys, table)
            if table[place] < 0:
                keys[found] = key
                table[place] = found
                found += 1
            block = table[place]
        slots[point] = (block << _SLOT_BITS) + ((i & (BLOCK - 1)) << BLOCK_BITS) + (j & (BLOCK - 1))
    return keys[:found]


@helper
def _place_of(key: int, keys: Integers, table: Integers) -> int:
    """Where a key stands in the table, or may be put: the first place free after its hash."""
    place = _hash(key) & (len(table) - 1)
    while table[place] >= 0 and keys[table[place]] != key:
        place = (place + 1) & (len(table) - 1)
    return place


@helper
def _empty_table(size: int) -> Integers:
    table = np.empty(size, np.int64)
    for place in range(size):
        table[place] = -1
    return table


@helper
def _enlarged(keys: Integers) -> tuple[Integers, Integers]:
    larger = np.empty(2 * len(keys), np.int64)
    table = _empty_table(4 * len(keys))
    for number in range(len(keys)):
        larger[number] = keys[number]
        table[_place_of(keys[number], larger, table)] = number
    return larger, table


@inlined
def _hash(key: int) -> int:
    # Fibonacci hashing (Knuth, volume 3, section 6.4); the high bits are the mixed ones.
    return (key * 0x1E3779B97F4A7C15) >> 32


@compiled
def _renumber_blocks(slots: Integers, numbers: Integers, first: int, end: int) -> None:
    for point in range(first, end):
        block = numbers[slots[point] >> _SLOT_BITS]
        slots[point] = (block << _SLOT_BITS) + (slots[point] & (_SLOTS_PER_BLOCK - 1))


@inlined
def cell_of(coordinate: float, cell: float) -> int:
    """Return the cell along one axis."""
    return int(min(max(np.floor(coordinate / cell), -FARTHEST_CELL), FARTHEST_CELL))


@inlined
def _block_key(i: int, j: int) -> int:
    return (i << _KEY_BITS) + j


@inlined
def slot_at(slot: int, di: int, dj: int, neighbours: Integers) -> int:
    """Return the slot of the cell (di, dj) away from the cell of `slot`."""
    span = neighbours.shape[1] >> 1
    i = ((slot >> BLOCK_BITS) & (BLOCK - 1)) + di
    j = (slot & (BLOCK - 1)) + dj
    first = neighbours[slot >> _SLOT_BITS, (i >> BLOCK_BITS) + span, (j >> BLOCK_BITS) + span]
    return first + ((i & (BLOCK - 1)) << BLOCK_BITS) + (j & (BLOCK - 1))


def starts_of(slots: Integers, slot_count: int) -> Integers:
    """Where each slot's entries begin in an array sorted by slot, (slot_count + 1,)."""
    starts = np.zeros(slot_count + 1, np.int64)
    np.cumsum(np.bincount(slots, minlength=slot_count), out=starts[1:])
    return starts


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
