"""The nearest points of a few queries, met one tile after the other."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynahull.compilation import compiled
from dynahull.reference.neighbours import nearest_neighbours
from pipeline.tiles.vicinity import Vicinity

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
        if chosen.dtype == np.bool_:
            chosen = np.flatnonzero(chosen)
        # Whole rows are taken several times faster than by an index in brackets.
        return FreePoints(self.xyz.take(chosen, axis=0), self.rows.take(chosen))


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
            reach = self._reach()[slots]
            octaves = np.frexp(reach)[1]
            for octave in np.unique(octaves):
                alike = octaves == octave
                self._offer_around(points, slots[alike], reach[alike])
            return
        centres = self._centres[slots]
        found = nearest_neighbours(points.xyz, points.rows, self._k, centres)
        difference = points.xyz[found] - centres[:, None]
        dx, dy, dz = (difference[..., axis] for axis in range(3))
        squared = (dx * dx + dy * dy) + dz * dz
        self._keep(slots, squared, points.rows[found], points.xyz[found])

    def _offer_around(
        self, points: FreePoints, slots: NDArray[np.intp], reach: NDArray[np.float64]
    ) -> None:
        """Let a few queries of like reach choose among the points around them.

        To look at each of these takes less time than to build a tree.
        """
        if np.isfinite(reach).all():
            points = points.select(Vicinity(self._centres[slots], reach).holds(points.xyz))
        near, squared = np.empty(len(points), np.intp), np.empty(len(points))
        for slot in slots:
            limit = min(self._squared[slot, -1], self._squared_limit[slot])
            count = _within(points.xyz, self._centres[slot], limit, near, squared)
            self._offer_to(slot, points, near[:count], squared[:count])

    def _offer_to(
        self,
        slot: np.intp,
        points: FreePoints,
        near: NDArray[np.intp],
        squared: NDArray[np.float64],
    ) -> None:
        """Let one query choose among points that are near enough, at these squared distances."""
        if len(near) > self._k:
            nearest = squared <= np.partition(squared, self._k - 1)[self._k - 1]
            near, squared = near[nearest], squared[nearest]
        if len(near):
            chosen = near[None]
            self._keep(np.array([slot]), squared[None], points.rows[chosen], points.xyz[chosen])

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
def _within(
    xyz: NDArray[np.float64],
    centre: NDArray[np.float64],
    squared_limit: float,
    near: NDArray[np.intp],
    squared: NDArray[np.float64],
) -> int:
    """Find the points no farther than a limit: their indices, squared distances, and number."""
    count = 0
    for point in range(len(xyz)):
        dx, dy, dz = (
            xyz[point, 0] - centre[0],
            xyz[point, 1] - centre[1],
            xyz[point, 2] - centre[2],
        )
        distance = (dx * dx + dy * dy) + dz * dz
        # Written in any case, and kept if it counts: no branch to be guessed.
        near[count], squared[count] = point, distance
        count += distance <= squared_limit
    return count
