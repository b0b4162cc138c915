"""A map of several tiles: cleaned tile by tile by workers."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

import numpy as np

from dynahull.result import ClusterSummary
from pipeline.cluster.choice import workers_for
from pipeline.outputs.folder import OutputNames
from pipeline.outputs.writing import CleanedMap, make_places, write_maps
from pipeline.places import Decision
from pipeline.plan.plan import check_plan
from pipeline.progress import StageObserver
from pipeline.report_page.page import Views
from pipeline.tiles.cleaning import clean_tiles, find_times
from pipeline.tiles.labelling import SCORES, gather_decision, gather_sample, tile_work
from pipeline.tiles.stages import do_stage, exhaust
from pipeline.tiles.writing import finish_parts, growing_outputs, kept_scores, plan_parts
from pipeline.work.files import open_rows
from pipeline.work.job import Job
from pipeline.workers.executors import Executor
from tiling.collection import MapCollection
from tiling.formats.points import DEFAULT_BATCH


def clean_in_tiles(
    job: Job, collection: MapCollection, names: OutputNames, staging: Path, observer: StageObserver
) -> CleanedMap:
    """Clean a map of several tiles, and write its results."""
    find_times(job, collection, observer)
    observer.finish()  # workers may be long in coming
    with workers_for(job) as executor:
        counts, clusters = clean_tiles(
            job, executor, observer, lambda plan: check_plan(plan, job.configuration, job.root)
        )
        labels = open_rows(job.rows_path("label"), np.uint8)
        decision = gather_decision(job)
        views, tiles = None, None
        if job.configuration.output.report == "html":
            views = partial(_views, job, clusters, decision)
            tiles = tile_work(job)
        output = job.configuration.output
        rows = {"label": labels}
        if output.needs_scores:
            rows |= {n: open_rows(job.rows_path(n), kind) for n, (kind, _) in SCORES.items()}
        places = make_places(names, staging)
        in_parts = [] if output.merge else _write_in_parts(job, executor, observer, places)
        decoded, read = job.decoded, None
        if decoded is not None and decoded.has_records:
            read = partial(decoded.batches_of, max_points=DEFAULT_BATCH)
        scores = kept_scores(job)
        write_maps(collection, output, labels, scores, places, observer, in_parts, read)
    return CleanedMap(
        rows,
        counts,
        clusters,
        decision,
        views,
        tiles,
        str(job.scan_source or "none") if job.configuration.removal.weighs_evidence else None,
    )


def _views(job: Job, clusters: Sequence[ClusterSummary], decision: Decision) -> Views:
    return Views.of(gather_sample(job), clusters, job.configuration.removal, decision)


def _write_in_parts(
    job: Job, executor: Executor, observer: StageObserver, outputs: Sequence[tuple[Path, ...]]
) -> list[int]:
    """Write the outputs of the files of the map that can be written in parts; return these files.

    They grow in the work folder, where a run that goes on finds what is done of them.
    """
    plan = plan_parts(job)
    if plan.parts:
        rows = [len(part.rows) for part in plan.parts]
        exhaust(do_stage(job, executor, observer, "write", rows))
    finish_parts(job, plan)
    for file in plan.points:
        growing = growing_outputs(job, file, len(outputs[file]))
        for grown, place in zip(growing, outputs[file], strict=True):
            grown.replace(place)
    return list(plan.points)
