"""The nearest points of a few queries, met one tile after the other, and where they may lie."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from dynahull.reference import nearest_neighbours

_MOST_CELLS = 1_000
"""Cells of a vicinity along each axis: a million together, a byte each."""

_CELLS_REACHED = 6
"""Cells of a vicinity that the farthest reach is long, where it has no more than the most."""


@dataclass(frozen=True, slots=True)
class FreePoints:
    """Ground-free points."""

    xyz: NDArray[np.float64]
    """(n, 3)"""
    rows: NDArray[np.int64]
    """(n,)"""

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "FreePoints":
        """Return some of the points."""
        if chosen.dtype == np.bool_:
            chosen = np.flatnonzero(chosen)
        # Whole rows are taken several times faster than by an index in brackets.
        return FreePoints(self.xyz.take(chosen, axis=0), self.rows.take(chosen))


class Vicinity:
    """The surroundings, seen from above, of some points.

    A raster of square cells: all that a point reaches into. So it holds every place within reach of
    a point, and some more.

    Parameters
    ----------
    xyz : (n, 3) float64 array
        The points, at least one.
    reach : (n,) float64 array
        How far from each, metres.

    Attributes
    ----------
    low, high : (2,) float64 arrays
        The box of the surroundings.
    reach : float
        The farthest.
    """

    def __init__(self, xyz: NDArray[np.float64], reach: NDArray[np.float64]) -> None:
        flat, self.reach = xyz[:, :2], float(reach.max())
        extent = flat.max(axis=0) - flat.min(axis=0)
        # Wider than what coordinates tell apart, by more than rounding can move a place.
        rounding = float(np.spacing(np.abs(flat).max()))
        widest = self.reach / _CELLS_REACHED
        self._cell = max(widest, float(extent.max()) / _MOST_CELLS, 1e4 * rounding)
        cells_reached = reach / self._cell * 1.001
        most = int(cells_reached.max()) + 1
        self.low = flat.min(axis=0) - (most + 1) * self._cell
        cells = ((flat - self.low) / self._cell).astype(np.int64)
        shape = cells.max(axis=0) + most + 2
        self.high = self.low + shape * self._cell
        self._marked = np.zeros(shape, np.bool_)
        for x, y in product(range(-most, most + 1), repeat=2):
            apart = np.hypot(max(abs(x) - 1, 0), max(abs(y) - 1, 0))
            reached = cells[cells_reached >= apart]
            self._marked[reached[:, 0] + x, reached[:, 1] + y] = True

    def holds(self, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which of other points lie there, (m,) bool."""
        x, y = ((xyz[:, axis] - self.low[axis]) / self._cell for axis in range(2))
        wide, high = self._marked.shape
        found = np.flatnonzero((x >= 0) & (x < wide) & (y >= 0) & (y < high))
        held = np.zeros(len(xyz), np.bool_)
        cells = x.take(found).astype(np.int64), y.take(found).astype(np.int64)
        held[found] = self._marked[cells]
        return held

    def meets(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which boxes, low (m, 2) and high (m, 2), which may be infinite, meet it."""
        shape = np.array(self._marked.shape)
        # A cell more on either side, for the rounding of the box's place.
        first = np.clip((low - self.low) / self._cell - 1, 0, shape).astype(np.int64)
        end = np.clip((high - self.low) / self._cell + 2, 0, shape).astype(np.int64)
        end, below = np.maximum(end, first), self._below
        x, y, beyond_x, beyond_y = first[:, 0], first[:, 1], end[:, 0], end[:, 1]
        marked = below[beyond_x, beyond_y] - below[x, beyond_y]
        marked -= below[beyond_x, y] - below[x, y]
        return np.asarray(marked > 0)

    @cached_property
    def _below(self) -> NDArray[np.int32]:
        """How many cells are marked below and left of each corner."""
        below = np.zeros([side + 1 for side in self._marked.shape], np.int32)
        np.cumsum(self._marked, axis=0, out=below[1:, 1:])
        np.cumsum(below[1:, 1:], axis=1, out=below[1:, 1:])
        return below


class NearestSoFar:
    """The k nearest points met so far, of each of some queries, (m, 3).

    Beyond its reach, in metres and infinite where not known, a query has no neighbour.
    """

    def __init__(self, centres: NDArray[np.float64], k: int, reach: NDArray[np.float64]) -> None:
        self._centres = centres
        self._k = k
        # A hair more, as for all distances here: no rounding hides a tie.
        self._squared_limit = reach * reach * (1 + 1e-9)
        self._xyz = np.full((len(centres), k, 3), np.nan)
        self._rows = np.full((len(centres), k), np.iinfo(np.int64).max)
        self._squared = np.full((len(centres), k), np.inf)

    def offer(self, points: FreePoints, slots: NDArray[np.intp]) -> None:
        """Let the queries `slots` choose among more points."""
        reach = self._reach()[slots]
        if len(points) and np.isfinite(reach).all():
            points = points.select(Vicinity(self._centres[slots], reach).holds(points.xyz))
        if not len(points):
            return
        centres = self._centres[slots]
        found = nearest_neighbours(points.xyz, points.rows, self._k, centres)
        difference = points.xyz[found] - centres[:, None]
        dx, dy, dz = (difference[..., axis] for axis in range(3))
        squared = (dx * dx + dy * dy) + dz * dz
        self._keep(slots, squared, points.rows[found], points.xyz[found])

    def _keep(
        self,
        slots: NDArray[np.intp],
        squared: NDArray[np.float64],
        rows: NDArray[np.int64],
        xyz: NDArray[np.float64],
    ) -> None:
        """Keep the k nearest of those known and of more, in order of distance and row number."""
        squared = np.concatenate([self._squared[slots], squared], axis=1)
        rows = np.concatenate([self._rows[slots], rows], axis=1)
        xyz = np.concatenate([self._xyz[slots], xyz], axis=1)
        order = np.lexsort((rows, squared), axis=1)[:, : self._k]
        self._squared[slots] = np.take_along_axis(squared, order, axis=1)
        self._rows[slots] = np.take_along_axis(rows, order, axis=1)
        self._xyz[slots] = np.take_along_axis(xyz, order[..., None], axis=1)

    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return a box that no neighbour of any query lies outside of."""
        reach = self._reach()[:, None]
        flat = self._centres[:, :2]
        return (flat - reach).min(axis=0), (flat + reach).max(axis=0)

    def reaching(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.intp]:
        """Return the queries that may have a neighbour in a box."""
        flat = self._centres[:, :2]
        apart = np.maximum(np.maximum(low - flat, flat - high), 0.0)
        return np.flatnonzero(np.hypot(apart[:, 0], apart[:, 1]) <= self._reach())

    def neighbourhoods(self) -> Iterator[tuple[int, FreePoints]]:
        """Yield each query and its neighbours in their order."""
        for slot, squared in enumerate(self._squared):
            found = np.isfinite(squared)
            yield slot, FreePoints(self._xyz[slot, found], self._rows[slot, found])

    def _reach(self) -> NDArray[np.float64]:
        # A hair more than the distance, so that no rounding of it hides a tie beyond a border.
        limit = np.minimum(self._squared[:, -1], self._squared_limit)
        return np.asarray(np.sqrt(limit) * (1 + 1e-9))
