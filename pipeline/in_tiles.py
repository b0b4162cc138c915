"""A map of several tiles: cleaned tile by tile by workers."""

from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

import numpy as np

from pipeline.cleaned_map import CleanedMap
from pipeline.cluster.choice import workers_for
from pipeline.decision import Decision
from pipeline.outputs.folder import OutputNames
from pipeline.plan.plan import check_plan
from pipeline.progress import StageObserver
from pipeline.report_page.page import Views
from pipeline.tiles.cleaning import TiledResult, clean_tiles
from pipeline.tiles.labelling import gather_decision
from pipeline.tiles.sampling import gather_sample, tile_work
from pipeline.tiles.writing import BATCH, kept_scores
from pipeline.work.job import Job
from pipeline.work.rows import open_rows
from pipeline.write_results import write_maps
from tiling.collection import MapCollection
from tiling.formats import PointBatch


def clean_in_tiles(
    job: Job,
    collection: MapCollection,
    names: OutputNames,
    staging: Path,
    observer: StageObserver,
) -> CleanedMap:
    """Clean a map of several tiles, and write its results."""
    observer.finish()  # workers may be long in coming
    with workers_for(job) as executor:
        result = clean_tiles(
            job,
            executor,
            observer,
            lambda plan: check_plan(plan, job.configuration, job.root),
        )
        labels = open_rows(job.rows_path("label"), np.uint8)
        decision = gather_decision(job) if job.configuration.removal.weighs_evidence else None
        views, tiles = None, None
        if job.configuration.output.report == "html":
            views = partial(_views, job, result, decision)
            tiles = tile_work(job)
        output = job.configuration.output
        cluster, density, score = None, None, None
        if output.needs_scores:
            cluster = open_rows(job.rows_path("cluster"), np.int32)
            density = open_rows(job.rows_path("density"), np.float64)
            score = open_rows(job.rows_path("score"), np.float32)
        write_maps(
            collection,
            output,
            labels,
            kept_scores(job),
            names,
            staging,
            observer,
            job,
            executor,
            read=_decoded_batches(job),
        )
    return CleanedMap(
        labels, cluster, density, score, result.counts, result.clusters, decision, views, tiles
    )


def _views(job: Job, result: TiledResult, decision: Decision | None) -> Views:
    """Return what the report shows."""
    return Views.of(gather_sample(job), result.clusters, job.configuration.removal, decision)


def _decoded_batches(job: Job) -> Callable[[int], Iterable[PointBatch]] | None:
    """Return what gives the points of a file of the map, where their records were kept."""
    decoded = job.decoded
    if decoded is None or not decoded.has_records:
        return None
    return lambda file: decoded.batches_of(file, BATCH)
