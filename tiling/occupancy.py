"""Where the points of a map are: counts on a sparse square lattice, as coarse as memory demands.

The lattice is anchored at the coordinates' origin. Its cells are a power of two wide, so that the
column of a point is exact, and the columns of a coarser lattice are those of a finer one halved.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiling.compiled import compiled, helper

FINEST_CELL = 0.25
"""Side of a column of the occupancy lattice, metres, before any coarsening."""

MOST_COLUMNS = 2_000_000
"""Occupied columns beyond which the lattice is coarsened to cells twice as wide."""

FARTHEST = 2.0**38
"""Metres from the origin; points beyond are counted in the column at the edge."""

_FIRST_CAPACITY = 1 << 12
_FIRST_MULTIPLIER = np.int64(-7046029254386353131)  # 2^64 / golden ratio, as int64
_SECOND_MULTIPLIER = np.int64(-4417276706812531889)  # a prime of xxHash, as int64

Columns = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Occupancy:
    """Points in each occupied column of a square lattice anchored at the coordinates' origin.

    Attributes
    ----------
    cell : float
        Side of a column, metres: `FINEST_CELL` times a power of two.
    columns : (M, 2) int64 array
        floor(x / cell), floor(y / cell) of the occupied columns, in lexicographic order.
    counts : (M,) int64 array
    """

    cell: float
    columns: Columns
    counts: NDArray[np.int64]

    def without(self, xyz: NDArray[np.float64]) -> "Occupancy":
        """Return the occupancy without some of the points that it counts, few of them."""
        counts = self.counts.copy()
        for x, y in columns_of(xyz, self.cell).tolist():
            first, end = np.searchsorted(self.columns[:, 0], [x, x + 1])
            counts[first + np.searchsorted(self.columns[first:end, 1], y)] -= 1
        occupied = counts > 0
        return Occupancy(self.cell, self.columns[occupied], counts[occupied])


def columns_of(xyz: NDArray[np.float64], cell: float) -> Columns:
    """Return the lattice column of each point: floor(x / cell), floor(y / cell).

    Parameters
    ----------
    xyz : (n, 3) float64 array
        Finite coordinates, metres.
    cell : float
        Side of a column, metres; a power of two, so that the division is exact.

    Returns
    -------
    (n, 2) int64 array
        Points beyond `FARTHEST` are in the column at the edge.
    """
    return np.floor(np.clip(xyz[:, :2], -FARTHEST, FARTHEST) / cell).astype(np.int64)


def count_within(
    occupancy: Occupancy, low: NDArray[np.float64], high: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Count the points in boxes, a column counting whole where its middle is inside.

    Parameters
    ----------
    occupancy : Occupancy
    low, high : (n, 2) float64 arrays
        The boxes: low <= x, y < high, metres; may be infinite.

    Returns
    -------
    (n,) int64 array
    """
    totals = np.append(0, np.cumsum(occupancy.counts))
    begins, ends = (_first_columns(edge, occupancy.cell) for edge in (low, high))
    return np.asarray(_sums_within(occupancy.columns, totals, begins, ends))


def _first_columns(edge: NDArray[np.float64], cell: float) -> Columns:
    """Return the first column whose middle is at an edge or after it."""
    # The middle is half a cell from where the column begins.
    return np.ceil(np.clip(edge, -2 * FARTHEST, 2 * FARTHEST) / cell - 0.5).astype(np.int64)


class ColumnCounter:
    """Counts points by column, and coarsens the lattice when too many columns are occupied.

    The result depends on the points alone, not on their order: the columns that some of the
    points occupy are never more than those of all. Its memory is bounded by `MOST_COLUMNS`.

    Attributes
    ----------
    cell : float
        Side of a column at present, metres.
    """

    def __init__(self, cell: float = FINEST_CELL) -> None:
        self.cell = cell
        self._occupied = 0
        self._make_room(_FIRST_CAPACITY)

    def add_points(self, xyz: NDArray[np.float64]) -> int:
        """Count points, and return how many of them are finite; others are passed over."""
        at = finite = 0
        while True:
            at, self._occupied, more = _count_points(
                xyz, at, 1 / self.cell, self._columns, self._counts, self._occupied, self._room
            )
            finite += more
            if at == len(xyz):
                return finite
            self._extend()

    def add(self, occupancy: Occupancy) -> None:
        """Count the points of an occupancy."""
        while self.cell < occupancy.cell:
            self._coarsen()
        self._add_columns(occupancy.columns, occupancy.counts, occupancy.cell)

    def occupancy(self) -> Occupancy:
        """Return the counts so far."""
        columns, counts = self._entries()
        order = np.lexsort((columns[:, 1], columns[:, 0]))
        return Occupancy(self.cell, columns.take(order, axis=0), counts.take(order))

    @property
    def _room(self) -> int:
        """Columns that may be occupied before more capacity is made, or cells are coarsened."""
        return min(len(self._counts) // 2, MOST_COLUMNS)

    def _add_columns(self, columns: Columns, counts: NDArray[np.int64], cell: float) -> None:
        at = 0
        while True:
            # The cells may have become coarser on the way.
            steps = round(np.log2(self.cell / cell))
            at, self._occupied = _count_columns(
                columns, counts, at, steps, self._columns, self._counts, self._occupied, self._room
            )
            if at == len(columns):
                return
            self._extend()

    def _extend(self) -> None:
        if self._occupied >= MOST_COLUMNS:
            self._coarsen()
        else:
            self._rebuild(4 * len(self._counts), self.cell)

    def _coarsen(self) -> None:
        self._rebuild(len(self._counts), 2 * self.cell)

    def _rebuild(self, capacity: int, cell: float) -> None:
        columns, counts = self._entries()
        old_cell, self.cell = self.cell, cell
        self._make_room(capacity)
        self._occupied = 0
        self._add_columns(columns, counts, old_cell)

    def _make_room(self, capacity: int) -> None:
        """Make an empty table, whose slots have the count 0."""
        self._columns = np.empty((capacity, 2), dtype=np.int64)
        self._counts = np.zeros(capacity, dtype=np.int64)

    def _entries(self) -> tuple[Columns, NDArray[np.int64]]:
        used = np.flatnonzero(self._counts)
        # Pairs are taken several times faster than by an index in brackets.
        return self._columns.take(used, axis=0), self._counts.take(used)


@helper
def _slot_of(x: np.int64, y: np.int64, columns: Columns, counts: NDArray[np.int64]) -> np.int64:
    """Return the slot of a column in a hash table with open addressing, or where it may go."""
    mixed = x * _FIRST_MULTIPLIER ^ y * _SECOND_MULTIPLIER
    slot = (mixed ^ mixed >> 29) & (len(counts) - 1)
    while counts[slot] != 0 and (columns[slot, 0] != x or columns[slot, 1] != y):
        slot = (slot + 1) & (len(counts) - 1)
    return slot


@compiled
def _count_points(
    xyz: NDArray[np.float64],
    start: int,
    cells_per_metre: float,
    columns: Columns,
    counts: NDArray[np.int64],
    occupied: int,
    room: int,
) -> tuple[int, int, int]:
    """Count points from `start` on, until a new column finds no room.

    Returns the first point not counted, the columns occupied, and the finite points counted.
    """
    finite = 0
    for point in range(start, len(xyz)):
        x, y, z = xyz[point, 0], xyz[point, 1], xyz[point, 2]
        if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)):
            continue
        column_x = np.int64(np.floor(min(max(x, -FARTHEST), FARTHEST) * cells_per_metre))
        column_y = np.int64(np.floor(min(max(y, -FARTHEST), FARTHEST) * cells_per_metre))
        slot = _slot_of(column_x, column_y, columns, counts)
        if counts[slot] == 0:
            if occupied == room:
                return point, occupied, finite
            columns[slot, 0], columns[slot, 1] = column_x, column_y
            occupied += 1
        counts[slot] += 1
        finite += 1
    return len(xyz), occupied, finite


@compiled
def _count_columns(
    added: Columns,
    added_counts: NDArray[np.int64],
    start: int,
    steps: int,
    columns: Columns,
    counts: NDArray[np.int64],
    occupied: int,
    room: int,
) -> tuple[int, int]:
    """Add counts of columns of cells 2^steps times finer, until a new column finds no room.

    Returns the first column not added, and the columns occupied.
    """
    for number in range(start, len(added)):
        x, y = added[number, 0] >> steps, added[number, 1] >> steps
        slot = _slot_of(x, y, columns, counts)
        if counts[slot] == 0:
            if occupied == room:
                return number, occupied
            columns[slot, 0], columns[slot, 1] = x, y
            occupied += 1
        counts[slot] += added_counts[number]
    return len(added), occupied


@compiled
def _sums_within(
    columns: Columns, totals: NDArray[np.int64], begins: Columns, ends: Columns
) -> NDArray[np.int64]:
    """Sum the counts of the columns in boxes, (B, 2); `totals` are those before each column."""
    sums = np.zeros(len(begins), np.int64)
    for box in range(len(begins)):
        low, high = begins[box, 1], ends[box, 1]
        place = _first_from(columns, begins[box, 0], low)
        # One line of columns after the other: those of an x are a run, in the order of y.
        while place < len(columns) and columns[place, 0] < ends[box, 0] and low < high:
            x = columns[place, 0]
            first = _first_from(columns, x, low)
            end = _first_from(columns, x, high)
            sums[box] += totals[end] - totals[first]
            place = end
            if place < len(columns) and columns[place, 0] == x:
                place = _first_from(columns, x + 1, low)
    return sums


@helper
def _first_from(columns: Columns, x: np.int64, y: np.int64) -> int:
    """Return the first column at or after (x, y) in lexicographic order."""
    low, high = 0, len(columns)
    while low < high:
        middle = (low + high) // 2
        before = columns[middle, 0] < x or (columns[middle, 0] == x and columns[middle, 1] < y)
        if before:
            low = middle + 1
        else:
            high = middle
    return low
