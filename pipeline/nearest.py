"""The nearest points of a few queries, met one tile after the other."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynahull.compilation import compiled
from dynahull.neighbours import nearest_neighbours

_MOST_WITHOUT_TREE = 128


@dataclass(frozen=True, slots=True)
class FreePoints:
    """Ground-free points.

    Attributes
    ----------
    xyz : (n, 3) float64 array
    rows : (n,) int64 array
    """

    xyz: NDArray[np.float64]
    rows: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.rows)

    def select(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "FreePoints":
        """Return some of the points."""
        return FreePoints(self.xyz[chosen], self.rows[chosen])


class NearestSoFar:
    """The k nearest points met so far, of each of some queries.

    Parameters
    ----------
    centres : (m, 3) float64 array
        The queries.
    k : int
    reach : (m,) float64 array
        Distances beyond which no neighbour is, metres; infinite where not known.
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
        if not len(points):
            return
        if len(slots) <= _MOST_WITHOUT_TREE:
            x, y, z = np.ascontiguousarray(points.xyz.T)
            for slot in slots:
                squared = _squared_distances(x, y, z, *self._centres[slot])
                self._offer_to(slot, points, squared)
            return
        centres = self._centres[slots]
        found = nearest_neighbours(points.xyz, points.rows, self._k, centres)
        difference = points.xyz[found] - centres[:, None]
        dx, dy, dz = (difference[..., axis] for axis in range(3))
        squared = (dx * dx + dy * dy) + dz * dz
        self._keep(slots, squared, points.rows[found], points.xyz[found])

    def _offer_to(self, slot: np.intp, points: FreePoints, squared: NDArray[np.float64]) -> None:
        """Look at every point: for few queries that takes less time than to build a tree."""
        limit = min(self._squared[slot, -1], self._squared_limit[slot])
        near = np.flatnonzero(squared <= limit)
        if len(near) > self._k:
            limit = np.partition(squared[near], self._k - 1)[self._k - 1]
            near = near[squared[near] <= limit]
        if len(near):
            chosen = near[None]
            self._keep(np.array([slot]), squared[chosen], points.rows[chosen], points.xyz[chosen])

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


@compiled
def _squared_distances(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    centre_x: float,
    centre_y: float,
    centre_z: float,
) -> NDArray[np.float64]:
    squared = np.empty(len(x))
    for point in range(len(x)):
        dx, dy, dz = x[point] - centre_x, y[point] - centre_y, z[point] - centre_z
        squared[point] = (dx * dx + dy * dy) + dz * dz
    return squared
