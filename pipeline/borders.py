"""Densities of one tile, exact up to its border and across it.

A tile knows all ground-free points of a region: its core and some of its halo. The k nearest of a
point there are the k nearest in the map, unless one beyond the region may be nearer than the k-th
found: then further tiles are read until it cannot.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynahull.clustering import Clusters
from dynahull.density import SMALLEST_CLUSTER, reference_densities
from dynahull.kernels import hull_densities
from dynahull.kernels.density import HullDensities
from dynahull.neighbours import nearest_neighbours
from dynahull.parameters import MethodParameters

_QUERIES_AT_A_TIME = 4_096


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


@dataclass(frozen=True, slots=True)
class Region:
    """Where all ground-free points are known: low <= x, y < high, infinite where the map ends.

    Attributes
    ----------
    low, high : (2,) float64 arrays
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]

    def suffices(
        self, xyz: NDArray[np.float64], squared_reach: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Tell whose neighbours all lie inside: nothing outside is as near as their k-th.

        Parameters
        ----------
        xyz : (n, 3) float64 array
            Points inside.
        squared_reach : (n,) float64 array
            Squared distance of their k-th neighbour inside; NaN or infinite if there is none.
        """
        # Rounding is monotonic: a point beyond the border is no nearer than this, to the last bit.
        border = self.distance_to_border(xyz)
        return np.asarray((squared_reach < border * border) | np.isposinf(border))

    def distance_to_border(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far points inside are from the border, (n,), metres."""
        return np.asarray(np.minimum(xyz[:, :2] - self.low, self.high - xyz[:, :2]).min(axis=1))

    def holds(self, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which points lie inside."""
        flat = xyz[:, :2]
        return np.asarray(((flat >= self.low) & (flat < self.high)).all(axis=1))


class OtherTiles(Protocol):
    """The rest of the map, read when it is needed."""

    def near(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Sequence[int]:
        """Return the tiles whose core meets a box, which may be infinite."""

    def box(self, tile: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the core of a tile: low (2,), high (2,)."""

    def free_points(self, tile: int) -> FreePoints:
        """Return the ground-free points of a tile's core."""


@dataclass(frozen=True, slots=True)
class CoreDensities:
    """Cluster and density of a tile's ground-free core points.

    Attributes
    ----------
    cluster : (n,) int32 array
    density : (n,) float64 array
        NaN where the whole cluster has fewer than four points.
    finished_elsewhere : int
        Points that needed further tiles.
    """

    cluster: NDArray[np.int32]
    density: NDArray[np.float64]
    finished_elsewhere: int


def core_densities(
    known: FreePoints,
    core: NDArray[np.bool_],
    region: Region,
    others: OtherTiles,
    clusters: Clusters,
    parameters: MethodParameters,
) -> CoreDensities:
    """Score the core points of a tile.

    Parameters
    ----------
    known : FreePoints
        All ground-free points of the region.
    core : (n,) bool array
        Which of them are the tile's own.
    region : Region
    others : OtherTiles
        Tiles to finish from, the tile itself not among them.
    clusters : Clusters
    parameters : MethodParameters
        `neighbours.k` and `density.device` are used.

    Returns
    -------
    CoreDensities
        For the core points, in their order.
    """
    membership = clusters.nearest(known.xyz) if len(clusters.centroids) else np.zeros(0, np.int32)
    density = np.full(len(known), np.nan)
    finished = 0
    for cluster in np.unique(membership[core]):
        members = np.flatnonzero(membership == cluster)
        inside, queries = known.select(members), core[members]
        found = _inside_densities(inside, queries, region, parameters)
        scores = found.density
        pending = np.flatnonzero(queries & ~region.suffices(inside.xyz, found.squared_reach))
        finished += len(pending)
        reachable = _Reachable(inside, known.rows, region, others, clusters, int(cluster))
        together = np.isfinite(found.squared_reach[pending])
        for group in _of_like_reach(pending[together], found.squared_reach):
            scores[group] = reachable.densities_together(group, found.squared_reach, parameters)
        one_by_one = pending[~together]
        for start in range(0, len(one_by_one), _QUERIES_AT_A_TIME):
            batch = one_by_one[start : start + _QUERIES_AT_A_TIME]
            scores[batch] = reachable.densities(inside.select(batch), parameters)
        density[members] = scores
    return CoreDensities(membership[core], density[core], finished)


def _inside_densities(
    inside: FreePoints, queries: NDArray[np.bool_], region: Region, parameters: MethodParameters
) -> HullDensities:
    """Score points by what is inside the region; a reach that is not known is infinite."""
    k = parameters.neighbours.k
    nothing = np.full(len(inside), np.nan)
    unknown = np.full(len(inside), np.inf)
    alone = bool(np.isinf(region.low).all() and np.isinf(region.high).all())
    if len(inside) < (SMALLEST_CLUSTER if alone else k):
        return HullDensities(nothing, unknown)
    if parameters.density.device == "reference":
        if not alone:
            return HullDensities(nothing, unknown)
        return HullDensities(reference_densities(inside.xyz, inside.rows, k), unknown)
    return hull_densities(inside.xyz, inside.rows, k, queries=queries)


def _of_like_reach(
    queries: NDArray[np.intp], squared_reach: NDArray[np.float64]
) -> Iterator[NDArray[np.intp]]:
    """Put together queries whose reaches differ by a factor of two at most."""
    octaves = np.frexp(squared_reach[queries])[1] // 2
    for octave in np.unique(octaves):
        yield queries[octaves == octave]


class _Reachable:
    """The points of one cluster that queries can reach: those inside, and those of other tiles."""

    def __init__(
        self,
        inside: FreePoints,
        known_rows: NDArray[np.int64],
        region: Region,
        others: OtherTiles,
        clusters: Clusters,
        cluster: int,
    ) -> None:
        self._inside = inside
        self._known_rows = known_rows
        self._region = region
        self._border: NDArray[np.float64] | None = None
        self._others = others
        self._clusters = clusters
        self._cluster = cluster

    def densities_together(
        self,
        queries: NDArray[np.intp],
        squared_reach: NDArray[np.float64],
        parameters: MethodParameters,
    ) -> NDArray[np.float64]:
        """Return the density of queries that have k neighbours inside, and a reach from these.

        Nothing farther than that can be a neighbour: so all that may be, from inside the border
        and from beyond it, is gathered once for all queries.
        """
        inside = self._inside
        if self._border is None:
            self._border = self._region.distance_to_border(inside.xyz)
        flat = inside.xyz[queries, :2]
        # A hair more than the distance, so that no rounding of it hides a tie.
        reach = np.sqrt(squared_reach[queries]) * (1 + 1e-9)
        farthest = reach.max()
        low, high = flat.min(axis=0) - farthest, flat.max(axis=0) + farthest
        # A query lies within its reach of the border, and its neighbours within that of it.
        near_border = self._border <= 2 * farthest * (1 + 1e-9)
        parts = [inside.select(near_border)]
        for tile in self._others.near(low, high):
            tile_low, tile_high = self._others.box(tile)
            apart = np.maximum(np.maximum(tile_low - flat, flat - tile_high), 0.0)
            if (np.hypot(apart[:, 0], apart[:, 1]) <= reach).any():
                points = self._others.free_points(tile)
                within = ((points.xyz[:, :2] >= low) & (points.xyz[:, :2] <= high)).all(axis=1)
                points = points.select(within & ~self._region.holds(points.xyz))
                parts.append(self._of_cluster(points))
        xyz = np.concatenate([part.xyz for part in parts])
        rows = np.concatenate([part.rows for part in parts])
        wanted = np.zeros(len(inside), np.bool_)
        wanted[queries] = True
        chosen = np.zeros(len(rows), np.bool_)
        chosen[: len(parts[0])] = wanted[near_border]
        found = hull_densities(xyz, rows, parameters.neighbours.k, queries=chosen)
        return found.density[chosen]

    def densities(self, queries: FreePoints, parameters: MethodParameters) -> NDArray[np.float64]:
        """Return the density of each query, by its k nearest points of the whole map."""
        k = parameters.neighbours.k
        nearest = _Nearest(queries.xyz, k)
        nearest.offer(self._inside, np.arange(len(queries)))
        low, high = nearest.bounds()
        for tile in self._others.near(low, high):
            reaching = nearest.reaching(*self._others.box(tile))
            if len(reaching):
                nearest.offer(self._points_of(tile), reaching)
        density = np.full(len(queries), np.nan)
        for slot, neighbours in nearest.neighbourhoods():
            if len(neighbours) < SMALLEST_CLUSTER:
                continue
            if parameters.density.device == "reference":
                centre = queries.xyz[slot : slot + 1]
                density[slot] = reference_densities(
                    neighbours.xyz, neighbours.rows, k, centres=centre
                )[0]
            else:
                query = neighbours.rows == queries.rows[slot]
                density[slot] = hull_densities(
                    neighbours.xyz, neighbours.rows, k, queries=query
                ).density[query][0]
        return density

    def _points_of(self, tile: int) -> FreePoints:
        points = self._others.free_points(tile)
        return self._of_cluster(points.select(~np.isin(points.rows, self._known_rows)))

    def _of_cluster(self, points: FreePoints) -> FreePoints:
        return points.select(self._clusters.nearest(points.xyz) == self._cluster)


class _Nearest:
    """The k nearest points met so far, of each of some queries."""

    def __init__(self, centres: NDArray[np.float64], k: int) -> None:
        self._centres = centres
        self._k = k
        self._xyz = np.full((len(centres), k, 3), np.nan)
        self._rows = np.full((len(centres), k), np.iinfo(np.int64).max)
        self._squared = np.full((len(centres), k), np.inf)

    def offer(self, points: FreePoints, slots: NDArray[np.intp]) -> None:
        """Let the queries `slots` choose among more points."""
        if not len(points):
            return
        centres = self._centres[slots]
        found = nearest_neighbours(points.xyz, points.rows, self._k, centres)
        difference = points.xyz[found] - centres[:, None]
        dx, dy, dz = (difference[..., axis] for axis in range(3))
        squared = np.concatenate([self._squared[slots], (dx * dx + dy * dy) + dz * dz], axis=1)
        rows = np.concatenate([self._rows[slots], points.rows[found]], axis=1)
        xyz = np.concatenate([self._xyz[slots], points.xyz[found]], axis=1)
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
        return np.asarray(np.sqrt(self._squared[:, -1]) * (1 + 1e-9))
