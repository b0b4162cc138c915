"""The task that scores one tile."""

import numpy as np
from numpy.typing import NDArray

from dynahull.clustering import Clusters, fit_clusters
from dynahull.density import SPREAD_COLUMNS
from dynahull.warn import density_levels
from pipeline.tiles.borders import core_densities
from pipeline.tiles.division import divided, widened
from pipeline.tiles.ground import (
    AROUND_NAMES,
    OWN_NAMES,
    OWN_ROWS,
    SAMPLE_NAMES,
    TilesAround,
    region_of,
)
from pipeline.tiles.nearest import FreePoints
from pipeline.tiles.thresholds import ScoredPoints
from pipeline.tiles.weighing import scored_voxels
from pipeline.work.folder import TaskReport
from pipeline.work.job import Job

_NEIGHBOURS_WITHIN = 2.0
"""Metres around a part of a tile that most neighbours are found in; the others are looked for."""


def score_tile(job: Job, tile: int, sides: int = 1) -> TaskReport:
    """Find cluster and density of the ground-free points of a tile's core.

    Where the memory does not suffice for the tile, `sides` x `sides` parts of it are done one
    after the other. The report counts the points finished from further tiles, then those of each
    cluster.
    """
    free, core = _points_of_region(job, tile)
    xyz = free.xyz
    clusters = clusters_of(job, tile)
    region = region_of(job, tile)
    # Around a part lies the rest of the tile, as other tiles lie around the tile.
    others = TilesAround(job, tile if sides == 1 else None)
    cluster, density = np.zeros(len(free), np.int32), np.full(len(free), np.nan)
    columns = SPREAD_COLUMNS if job.configuration.removal.weighs_evidence else 0
    spread = np.full((len(free), columns), np.nan, np.float32)
    finished_elsewhere = 0
    for box in divided(region, xyz, sides):
        around = widened(box, _NEIGHBOURS_WITHIN, region)
        known = np.flatnonzero(around.holds(xyz))
        own = core[known] & box.holds(xyz[known])
        scores = core_densities(
            free if len(known) == len(free) else free.select(known),
            own,
            around,
            others,
            clusters,
            job.configuration.method(),
        )
        cluster[known[own]], density[known[own]] = scores.cluster, scores.density
        spread[known[own]] = scores.spread
        finished_elsewhere += scores.finished_elsewhere
    scored = ScoredPoints(cluster[core], density[core], free.rows[core])
    voxels = scored_voxels(job, tile, scored.density, spread[core]) if columns else {}
    order = np.argsort(scored.cluster, kind="stable")
    job.work.save(
        "density",
        tile,
        **voxels,
        grouped=scored.density[order],
        starts=np.searchsorted(scored.cluster[order], np.arange(len(clusters.centroids) + 1)),
        levels=density_levels(scored.density),
        centroids=clusters.centroids,
        cluster=scored.cluster,
        density=scored.density,
    )
    counts = np.bincount(scored.cluster, minlength=len(clusters.centroids))
    points = int(job.store.layout.counts[tile])
    return TaskReport(points, (finished_elsewhere, *counts.tolist()))


def _points_of_region(job: Job, tile: int) -> tuple[FreePoints, NDArray[np.bool_]]:
    """Return the ground-free points that a tile knows, and which of them are its own."""
    # Joined as they are read, so that nothing is there twice.
    xyz, rows = (
        [job.work.map("ground", tile, name) for name in names]
        for names in zip(OWN_NAMES, AROUND_NAMES, strict=True)
    )
    points = FreePoints(np.concatenate(xyz), np.concatenate(rows))
    return points, np.arange(len(points)) < len(rows[0])


def clusters_of(job: Job, tile: int) -> Clusters:
    """Return the model of the map, or fit that of a tile on the sample of its points."""
    if job.configuration.clustering.scope == "map":
        return job.clusters
    sample, _ = job.work.load("ground", tile, *SAMPLE_NAMES)
    return fit_clusters(sample, job.configuration.clustering)


def first_cluster(job: Job, tile: int) -> int:
    """Return the number, in the whole map, of a tile's first cluster."""
    clustering = job.configuration.clustering
    return tile * clustering.count if clustering.scope == "tile" else 0


_BY_ROW = ("cluster", "density")


def scored_points(job: Job, tile: int) -> ScoredPoints:
    """Return the scores of a tile."""
    scores = job.work.load("density", tile, *_BY_ROW)
    return ScoredPoints(*scores, *job.work.load("ground", tile, OWN_ROWS))


class KeptScores:
    """The scores of a tile as `pipeline.tiles.thresholds.find_cuts` looks them up."""

    def __init__(self, job: Job, tile: int) -> None:
        self._job = job
        self._tile = tile

    def densities(self, cluster: int) -> NDArray[np.float64]:
        """Return the densities of its points in a cluster."""
        (starts,) = self._job.work.load("density", self._tile, "starts")
        grouped = self._job.work.map("density", self._tile, "grouped")
        return grouped[starts[cluster] : starts[cluster + 1]]

    def rows_at(self, cluster: int, density: float) -> NDArray[np.int64]:
        """Return the row numbers of its points in a cluster that have just this density."""
        scored = scored_points(self._job, self._tile)
        tied = (scored.cluster == cluster) & (scored.density == density)
        return np.asarray(scored.rows[tied])
