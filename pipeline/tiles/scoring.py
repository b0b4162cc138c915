"""The task that scores one tile, and the one that labels its points."""

import json
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.clustering import Clusters, fit_clusters
from dynahull.density import SMALLEST_CLUSTER
from dynahull.labels import Label
from dynahull.rescale import removal_percentages
from dynahull.result import NO_CLUSTER
from pipeline.borders import core_densities
from pipeline.nearest import FreePoints
from pipeline.selection import Cut, ScoredPoints, find_cuts
from pipeline.tiles.division import divided, widened
from pipeline.tiles.ground import (
    AROUND_NAMES,
    LABEL_NAMES,
    OWN_NAMES,
    SAMPLE_NAMES,
    TilesAround,
    region_of,
)
from pipeline.tiles.job import Job
from pipeline.tiles.work import TaskReport

CUTS_FILE = "cuts.json"
SCORE_NAMES = ("cluster", "density", "rows")

_NEIGHBOURS_WITHIN = 2.0
"""Metres around a part of a tile that most neighbours are found in; the others are looked for."""


def score_tile(job: Job, tile: int, sides: int = 1) -> TaskReport:
    """Find cluster and density of the ground-free points of a tile's core.

    Where the memory does not suffice for the tile, `sides` x `sides` parts of it are done one
    after the other. The report counts the points finished from further tiles, then those of each
    cluster.
    """
    own_xyz, own_rows = job.work.load("ground", tile, *OWN_NAMES)
    around_xyz, around_rows = job.work.load("ground", tile, *AROUND_NAMES)
    xyz, rows = np.concatenate([own_xyz, around_xyz]), np.concatenate([own_rows, around_rows])
    core = np.arange(len(rows)) < len(own_rows)
    clusters = clusters_of(job, tile)
    region = region_of(job, tile)
    # Around a part lies the rest of the tile, as other tiles lie around the tile.
    others = TilesAround(job, tile if sides == 1 else None)
    cluster, density = np.zeros(len(rows), np.int32), np.full(len(rows), np.nan)
    finished_elsewhere = 0
    for box in divided(region, xyz, sides):
        around = widened(box, _NEIGHBOURS_WITHIN, region)
        known = np.flatnonzero(around.holds(xyz))
        own = core[known] & box.holds(xyz[known])
        scores = core_densities(
            FreePoints(xyz[known], rows[known]),
            own,
            around,
            others,
            clusters,
            job.configuration.method(),
        )
        cluster[known[own]], density[known[own]] = scores.cluster, scores.density
        finished_elsewhere += scores.finished_elsewhere
    job.work.save(
        "density",
        tile,
        cluster=cluster[core],
        density=density[core],
        rows=rows[core],
        centroids=clusters.centroids,
    )
    counts = np.bincount(cluster[core], minlength=len(clusters.centroids))
    points = int(job.store.layout.counts[tile])
    return TaskReport(points, (finished_elsewhere, *counts.tolist()))


def clusters_of(job: Job, tile: int) -> Clusters:
    """Return the model of the map, or fit that of a tile on the sample of its points."""
    if job.configuration.clustering.scope == "map":
        return job.clusters
    sample, _ = job.work.load("ground", tile, *SAMPLE_NAMES)
    return fit_clusters(sample, job.configuration.clustering)


def scored_points(job: Job, tile: int) -> ScoredPoints:
    """Return what `score_tile` kept of a tile."""
    return ScoredPoints(*job.work.load("density", tile, *SCORE_NAMES))


def save_cuts(job: Job, counts: list[int], cuts: list[Cut] | None) -> None:
    """Keep what all tiles together say of the removal: N_i, and the cut of each cluster.

    With one model a tile there are no cuts yet: only the smallest and the largest N_i are kept,
    which is all that Eq. 1 asks of other tiles.
    """
    values = {
        "counts": counts if cuts is not None else [min(counts), max(counts)],
        "cuts": None if cuts is None else [(cut.density, int(cut.last_row)) for cut in cuts],
    }
    job.work.write_json(job.root / CUTS_FILE, values)


def label_tile(job: Job, tile: int) -> TaskReport:
    """Label the points of a tile's core; keep the labels, and clusters and densities if wanted.

    The report counts the points of each label, then those removed from each cluster.
    """
    core_rows, labels = job.work.load("ground", tile, *LABEL_NAMES)
    scored = scored_points(job, tile)
    counts, cuts = _cuts_of(job, tile, scored)
    removed = []
    place = np.searchsorted(core_rows, scored.rows)
    for cluster, (count, cut) in enumerate(zip(counts, cuts, strict=True)):
        members = np.flatnonzero(scored.cluster == cluster)
        if count < SMALLEST_CLUSTER:
            labels[place[members]] = Label.UNSCORED
        dynamic = cut.dynamic(scored.density[members], scored.rows[members])
        labels[place[members[dynamic]]] = Label.DYNAMIC
        removed.append(int(np.count_nonzero(dynamic)))
    kept: dict[str, NDArray[Any]] = {"label": labels}
    if job.configuration.output.needs_scores:
        kept["cluster"] = np.full(len(core_rows), NO_CLUSTER, np.int32)
        kept["cluster"][place] = scored.cluster + first_cluster(job, tile)
        kept["density"] = np.full(len(core_rows), np.nan)
        kept["density"][place] = scored.density
    if job.configuration.clustering.scope == "tile":
        limits = [np.nan if cut.density is None else cut.density for cut in cuts]
        kept["thresholds"] = np.array(limits)
    job.work.save("label", tile, **kept)
    found = np.bincount(labels, minlength=len(Label)).tolist()
    return TaskReport(len(core_rows), (*found, *removed))


def _cuts_of(job: Job, tile: int, scored: ScoredPoints) -> tuple[list[int], list[Cut]]:
    """Return N_i and the cut of every cluster that the tile's points may be in."""
    stored = json.loads((job.root / CUTS_FILE).read_text(encoding="utf-8"))
    if stored["cuts"] is not None:
        return stored["counts"], [Cut(density, row) for density, row in stored["cuts"]]
    report = job.work.report("density", tile)
    counts = list(report.counts[1:]) if report else []
    percentages = tile_percentages(job, counts, stored["counts"])
    threshold = job.configuration.removal.threshold
    return counts, find_cuts(lambda: [scored], counts, percentages, threshold)


def first_cluster(job: Job, tile: int) -> int:
    """Return the number, in the whole map, of a tile's first cluster."""
    clustering = job.configuration.clustering
    return tile * clustering.count if clustering.scope == "tile" else 0


def tile_percentages(job: Job, counts: list[int], extremes: list[int]) -> Sequence[Fraction]:
    """Return R_i of some clusters (Eq. 1), given the smallest and the largest N_i of the map."""
    removal = job.configuration.removal
    together = removal_percentages([*counts, *extremes], removal.min_percent, removal.max_percent)
    return together[: len(counts)]
