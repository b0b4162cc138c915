"""How a map is cut: a quadtree by point count, whose leaves are the tiles.

A tile's core is a half-open rectangle of whole lattice columns, so which tile a point is in is
decided by the same integers as in the survey: every finite point is in exactly one. The root of
the tree is the smallest square of 2^n columns that holds the map and begins where the map does: a
map of few points is one tile, wherever it lies. A square is cut in two halves by x, and these by y:
where a half is small enough, it is a tile.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tiling.compiled import compiled, helper
from tiling.occupancy import FARTHEST, Occupancy

NO_TILE = -1
"""The tile of a point without finite coordinates, and of one that was not in the survey."""

Columns = NDArray[np.int64]
Corners = NDArray[np.float64]
_Places = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """One tile."""

    index: int
    """Its number in the layout."""
    low: Corners
    high: Corners
    """(2,), the core: low <= x, y < high, metres; infinite at the edge of the lattice."""
    point_count: int
    """Points in the core."""


@dataclass(frozen=True, eq=False)
class Layout:
    """The tiles of a map, in Morton order: near in order is near in place."""

    cell: float
    """Side of a lattice column, metres."""
    origin: Columns
    """(2,): column at which the root of the quadtree begins."""
    begins: Columns
    ends: Columns
    """(T, 2): cores in columns, half-open, no larger than the points in them need."""
    counts: NDArray[np.int64]
    """(T,): points in each core."""

    def typical_place(self) -> NDArray[np.float64]:
        """Return the median distance of tiles from the origin along x and y, (3,), weighted.

        A tile counts as often as it has points. It has no place along z, which is 0.
        """
        place = np.zeros(3)
        if not len(self):
            return place
        middles = np.abs(self.begins + self.ends) * (self.cell / 2)
        for axis in range(2):
            order = np.argsort(middles[:, axis])
            below = np.cumsum(self.counts[order])
            half = int(np.searchsorted(below, below[-1] / 2))
            place[axis] = middles[order[half], axis]
        return place

    def __len__(self) -> int:
        return len(self.counts)

    def __getitem__(self, index: int) -> Tile:
        """Return a tile."""
        return Tile(index, self.low[index], self.high[index], int(self.counts[index]))

    def __iter__(self) -> Iterator[Tile]:
        low, high = self.low, self.high
        for index, count in enumerate(self.counts.tolist()):
            yield Tile(index, low[index], high[index], count)

    @cached_property
    def low(self) -> Corners:
        """Where the cores begin, (T, 2), metres; inclusive."""
        return np.where(self.begins <= -FARTHEST / self.cell, -np.inf, self.begins * self.cell)

    @cached_property
    def high(self) -> Corners:
        """Where the cores end, (T, 2), metres; exclusive."""
        return np.where(self.ends > FARTHEST / self.cell, np.inf, self.ends * self.cell)

    def overfull(self, max_points: int) -> NDArray[np.intp]:
        """Return the tiles of more points: single columns, which are not divided."""
        return np.flatnonzero(self.counts > max_points)

    def tile_of(self, xyz: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return the tile whose core each point of the map lies in, (n,) int32.

        It is `NO_TILE` where a coordinate is not finite.
        """
        tiles = np.empty(len(xyz), np.int32)
        _find_tiles(xyz, 1 / self.cell, self.origin, self.begins, self.ends, tiles)
        return tiles

    def near(self, low: Corners, high: Corners) -> NDArray[np.intp]:
        """Return the tiles whose core meets a box, (low, high) being (2,) and maybe infinite."""
        meets = (self.low <= high) & (self.high >= low)
        return np.flatnonzero(meets.all(axis=1))

    def to_json(self) -> str:
        """Return the layout as text, which `from_json` reads."""
        return json.dumps(
            {
                "cell": self.cell,
                "origin": self.origin.tolist(),
                "begins": self.begins.tolist(),
                "ends": self.ends.tolist(),
                "counts": self.counts.tolist(),
            }
        )

    @classmethod
    def from_json(cls, text: str) -> "Layout":
        """Return the layout that `to_json` turned into this text."""
        stored: dict[str, Any] = json.loads(text)
        return cls(
            float(stored["cell"]),
            np.array(stored["origin"], np.int64),
            np.array(stored["begins"], np.int64).reshape(-1, 2),
            np.array(stored["ends"], np.int64).reshape(-1, 2),
            np.array(stored["counts"], np.int64),
        )


def quadtree(occupancy: Occupancy, max_points: int) -> Layout:
    """Cut a map into tiles of at most so many points, none of which is empty.

    A single column that holds more stays whole. A map without finite points has no tiles.
    """
    if not len(occupancy.counts):
        nothing = np.empty((0, 2), np.int64)
        return Layout(occupancy.cell, np.zeros(2, np.int64), nothing, nothing, nothing[:, 0])
    origin = occupancy.columns.min(axis=0)
    from_origin = occupancy.columns - origin
    order = morton_order(from_origin)
    from_origin, counts = from_origin.take(order, axis=0), occupancy.counts.take(order)
    points_before = np.append(0, np.cumsum(counts))

    starts = _leaf_starts(from_origin, points_before, max_points)
    ends = np.append(starts[1:], len(from_origin))
    low, high = _boxes(from_origin, starts, ends)
    totals = points_before[ends] - points_before[starts]
    return Layout(occupancy.cell, origin, origin + low, origin + high, totals)


def _leaf_starts(columns: Columns, points_before: NDArray[np.int64], max_points: int) -> _Places:
    """Return where each leaf begins in columns in Morton order: a node is a run of them.

    Those of a node agree in all bits of their place on the curve from a certain one on; to cut it
    is to look where the next lower bit changes.
    """
    leaves: list[_Places] = []
    starts, ends = np.array([0]), np.array([len(columns)])
    for bit in range(2 * int(columns.max()).bit_length(), -1, -1):
        cut = (points_before[ends] - points_before[starts] > max_points) & (bit > 0)
        leaves.append(starts[~cut])
        starts, ends = starts[cut], ends[cut]
        if not len(starts):
            break
        middles = _second_halves(columns, starts, ends, (bit - 1) // 2, bit % 2)
        starts, ends = np.append(starts, middles), np.append(middles, ends)
        starts, ends = starts[starts < ends], ends[starts < ends]
    return np.sort(np.concatenate(leaves))


@compiled
def _second_halves(
    columns: Columns, starts: _Places, ends: _Places, bit: int, axis: int
) -> _Places:
    """Return where in each run the columns begin that have a bit set, which come last."""
    middles = np.empty(len(starts), np.intp)
    for node in range(len(starts)):
        low, high = starts[node], ends[node]
        while low < high:
            middle = (low + high) // 2
            if columns[middle, axis] >> bit & 1:
                high = middle
            else:
                low = middle + 1
        middles[node] = low
    return middles


@compiled
def _boxes(columns: Columns, starts: _Places, ends: _Places) -> tuple[Columns, Columns]:
    """Return the smallest box (begin, end) of the columns of each run."""
    begins, limits = np.empty((len(starts), 2), np.int64), np.empty((len(starts), 2), np.int64)
    for run in range(len(starts)):
        begins[run] = columns[starts[run]]
        limits[run] = begins[run] + 1
        for place in range(starts[run], ends[run]):
            for axis in range(2):
                begins[run, axis] = min(begins[run, axis], columns[place, axis])
                limits[run, axis] = max(limits[run, axis], columns[place, axis] + 1)
    return begins, limits


@compiled
def _find_tiles(
    xyz: NDArray[np.float64],
    cells_per_metre: float,
    origin: Columns,
    begins: Columns,
    ends: Columns,
    tiles: NDArray[np.int32],
) -> None:
    """Find the tile of each point: the last that begins no later in Morton order.

    A leaf of the quadtree is a run of that order, and its core begins within it.
    """
    tile = 0
    for point in range(len(xyz)):
        tiles[point] = NO_TILE
        x, y, z = xyz[point, 0], xyz[point, 1], xyz[point, 2]
        if not (np.isfinite(x) and np.isfinite(y) and np.isfinite(z)) or len(begins) == 0:
            continue
        column_x = np.int64(np.floor(min(max(x, -FARTHEST), FARTHEST) * cells_per_metre))
        column_y = np.int64(np.floor(min(max(y, -FARTHEST), FARTHEST) * cells_per_metre))
        if column_x < origin[0] or column_y < origin[1]:
            continue
        # Points come in runs of one tile.
        if not _is_within(column_x, column_y, begins, ends, tile):
            tile = _last_begun(column_x, column_y, origin, begins)
        if _is_within(column_x, column_y, begins, ends, tile):
            tiles[point] = tile


@helper
def _is_within(x: np.int64, y: np.int64, begins: Columns, ends: Columns, tile: int) -> bool:
    return bool(begins[tile, 0] <= x < ends[tile, 0] and begins[tile, 1] <= y < ends[tile, 1])


@helper
def _last_begun(x: np.int64, y: np.int64, origin: Columns, begins: Columns) -> int:
    """Return the last tile that does not begin after a column; the first if all do."""
    low, high = 0, len(begins)
    while high - low > 1:
        middle = (low + high) // 2
        after = morton_before(
            x - origin[0],
            y - origin[1],
            begins[middle, 0] - origin[0],
            begins[middle, 1] - origin[1],
        )
        if after:
            high = middle
        else:
            low = middle
    return low


_HALF = 31
"""Bits of each coordinate in one key; two keys take coordinates to 2^62."""

_SPREADS = (
    (16, 0x0000FFFF0000FFFF),
    (8, 0x00FF00FF00FF00FF),
    (4, 0x0F0F0F0F0F0F0F0F),
    (2, 0x3333333333333333),
    (1, 0x5555555555555555),
)


def morton_order(columns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the order of columns along the Z curve (Morton 1966), (n,): near in it is near.

    The order is that of the bits of x and y, from 0 to 2^62, taken in turn, from the highest, those
    of x first. So every node of a quadtree over the lattice is one run of it.
    """
    low = _interleaved(columns & (1 << _HALF) - 1)
    if columns.max(initial=0) >> _HALF == 0:
        return np.argsort(low, kind="stable")
    return np.lexsort((low, _interleaved(columns >> _HALF)))


def _interleaved(columns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the bits of x and y, below 2^31, in turn."""
    return _spread(columns[:, 0]) << 1 | _spread(columns[:, 1])


def _spread(bits: NDArray[np.int64]) -> NDArray[np.int64]:
    """Put a zero above each bit (Anderson, Bit Twiddling Hacks: interleave by magic numbers)."""
    for shift, mask in _SPREADS:
        bits = (bits | bits << shift) & mask
    return bits


@helper
def morton_before(x: np.int64, y: np.int64, other_x: np.int64, other_y: np.int64) -> bool:
    """Tell whether a column comes before another: the highest bit that differs decides.

    Of two differences, the one with the higher highest bit is found without looking for that bit
    (Chan 2002, Closest-point problems simplified on the RAM).
    """
    difference_x, difference_y = x ^ other_x, y ^ other_y
    if difference_x < difference_y and difference_x < difference_x ^ difference_y:
        return bool(y < other_y)
    return bool(x < other_x)
