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

from tiling.formats.points import only_finite
from tiling.survey import FARTHEST, Occupancy, columns_of, distinct_columns

NO_TILE = -1
"""The tile of a point without finite coordinates, and of one that was not in the survey."""

_ARRAYS = {"origin": 2, "begins": (-1, 2), "ends": (-1, 2), "counts": -1}
"""Those of a layout, by their shapes."""

Columns = NDArray[np.int64]
Corners = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Tile:
    """One tile."""

    index: int
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
        return map(self.__getitem__, range(len(self)))

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
        finite = only_finite(xyz)
        columns, numbers = distinct_columns(columns_of(finite, self.cell))
        found = self._tile_of_columns(columns)[numbers]
        if len(finite) == len(xyz):
            return found
        tiles = np.full(len(xyz), NO_TILE, np.int32)
        tiles[np.isfinite(xyz).all(axis=1)] = found
        return tiles

    def _tile_of_columns(self, columns: Columns) -> NDArray[np.int32]:
        """Return the tile that each column of the lattice is in, or `NO_TILE`."""
        tiles = np.full(len(columns), NO_TILE, np.int32)
        if not len(self):
            return tiles
        places = np.flatnonzero((columns >= self.origin).all(axis=1))
        columns = columns[places]
        # A leaf of the quadtree is a run of the Z curve, and its core begins within it: so the tile
        # is the last that begins no later.
        begins = _morton_keys(self.begins - self.origin)
        found = np.searchsorted(begins, _morton_keys(columns - self.origin), side="right") - 1
        within = (self.begins[found] <= columns) & (columns < self.ends[found])
        tiles[places] = np.where(within.all(axis=1), found, NO_TILE)
        return tiles

    def near(self, low: Corners, high: Corners) -> NDArray[np.intp]:
        """Return the tiles whose core meets a box, (low, high) being (2,) and maybe infinite."""
        meets = (self.low <= high) & (self.high >= low)
        return np.flatnonzero(meets.all(axis=1))

    def to_json(self) -> str:
        """Return the layout as text, which `from_json` reads."""
        arrays = {name: getattr(self, name).tolist() for name in _ARRAYS}
        return json.dumps({"cell": self.cell, **arrays})

    @classmethod
    def from_json(cls, text: str) -> "Layout":
        """Return the layout that `to_json` turned into this text."""
        stored: dict[str, Any] = json.loads(text)
        arrays = {name: np.array(stored[name], np.int64).reshape(_ARRAYS[name]) for name in _ARRAYS}
        return cls(float(stored["cell"]), **arrays)


def quadtree(occupancy: Occupancy, max_points: int) -> Layout:
    """Cut a map into tiles of at most so many points, none of which is empty.

    A single column that holds more stays whole. A map without finite points has no tiles.
    """
    if not len(occupancy.counts):
        nothing = np.empty((0, 2), np.int64)
        return Layout(occupancy.cell, np.zeros(2, np.int64), nothing, nothing, nothing[:, 0])
    origin = occupancy.columns.min(axis=0)
    order = morton_order(occupancy.columns - origin)
    columns, counts = occupancy.columns.take(order, axis=0), occupancy.counts.take(order)
    starts = _leaf_starts(columns - origin, np.append(0, np.cumsum(counts)), max_points)
    return Layout(
        occupancy.cell,
        origin,
        np.minimum.reduceat(columns, starts),
        np.maximum.reduceat(columns, starts) + 1,
        np.add.reduceat(counts, starts),
    )


def _leaf_starts(
    columns: Columns, points_before: NDArray[np.int64], max_points: int
) -> NDArray[np.intp]:
    """Return where each leaf begins in columns in Morton order: a node is a run of them.

    Those of a node agree in all bits of their place on the curve from a certain one on; to cut it
    is to look where the next lower bit changes: columns that have it set come last.
    """
    leaves: list[NDArray[np.intp]] = []
    starts, ends = np.array([0]), np.array([len(columns)])
    for bit in range(2 * int(columns.max()).bit_length(), -1, -1):
        cut = (points_before[ends] - points_before[starts] > max_points) & (bit > 0)
        leaves.append(starts[~cut])
        starts, ends = starts[cut], ends[cut]
        if not len(starts):
            break
        set_before = np.append(0, np.cumsum(columns[:, bit % 2] >> (bit - 1) // 2 & 1))
        middles = ends - (set_before[ends] - set_before[starts])
        starts, ends = np.append(starts, middles), np.append(middles, ends)
        starts, ends = starts[starts < ends], ends[starts < ends]
    return np.sort(np.concatenate(leaves))


_HALF = 31
"""Bits of each coordinate in one half of a key; both take coordinates to 2^62."""

_SPREADS = (
    (16, 0x0000FFFF0000FFFF),
    (8, 0x00FF00FF00FF00FF),
    (4, 0x0F0F0F0F0F0F0F0F),
    (2, 0x3333333333333333),
    (1, 0x5555555555555555),
)


def morton_order(columns: Columns) -> NDArray[np.intp]:
    """Return the order of columns along the Z curve (Morton 1966), (n,): near in it is near.

    The order is that of the bits of x and y, from 0 to 2^62, taken in turn, from the highest, those
    of x first. So every node of a quadtree over the lattice is one run of it.
    """
    return np.argsort(_morton_keys(columns), kind="stable")


def _morton_keys(columns: Columns) -> NDArray[np.bytes_]:
    """Return the places of columns on the Z curve, (n,), as 16 bytes, the highest first."""
    halves = (columns >> _HALF, columns & (1 << _HALF) - 1)
    keys = [_spread(half[:, 0]) << 1 | _spread(half[:, 1]) for half in halves]
    return np.stack(keys, axis=1).astype(">i8").view("S16")[:, 0]


def _spread(bits: NDArray[np.int64]) -> NDArray[np.int64]:
    """Put a zero above each bit (Anderson, Bit Twiddling Hacks: interleave by magic numbers)."""
    for shift, mask in _SPREADS:
        bits = (bits | bits << shift) & mask
    return bits
