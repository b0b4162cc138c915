"""A square lattice in the horizontal plane, anchored at the origin of the coordinates.

Cell (i, j) holds the points with i <= x / cell < i + 1 and j <= y / cell < j + 1, so a point falls
into the same cell whatever else is in the map. Cells are stored in blocks of 16 x 16; only blocks
that hold a point exist, so a stray point a million metres away costs one block.
"""

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from dynahull.compilation import inlined

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


def build_lattice(points: Floats, cell: float, reach: float) -> Lattice:
    """Sort points into the cells of a lattice.

    Parameters
    ----------
    points : (N, 2 or more) float64 array
        Finite coordinates, metres; x and y are used.
    reach : float
        Metres; the widest window that will be read about a cell.
    """
    i, j = (
        np.clip(np.floor(points[:, axis] / cell), -FARTHEST_CELL, FARTHEST_CELL).astype(np.int64)
        for axis in range(2)
    )
    keys, numbers = _unique(((i >> BLOCK_BITS) << _KEY_BITS) + (j >> BLOCK_BITS))
    within = ((i & (BLOCK - 1)) << BLOCK_BITS) + (j & (BLOCK - 1))
    blocks = np.empty((len(keys), 2), np.int64)
    blocks[:, 1] = ((keys + _HALF_KEY) & _LOWER_KEY) - _HALF_KEY
    blocks[:, 0] = (keys - blocks[:, 1]) >> _KEY_BITS
    span = int(np.ceil(reach / cell)) // BLOCK + 1
    return Lattice(cell, (numbers << _SLOT_BITS) + within, blocks, _neighbours(keys, span))


def lattice_of_cells(cells: Integers, cell: float, reach: float) -> Lattice:
    """Return the lattice of some cells, (n, 2), which may come several times, and their slots."""
    lattice = build_lattice(cells.astype(np.float64), 1.0, reach / cell)
    return lattice._replace(cell=cell)


def number_columns(points: Floats, cell: float) -> tuple[Integers, Integers]:
    """Return the number of each point's cell among those occupied, (N,), and these, (M, 2)."""
    lattice = build_lattice(points, cell, 0.0)
    occupied = np.zeros(lattice.slot_count, np.bool_)
    occupied[lattice.slots] = True
    slots = np.flatnonzero(occupied)
    within = np.column_stack([(slots >> BLOCK_BITS) & (BLOCK - 1), slots & (BLOCK - 1)])
    cells = (lattice.blocks[slots >> _SLOT_BITS] << BLOCK_BITS) + within
    return (np.cumsum(occupied) - 1)[lattice.slots], cells


def _unique(keys: Integers) -> tuple[Integers, Integers]:
    """Return the keys that come, ascending, and which of them each is: runs are sorted as one."""
    starts = np.flatnonzero(np.diff(keys, prepend=keys[:1] - 1))
    found, numbers = np.unique(keys[starts], return_inverse=True)
    return found, np.repeat(numbers, np.diff(starts, append=len(keys)))


def _neighbours(keys: Integers, span: int) -> Integers:
    """Find the first slots of the blocks up to `span` away from each block."""
    along = np.arange(-span, span + 1)
    wanted = keys[:, None, None] + (along[:, None] << _KEY_BITS) + along
    blocks = np.searchsorted(keys, wanted)
    known = np.append(keys, _NO_KEY)
    blocks[known[blocks] != wanted] = len(keys)
    return blocks << _SLOT_BITS


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
