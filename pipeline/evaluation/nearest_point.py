"""The nearest point of a tiled cloud, exact whatever the tiles.

A place asks the tiles in the order of their distance, until none is left that may hold a point as
near as the nearest so far: distances of boxes are computed as those of points are, and rounding is
monotonic. Of a tile only those points are looked at that some place may reach.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels import NO_RANK, NearestSearch
from dynahull.progress import Observer
from pipeline.evaluation.labels import Labels, Truth
from pipeline.evaluation.tiled_cloud import TiledCloud
from pipeline.plan.machine import available_cores

_Floats = NDArray[np.float64]


class Nearest(NamedTuple):
    """What is nearest to some places."""

    distances: _Floats
    """(m,): infinite where nothing is near enough."""
    labels: Labels
    """(m,): `Truth` of the nearest point: of equally near ones the first in the order of `Truth`,
    so that no order of rows matters; unknown where nothing is near enough."""


def find_nearest(places: _Floats, cloud: TiledCloud, at_most: float = np.inf) -> Nearest:
    """Find the nearest point of a cloud to each of some places, (m, 3), which lie close together.

    Where nothing is as near as `at_most`, nothing is found.
    """
    # A hair more: squares are rounded, and what is found is compared with the bound itself.
    bound = (at_most * (1 + 1e-12)) ** 2
    search = NearestSearch(places, bound, available_cores("auto"))
    low, high = places.min(axis=0), places.max(axis=0)
    tiles = np.flatnonzero(cloud.counts)
    tile_low, tile_high = cloud.low[tiles], cloud.high[tiles]
    gaps = _squared_gaps(tile_low, tile_high, low, high)
    # Of tiles that the box of the places meets, the one whose middle is nearest to its own first.
    apart = np.square((tile_low + tile_high) / 2 - (low + high) / 2).sum(axis=1)
    for at in np.lexsort((apart, gaps)).tolist():
        if gaps[at] > search.squared.max():
            break
        tile = int(tiles[at])
        own = _squared_gaps(places, places, cloud.low[tile], cloud.high[tile])
        asking = np.flatnonzero(own <= search.squared)
        if len(asking):
            points, labels = cloud.xyz(tile), cloud.labels(tile)
            near = places[asking]
            reach = search.squared[asking].max()
            of_points = _squared_gaps(points, points, near.min(axis=0), near.max(axis=0))
            reached = of_points <= reach
            search.offer(points[reached], labels[reached].astype(np.int64), asking)
    distances = np.sqrt(search.squared)
    found = (search.rank != NO_RANK) & (distances <= at_most)
    return Nearest(
        np.where(found, distances, np.inf),
        np.where(found, search.rank, Truth.UNKNOWN).astype(np.int8),
    )


def _squared_gaps(low: _Floats, high: _Floats, box_low: _Floats, box_high: _Floats) -> _Floats:
    """Return the squared distance of each of some boxes, or points, from a box, (n,)."""
    dx, dy, dz = np.maximum(np.maximum(low - box_high, box_low - high), 0.0).T
    return np.asarray((dx * dx + dy * dy) + dz * dz)


def look_up(
    cloud: TiledCloud, other: TiledCloud, observer: Observer, stage: str, at_most: float = np.inf
) -> Iterator[tuple[int, Nearest]]:
    """Look up every point of a cloud in another; yield what is nearest to each tile's points."""
    observer.stage(stage, len(cloud))
    for tile, count in enumerate(cloud.counts.tolist()):
        if count:
            yield tile, find_nearest(cloud.xyz(tile), other, at_most)
            observer.advance(count)
