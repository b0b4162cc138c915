"""Densities of one tile, exact up to its border and across it.

A tile knows all ground-free points of a region: its core and some of its halo. The k nearest of a
point there are the k nearest in the map, unless one beyond the region may be nearer than the k-th
found: then further tiles are read until it cannot.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from dynahull.clustering import Clusters
from dynahull.density import SMALLEST_CLUSTER, SPREAD_COLUMNS, reference_spreads
from dynahull.kernels import hull_densities
from dynahull.kernels.density import HullDensities
from dynahull.parameters import MethodParameters
from dynahull.reference import reference_densities
from dynahull.result import NO_CLUSTER
from pipeline.tiles.nearest import FreePoints, NearestSoFar, Vicinity
from tiling.sorted_points import Near

_QUERIES_AT_A_TIME = 4_096

_FARTHEST_GATHERED = 8.0
"""Metres: all that is so near is gathered at once. Farther, it might be more than memory holds."""


@dataclass(frozen=True, slots=True)
class Region:
    """Where all ground-free points are known: low <= x, y < high, infinite where the map ends."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    """(2,)"""

    def suffices(
        self, xyz: NDArray[np.float64], squared_reach: NDArray[np.float64]
    ) -> NDArray[np.bool_]:
        """Tell whose neighbours all lie inside: nothing outside is as near as their k-th.

        The squared reach, (n,), is NaN or infinite where there is no k-th neighbour inside.
        """
        # Rounding is monotonic: a point beyond the border is no nearer than this, to the last bit.
        border = self.distance_to_border(xyz)
        return np.asarray((squared_reach < border * border) | np.isposinf(border))

    def distance_to_border(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how far points inside are from the border, (n,), metres."""
        along_x, along_y = (
            np.minimum(xyz[:, axis] - self.low[axis], self.high[axis] - xyz[:, axis])
            for axis in range(2)
        )
        return np.asarray(np.minimum(along_x, along_y))

    def holds(self, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which points lie inside."""
        x, y = xyz[:, 0], xyz[:, 1]
        along_x = (x >= self.low[0]) & (x < self.high[0])
        return np.asarray(along_x & (y >= self.low[1]) & (y < self.high[1]))

    def meets(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which boxes, low (m, 2) and high (m, 2), it meets."""
        return np.asarray(((low <= self.high) & (high >= self.low)).all(axis=1))


class OtherTiles(Protocol):
    """The rest of the map, read when it is needed."""

    def near(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Sequence[int]:
        """Return the tiles whose core meets a box, which may be infinite."""

    def box(self, tile: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the core of a tile: low (2,), high (2,)."""

    def free_points(self, tile: int, near: Near) -> FreePoints:
        """Return the ground-free points of a tile's core that are near, and perhaps others."""


@dataclass(frozen=True, slots=True)
class CoreDensities:
    """Cluster and density of a tile's ground-free core points."""

    cluster: NDArray[np.int32]
    """(n,)"""
    density: NDArray[np.float64]
    """(n,): NaN where the whole cluster has fewer than four points."""
    spread: NDArray[np.float32]
    """(n, SPREAD_COLUMNS) or (n, 0): how the neighbours are spread, where the decision asks."""
    finished_elsewhere: int
    """Points that needed further tiles."""


def core_densities(
    known: FreePoints,
    core: NDArray[np.bool_],
    region: Region,
    others: OtherTiles,
    clusters: Clusters,
    parameters: MethodParameters,
) -> CoreDensities:
    """Score the core points of a tile, in their order, knowing all ground-free ones of its region.

    `others` are tiles to finish from, the tile itself not among them.
    """
    membership = np.full(len(known), NO_CLUSTER, np.int32)
    if len(clusters.centroids):  # a tile's own clusters are none where it has no points
        membership = clusters.nearest(known.xyz)
    density, spread = _nothing(len(known), parameters)
    reach = np.full(len(known), np.inf)
    pending = np.zeros(len(known), np.bool_)
    for cluster in np.unique(membership[core]):
        members = np.flatnonzero(membership == cluster)
        inside, queries = known.select(members), core[members]
        found = _inside_densities(inside, queries, region, parameters)
        density[members], spread[members] = found.density, found.spread
        pending[members] = queries & ~region.suffices(inside.xyz, found.squared_reach)
        # A hair more than the distance, so that no rounding of it hides a tie.
        reach[members] = np.sqrt(found.squared_reach) * (1 + 1e-9)
    rest = _Rest(known, membership, region, others, clusters, parameters)
    reached = pending & (reach <= _FARTHEST_GATHERED)
    density[reached], spread[reached] = rest.within_reach(np.flatnonzero(reached), reach[reached])
    one_by_one = np.flatnonzero(pending & ~reached)
    for start in range(0, len(one_by_one), _QUERIES_AT_A_TIME):
        batch = one_by_one[start : start + _QUERIES_AT_A_TIME]
        density[batch], spread[batch] = rest.wherever(batch, reach[batch])
    return CoreDensities(membership[core], density[core], spread[core], int(pending.sum()))


_Found = tuple[NDArray[np.float64], NDArray[np.float32]]
"""Density and spread of some points."""


def _nothing(count: int, parameters: MethodParameters) -> _Found:
    columns = SPREAD_COLUMNS if parameters.removal.weighs_evidence else 0
    return np.full(count, np.nan), np.full((count, columns), np.nan, np.float32)


def _inside_densities(
    inside: FreePoints, queries: NDArray[np.bool_], region: Region, parameters: MethodParameters
) -> HullDensities:
    """Score points by what is inside the region; a reach that is not known is infinite."""
    k, spread = parameters.neighbours.k, parameters.removal.weighs_evidence
    nothing = _nothing(len(inside), parameters)
    unknown = np.full(len(inside), np.inf)
    alone = bool(np.isinf(region.low).all() and np.isinf(region.high).all())
    if len(inside) < (SMALLEST_CLUSTER if alone else k):
        return HullDensities(nothing[0], unknown, nothing[1])
    if parameters.density.device == "reference":
        if not alone:
            return HullDensities(nothing[0], unknown, nothing[1])
        return HullDensities(
            reference_densities(inside.xyz, inside.rows, k),
            unknown,
            reference_spreads(inside.xyz, inside.rows, k if spread else 0),
        )
    return hull_densities(inside.xyz, inside.rows, k, queries=queries, spread=spread)


class _Rest:
    """What is left to do of a tile: points that may have a neighbour beyond the region.

    Parameters are those of `core_densities`, and the clusters of all points.
    """

    def __init__(
        self,
        known: FreePoints,
        membership: NDArray[np.int32],
        region: Region,
        others: OtherTiles,
        clusters: Clusters,
        parameters: MethodParameters,
    ) -> None:
        self._known = known
        self._membership = membership
        self._region = region
        self._others = others
        self._clusters = clusters
        self._parameters = parameters

    def within_reach(self, queries: NDArray[np.intp], reach: NDArray[np.float64]) -> _Found:
        """Return density and spread of points that have k neighbours inside.

        Nothing farther than the last of these can be a neighbour: so all that may be is gathered
        once, and queries of one cluster and of like reach are done together.
        """
        density, spread = _nothing(len(queries), self._parameters)
        cluster_of, octaves = self._membership[queries], np.frexp(reach)[1]
        groups = {
            group: np.flatnonzero((cluster_of == group[0]) & (octaves == group[1]))
            for group in set(zip(cluster_of.tolist(), octaves.tolist(), strict=True))
        }
        vicinities = {
            group: Vicinity(self._known.xyz[queries[slots]], reach[slots])
            for group, slots in groups.items()
        }
        beyond = self._beyond(vicinities)
        from_border = self._region.distance_to_border(self._known.xyz)
        for (cluster, octave), slots in groups.items():
            vicinity, outside = vicinities[cluster, octave], beyond[cluster]
            # Queries are no farther from the border than they reach.
            close = from_border <= 2.001 * vicinity.reach
            near = np.flatnonzero(close & (self._membership == cluster))
            near = near[vicinity.holds(self._known.xyz.take(near, axis=0))]
            also_near = outside.select(vicinity.holds(outside.xyz))
            density[slots], spread[slots] = self._densities(near, also_near, queries[slots])
        return density, spread

    def _densities(
        self, near: NDArray[np.intp], outside: FreePoints, queries: NDArray[np.intp]
    ) -> _Found:
        """Score known points by known points near them, and by others."""
        inside = self._known.select(near)
        xyz = np.concatenate([inside.xyz, outside.xyz])
        rows = np.concatenate([inside.rows, outside.rows])
        chosen = np.zeros(len(rows), np.bool_)
        chosen[np.searchsorted(near, queries)] = True
        found = hull_densities(
            xyz,
            rows,
            self._parameters.neighbours.k,
            queries=chosen,
            spread=self._parameters.removal.weighs_evidence,
        )
        return found.density[chosen], found.spread[chosen]

    def _beyond(self, vicinities: Mapping[tuple[int, int], Vicinity]) -> dict[int, FreePoints]:
        """Gather the points of other tiles that queries reach, by cluster; each tile is read once.

        Only points of a query's own cluster are kept: where few are near in this one, the reach is
        long, and holds many points of others.
        """
        nothing = self._known.select(np.zeros(0, np.intp))
        gathered = {cluster: [nothing] for cluster, _ in vicinities}

        def near(low: NDArray[np.float64], high: NDArray[np.float64]) -> NDArray[np.bool_]:
            met = [each.meets(low, high) for each in vicinities.values()]
            return np.asarray(np.any(met, axis=0))

        for tile in self._others_met(list(vicinities.values())):
            points = self._others.free_points(tile, near)
            from_border = -self._region.distance_to_border(points.xyz)
            held = np.zeros(len(points), np.bool_)
            for vicinity in vicinities.values():
                close = np.flatnonzero(from_border <= 1.001 * vicinity.reach)
                held[close] |= vicinity.holds(points.xyz.take(close, axis=0))
            points = points.select(held)
            points = points.select(~self._region.holds(points.xyz))
            membership = self._clusters.nearest(points.xyz)
            for cluster, parts in gathered.items():
                own = points.select(membership == cluster)
                reached = np.zeros(len(own), np.bool_)
                for (of_cluster, _), vicinity in vicinities.items():
                    if of_cluster == cluster:
                        reached |= vicinity.holds(own.xyz)
                parts.append(own.select(reached))
        return {
            cluster: FreePoints(
                np.concatenate([part.xyz for part in parts]),
                np.concatenate([part.rows for part in parts]),
            )
            for cluster, parts in gathered.items()
        }

    def _others_met(self, vicinities: Sequence[Vicinity]) -> Iterator[int]:
        """Yield the other tiles that queries reach."""
        if not vicinities:
            return
        low = np.min([vicinity.low for vicinity in vicinities], axis=0)
        high = np.max([vicinity.high for vicinity in vicinities], axis=0)
        for tile in self._others.near(low, high):
            box = [corner[None] for corner in self._others.box(tile)]
            if any(vicinity.meets(*box)[0] for vicinity in vicinities):
                yield tile

    def wherever(self, queries: NDArray[np.intp], reach: NDArray[np.float64]) -> _Found:
        """Return density and spread of points, wherever their neighbours are."""
        of_cluster = {
            int(cluster): np.flatnonzero(self._membership[queries] == cluster)
            for cluster in np.unique(self._membership[queries])
        }
        searches = {}
        for cluster, slots in of_cluster.items():
            centres = self._known.xyz[queries[slots]]
            searches[cluster] = NearestSoFar(centres, self._parameters.neighbours.k, reach[slots])
            searches[cluster].offer(
                self._known.select(self._membership == cluster), np.arange(len(slots))
            )
        for tile in self._others.near(*_bounds_of_all(searches.values())):
            box = self._others.box(tile)
            reaching = {
                cluster: slots
                for cluster, search in searches.items()
                if len(slots := search.reaching(*box))
            }
            if not reaching:
                continue
            low, high = _bounds_of_all(searches[cluster] for cluster in reaching)
            reached = Region(low, np.nextafter(high, np.inf))
            points = self._others.free_points(tile, reached.meets)
            within = reached.holds(points.xyz)
            points = points.select(within & ~self._region.holds(points.xyz))
            membership = self._clusters.nearest(points.xyz)
            for cluster, slots in reaching.items():
                searches[cluster].offer(points.select(membership == cluster), slots)
        density, spread = _nothing(len(queries), self._parameters)
        for cluster, slots in of_cluster.items():
            for slot, neighbours in searches[cluster].neighbourhoods():
                one = slice(slots[slot], slots[slot] + 1)
                density[one], spread[one] = self._of_one(queries[slots[slot]], neighbours)
        return density, spread

    def _of_one(self, query: np.intp, neighbours: FreePoints) -> _Found:
        """Return density and spread of one point, of which the neighbours are known."""
        k, spread = self._parameters.neighbours.k, self._parameters.removal.weighs_evidence
        if len(neighbours) < SMALLEST_CLUSTER:
            return _nothing(1, self._parameters)
        if self._parameters.density.device == "reference":
            centre = self._known.xyz[query][None]
            return (
                reference_densities(neighbours.xyz, neighbours.rows, k, centres=centre),
                reference_spreads(neighbours.xyz, neighbours.rows, k if spread else 0, centre),
            )
        chosen = neighbours.rows == self._known.rows[query]
        found = hull_densities(neighbours.xyz, neighbours.rows, k, queries=chosen, spread=spread)
        return found.density[chosen], found.spread[chosen]


def _bounds_of_all(
    searches: Iterable[NearestSoFar],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return a box that no neighbour of any query lies outside of."""
    low, high = zip(*(search.bounds() for search in searches), strict=True)
    return np.min(low, axis=0), np.max(high, axis=0)
