"""The task that scores one tile."""

from collections.abc import Iterator
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.clustering import Clusters, fit_clusters
from dynahull.density import SPREAD_COLUMNS
from dynahull.evidence.range_images import Returns
from dynahull.evidence.summaries import (
    ScoredPoints,
    about_middles,
    summarise_ground,
    summarise_points,
)
from dynahull.evidence.voxels import Voxels
from dynahull.labels import Label
from dynahull.warn import density_levels
from pipeline.tiles.borders import CoreDensities, Region, core_densities
from pipeline.tiles.free_points import TilesAround
from pipeline.tiles.ground import SAMPLE_NAMES, labelled_points, own_rows, region_of
from pipeline.tiles.nearest import FreePoints
from pipeline.work.folder import TaskReport
from pipeline.work.job import SAMPLE, Job
from tiling.chunks import Chunk

VOXELS = "voxels"
RETURNS = ("counts", "returns")

_NEIGHBOURS_WITHIN = 2.0
"""Metres around a part of a tile that most neighbours are found in; the others are looked for."""


def score_tile(job: Job, tile: int, sides: int = 1) -> TaskReport:
    """Find cluster and density of the ground-free points of a tile's core.

    Where the memory does not suffice for the tile, `sides` x `sides` parts of it are done one
    after the other. The report counts the points finished from further tiles, then those of each
    cluster.
    """
    chunk, labels = labelled_points(job, tile)
    weighs = job.configuration.removal.weighs_evidence
    returns = _returns_of(job, chunk)
    unscored = chunk.core & (labels != Label.STATIC)
    voxels = []
    if weighs:
        scans = job.scans_of(chunk.rows[unscored])
        voxels.append(summarise_ground(chunk.xyz[unscored], scans))
    known = np.flatnonzero(labels == Label.STATIC)
    free, core = FreePoints(chunk.xyz[known], chunk.rows[known]), chunk.core[known]
    del chunk, labels, unscored, known
    clusters = clusters_of(job, tile)
    scores = _core_scores(job, tile, sides, free, core, clusters)
    cluster, density = scores.cluster, scores.density
    if weighs:
        unknown, scans = np.full(len(density), np.nan), job.scans_of(free.rows[core])
        points = ScoredPoints(free.xyz[core], density, scores.spread, unknown, scans)
        voxels.append(summarise_points(points))
        summed = about_middles(Voxels.merged(voxels)).to_arrays(VOXELS)
        job.work.make("spread")
        job.work.save("spread", tile, spread=points.spread, **summed, **returns)
    counts = np.bincount(cluster, minlength=len(clusters.centroids)).tolist()
    job.work.save(
        "density",
        tile,
        {"grouped": density[_by_cluster(cluster)]},
        cluster=cluster,
        starts=np.cumsum([0, *counts]),
        levels=density_levels(density),
        centroids=clusters.centroids,
    )
    elsewhere = scores.finished_elsewhere
    return TaskReport(int(job.store.layout.counts[tile]), (elsewhere, *counts))


def _core_scores(
    job: Job,
    tile: int,
    sides: int,
    free: FreePoints,
    core: NDArray[np.bool_],
    clusters: Clusters,
) -> CoreDensities:
    """Score the points of a tile's core, one part of the tile after the other."""
    xyz, region, parameters = free.xyz, region_of(job, tile), job.configuration.method()
    # Around a part lies the rest of the tile, as other tiles lie around the tile.
    others = TilesAround(job, tile if sides == 1 else None)
    cluster, density = np.zeros(len(free), np.int32), np.full(len(free), np.nan)
    columns = SPREAD_COLUMNS if parameters.removal.weighs_evidence else 0
    spread = np.full((len(free), columns), np.nan, np.float32)
    finished_elsewhere = 0
    for box in divided(region, xyz, sides):
        around = widened(box, _NEIGHBOURS_WITHIN, region)
        known = np.flatnonzero(around.holds(xyz))
        own = core[known] & box.holds(xyz[known])
        points = free if len(known) == len(free) else free.select(known)
        scores = core_densities(points, own, around, others, clusters, parameters)
        cluster[known[own]], density[known[own]] = scores.cluster, scores.density
        spread[known[own]] = scores.spread
        finished_elsewhere += scores.finished_elsewhere
    return CoreDensities(cluster[core], density[core], spread[core], finished_elsewhere)


def _returns_of(job: Job, chunk: Chunk) -> dict[str, NDArray[Any]]:
    """Return what the points of a tile's core say of the scans' range images."""
    viewpoints, scans = job.viewpoints, job.scans_of(chunk.rows[chunk.core])
    if viewpoints is None or scans is None:
        return {}
    returns = Returns.of(chunk.xyz[chunk.core], viewpoints.rows(scans), viewpoints.places)
    return dict(zip(RETURNS, (returns.counts, returns.returns), strict=True))


SIDES = (2, 4)
"""In how many parts each way a tile is done that was too large, and again if it still was."""


def divided(region: Region, xyz: NDArray[np.float64], sides: int) -> list[Region]:
    """Cut a region into sides x sides boxes of about equally many points, some perhaps empty.

    A tile is worked on in such parts where the memory does not suffice for it as a whole. Its
    points stay those of one tile in all that is kept of it. Each place of the region is in just one
    box; they are cut first by x, and then by y.
    """
    if sides == 1:
        return [region]
    return [
        box
        for strip in _strips(region, xyz[region.holds(xyz), 0], 0, sides)
        for box in _strips(strip, xyz[strip.holds(xyz), 1], 1, sides)
    ]


def widened(box: Region, margin: float, limits: Region) -> Region:
    """Return a box with a margin around it, as far as it lies within limits."""
    return Region(
        np.maximum(box.low - margin, limits.low), np.minimum(box.high + margin, limits.high)
    )


def _strips(region: Region, places: NDArray[np.float64], axis: int, count: int) -> Iterator[Region]:
    """Cut a region across one axis, where its points are."""
    ranks = np.arange(1, count) * len(places) // count
    inner = np.partition(places, ranks)[ranks] if len(places) else places
    edges = [region.low[axis], *inner, region.high[axis]]
    for start, end in pairwise(edges):
        low, high = region.low.copy(), region.high.copy()
        low[axis], high[axis] = start, end
        yield Region(low, high)


def clusters_of(job: Job, tile: int) -> Clusters:
    """Return the model of the map, or fit that of a tile on the sample of its points."""
    if job.configuration.clustering.scope == "map":
        return job.clusters
    sample, _ = job.work.load(SAMPLE, tile, *SAMPLE_NAMES)
    return fit_clusters(sample, job.configuration.clustering)


def first_cluster(job: Job, tile: int) -> int:
    """Return the number, in the whole map, of a tile's first cluster."""
    clustering = job.configuration.clustering
    return tile * clustering.count if clustering.scope == "tile" else 0


def scores_of(job: Job, tile: int) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return cluster and density of a tile's ground-free core points, in the order of rows."""
    cluster, grouped = job.work.load("density", tile, "cluster", "grouped")
    density = np.empty(len(cluster))
    density[_by_cluster(cluster)] = grouped
    return cluster, density


def _by_cluster(cluster: NDArray[np.int32]) -> NDArray[np.intp]:
    """Return the order of points by their cluster, and in it by their row."""
    return np.argsort(cluster, kind="stable")


class KeptScores:
    """The scores of a tile as `pipeline.tiles.thresholds.find_cuts` looks them up."""

    def __init__(self, job: Job, tile: int) -> None:
        self._job = job
        self._tile = tile

    def densities(self, cluster: int) -> NDArray[np.float64]:
        """Return the densities of its points in a cluster."""
        grouped = self._job.work.map("density", self._tile, "grouped")
        return grouped[self._starts[cluster] : self._starts[cluster + 1]]

    def rows_at(self, cluster: int, density: float) -> NDArray[np.int64]:
        """Return the row numbers of its points in a cluster that have just this density."""
        tied = np.flatnonzero(self.densities(cluster) == density)
        if not len(tied):
            return np.zeros(0, np.int64)
        (clusters,) = self._job.work.load("density", self._tile, "cluster")
        own = np.flatnonzero(clusters == cluster)[tied]
        return np.asarray(own_rows(self._job, self._tile)[own])

    @cached_property
    def _starts(self) -> NDArray[np.int64]:
        return self._job.work.load("density", self._tile, "starts")[0]
