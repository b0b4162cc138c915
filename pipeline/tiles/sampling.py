"""The points that the report shows, of one tile and of all, and what the tiles took."""

import numpy as np
from numpy.typing import NDArray

from dynahull.result import NO_CLUSTER
from pipeline.outputs.map_sample import ARRAY_NAMES, MapSample, is_sampled
from pipeline.report_page.charts import TileWork
from pipeline.tiles.density import first_cluster
from pipeline.tiles.ground import SHOWN_NAMES
from pipeline.tiles.thresholds import ScoredPoints
from pipeline.work.job import JOB_FILE, Job

_STAGES_OF_A_TILE = ("ground", "density", "evidence", "label")


def shown_points(
    job: Job,
    tile: int,
    core_rows: NDArray[np.int64],
    core_labels: NDArray[np.uint8],
    scored: ScoredPoints,
    score_of: NDArray[np.float32] | None,
) -> MapSample:
    """Return the sampled points of a tile's core, and what became of them.

    `score_of` says how likely the points that are `scored` have moved, if that was asked.
    """
    total = job.collection.point_count
    xyz, rows = job.work.load("ground", tile, *SHOWN_NAMES)
    wanted = is_sampled(scored.rows, total)
    cluster = np.full(len(rows), NO_CLUSTER, np.int32)
    density = np.full(len(rows), np.nan)
    place = np.searchsorted(rows, scored.rows[wanted])  # rows are in order
    cluster[place] = scored.cluster[wanted] + first_cluster(job, tile)
    density[place] = scored.density[wanted]
    score = np.full(len(rows), np.nan, np.float32)
    if score_of is not None:
        score[place] = score_of[wanted]
    labels = core_labels[np.searchsorted(core_rows, rows)]
    return MapSample(total, rows, xyz, labels, cluster, density, score)


def gather_sample(job: Job) -> MapSample:
    """Return the sample of the map: that of all its tiles."""
    total = job.collection.point_count
    parts = [
        MapSample(total, *job.work.load("label", tile, *ARRAY_NAMES))
        for tile in range(len(job.store.layout))
    ]
    return MapSample.of_parts(total, parts)


def tile_work(job: Job) -> TileWork:
    """Return what the tiles took, as their tasks report it."""
    layout = job.store.layout
    tiles = range(len(layout))
    begun = (job.root / JOB_FILE).stat().st_mtime
    seconds, finished = np.zeros(len(tiles)), np.zeros(len(tiles))
    for tile in tiles:
        for stage in _STAGES_OF_A_TILE:
            report = job.work.report(stage, tile)
            if report is not None:
                seconds[tile] += report.seconds
        finished[tile] = job.work.path("density", tile, ".done").stat().st_mtime
    overfull = np.zeros(len(tiles), np.bool_)
    overfull[layout.overfull(job.configuration.tiling.max_points)] = True
    return TileWork(layout.low, layout.high, layout.counts, seconds, finished < begun, overfull)
