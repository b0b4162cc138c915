"""The task that keeps, of one tile, the points that the report shows; and what all of them give."""

import numpy as np

from dynahull.result import NO_CLUSTER
from pipeline.report_page.sample import ARRAY_NAMES, MapSample, is_sampled
from pipeline.report_page.tile_chart import TileWork
from pipeline.tiles.job import JOB_FILE, Job
from pipeline.tiles.rows import open_rows
from pipeline.tiles.scoring import first_cluster, scored_points
from pipeline.tiles.work import TaskReport
from tiling.chunks import read_chunk

_STAGES_OF_A_TILE = ("chunk", "ground", "density", "label", "sample")


def sample_tile(job: Job, tile: int) -> TaskReport:
    """Keep the sampled points of a tile's core, with their labels, clusters and densities."""
    total = job.collection.point_count
    chunk = read_chunk(job.store, tile)
    own = chunk.select(chunk.core & is_sampled(chunk.rows, total))
    scored = scored_points(job, tile)
    wanted = is_sampled(scored.rows, total)
    cluster = np.full(len(own), NO_CLUSTER, np.int32)
    density = np.full(len(own), np.nan)
    # Both are in the order of the rows.
    place = np.searchsorted(own.rows, scored.rows[wanted])
    cluster[place] = scored.cluster[wanted] + first_cluster(job, tile)
    density[place] = scored.density[wanted]
    labels = open_rows(job.rows_path("label"), np.uint8)[own.rows]
    sample = MapSample(total, own.rows, own.xyz, labels, cluster, density)
    job.work.save("sample", tile, **sample.to_arrays())
    return TaskReport(int(job.store.layout.counts[tile]))


def gather_sample(job: Job) -> MapSample:
    """Return the sample of the map: that of all its tiles."""
    total = job.collection.point_count
    parts = [
        MapSample(total, *job.work.load("sample", tile, *ARRAY_NAMES))
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
