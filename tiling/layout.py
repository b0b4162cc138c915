"""How a map is cut: a quadtree by point count, whose leaves are the cores of the tiles.

Cores are half-open squares of whole lattice columns, anchored at the coordinates' origin: every
finite point lies in exactly one, and which one is decided by the same integers as in the survey.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tiling.survey import Occupancy, cells_of

NO_TILE = -1
"""The tile of a point without finite coordinates."""

_TOP_LEVEL = 41
"""A node of this level holds all columns of one quadrant: the lattice has 2^40 of them a side."""


@dataclass(frozen=True, slots=True)
class Layout:
    """The tiles of a map, in Morton order.

    Attributes
    ----------
    cell : float
        Side of a lattice column, metres.
    levels : (T,) int64 array
        A tile's core is a square of 2^level columns a side.
    corners : (T, 2) int64 array
        Its place among the squares of its level: it begins at column `corner << level`.
    counts : (T,) int64 array
        Points in its core.
    """

    cell: float
    levels: NDArray[np.int64]
    corners: NDArray[np.int64]
    counts: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def low(self) -> NDArray[np.float64]:
        """Where the cores begin, (T, 2), metres; inclusive."""
        return np.asarray((self.corners << self.levels[:, None]) * self.cell)

    @property
    def high(self) -> NDArray[np.float64]:
        """Where the cores end, (T, 2), metres; exclusive."""
        return np.asarray(((self.corners + 1) << self.levels[:, None]) * self.cell)

    def tile_of(self, xyz: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return the tile whose core each point lies in.

        Parameters
        ----------
        xyz : (n, 3) float64 array
            Points of the map that was surveyed.

        Returns
        -------
        (n,) int32 array
            Index of the tile; `NO_TILE` where a coordinate is not finite.
        """
        tiles = np.full(len(xyz), NO_TILE, np.int32)
        finite = np.flatnonzero(np.isfinite(xyz).all(axis=1))
        columns, place = np.unique(cells_of(xyz[finite], self.cell), axis=0, return_inverse=True)
        tiles[finite] = self._tile_of_columns(columns)[place.ravel()]
        return tiles

    def near(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the tiles whose core meets a box, (low, high) being (2,) and maybe infinite."""
        meets = (self.low <= high) & (self.high >= low)
        return np.flatnonzero(meets.all(axis=1))

    def _tile_of_columns(self, columns: NDArray[np.int64]) -> NDArray[np.int32]:
        tiles = np.full(len(columns), NO_TILE, np.int32)
        for level in np.unique(self.levels):
            leaves = np.flatnonzero(self.levels == level)
            nodes = np.concatenate([self.corners[leaves], columns >> level])
            _, names = np.unique(nodes, axis=0, return_inverse=True)
            names = names.ravel()
            leaf_of_name = np.full(len(nodes), NO_TILE, np.int32)
            leaf_of_name[names[: len(leaves)]] = leaves
            found = leaf_of_name[names[len(leaves) :]]
            tiles[found != NO_TILE] = found[found != NO_TILE]
        return tiles


def quadtree(occupancy: Occupancy, max_points: int) -> Layout:
    """Cut a map into tiles of at most so many points.

    Parameters
    ----------
    occupancy : Occupancy
        Of the whole map.
    max_points : int
        Points in a core, at most; a single column that holds more stays whole.

    Returns
    -------
    Layout
        Without empty tiles; no tiles for a map without finite points.
    """
    columns, counts = occupancy.columns, occupancy.counts
    leaves = []
    for level in range(_TOP_LEVEL, -1, -1):
        if not len(columns):
            break
        nodes, place = np.unique(columns >> level, axis=0, return_inverse=True)
        place = place.ravel()
        totals = np.bincount(place, weights=counts, minlength=len(nodes)).astype(np.int64)
        ends = (totals <= max_points) | (level == 0)
        leaves.append((np.full(int(ends.sum()), level), nodes[ends], totals[ends]))
        rest = ~ends[place]
        columns, counts = columns[rest], counts[rest]
    if not leaves:
        return Layout(
            occupancy.cell, np.empty(0, np.int64), np.empty((0, 2), np.int64), np.empty(0, np.int64)
        )
    levels, corners, totals = (np.concatenate(part) for part in zip(*leaves, strict=True))
    order = _morton_order(corners << levels[:, None])
    return Layout(occupancy.cell, levels[order], corners[order], totals[order])


def _morton_order(columns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Order columns along the Z curve, so that tiles near in order are near in place."""
    shifted = columns - columns.min(axis=0)
    keys = []
    for byte in range(0, _TOP_LEVEL + 1, 8):
        part = (shifted >> byte) & 0xFF
        keys.append(_spread(part[:, 0]) << 1 | _spread(part[:, 1]))
    return np.lexsort(keys)


def _spread(bits: NDArray[np.int64]) -> NDArray[np.int64]:
    """Put a zero above each of the lowest eight bits."""
    bits = (bits | bits << 4) & 0x0F0F
    bits = (bits | bits << 2) & 0x3333
    return (bits | bits << 1) & 0x5555
