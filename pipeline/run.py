"""One run: a map goes in, the cleaned map and the ghosts come out.

The map is streamed for its coordinates, and once more against one label a point, so that its
fields never pass through the method. A map of one tile is cleaned in memory; a larger one is cut
into tiles, whose work is shared out to workers and kept until all of it is done.
"""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

import numpy as np

from dynahull.errors import MissingClassificationError
from dynahull.ground.cloth import cloth_library
from dynahull.result import ClusterSummary
from pipeline.cluster.choice import workers_for
from pipeline.configuration.run import Configuration
from pipeline.errors import OutputError
from pipeline.in_memory import clean_in_memory
from pipeline.metres import open_collection
from pipeline.outputs.folder import OutputNames, default_folder, output_folder
from pipeline.outputs.map_sample import MapSample
from pipeline.outputs.modes import check_mode
from pipeline.outputs.run_report import RunReport
from pipeline.outputs.thinning import write_thinned
from pipeline.outputs.writing import CleanedMap, make_places, write_labels, write_maps
from pipeline.places import Decision
from pipeline.plan.machine import available_cores
from pipeline.plan.plan import check_plan
from pipeline.plan.resources import (
    check_one_tile,
    check_space,
    check_workers,
    is_one_tile,
    output_size,
    warn_of_tiling,
)
from pipeline.progress import StageObserver
from pipeline.replacing import CONFIGURATION_FILE, LABELS_FILE, REPORT_FILE, RUN_FILE
from pipeline.report_page.charts import TileWork
from pipeline.report_page.report_page import Views, render_page
from pipeline.scan_numbers import check_time
from pipeline.showing import only_showing
from pipeline.tiles.cleaning import clean_tiles, find_times
from pipeline.tiles.labelling import SCORES, gather_decision, seen_by_scans, tile_work
from pipeline.tiles.stages import do_stage, exhaust
from pipeline.tiles.writing import finish_parts, growing_outputs, kept_scores, plan_parts
from pipeline.work.files import open_rows
from pipeline.work.folder import WORK_FOLDER, remove_work
from pipeline.work.job import Job, unchanged
from pipeline.work.opening import open_job
from pipeline.workers.executors import Executor
from tiling.collection import MapCollection, content_hash, find_map_files
from tiling.formats.points import DEFAULT_BATCH


def run(
    maps: Sequence[str | Path],
    output: Path | None,
    configuration: Configuration,
    observer: StageObserver,
    *,
    fresh: bool = False,
) -> RunReport:
    """Clean one map; return what `run.json` holds.

    Parameters
    ----------
    maps : sequence of str or Path
        Files, folders or globs that together are one map.
    output : Path or None
        `<map>_dynahull` in the current folder by default.
    observer : StageObserver
        Told of stages, progress and warnings; its seconds go into the report.
    fresh : bool
        Start over, whatever an earlier run of this map left in the output folder.

    Raises
    ------
    TilingError, DynaHullError, PipelineError
        With no result written; what is done of several tiles is kept, and the same call goes on.
    """
    paths, cores = find_map_files(maps), available_cores(configuration.execution.workers)
    collection = open_collection(paths, configuration.input, cores)
    configuration = configuration.of_size(collection.point_count)
    folder = output or default_folder(paths)
    _check_what_is_asked(maps, folder, collection, configuration)
    work = folder / WORK_FOLDER
    one_tile = is_one_tile(collection, configuration, begun=work.exists() and not fresh)
    if one_tile:
        check_one_tile(collection, configuration)
    else:
        check_workers(configuration)
    warn_of_tiling(collection, configuration, one_tile, observer)
    _warn_of_what_is_lost(collection, observer)
    weighs = configuration.removal.weighs_evidence
    if configuration.input.poses and not (collection.is_moved or weighs):
        observer.warn("input.poses has no effect where removal.decision is paper: see -c auto")
    check_mode(collection.readers, configuration)
    names = OutputNames.of_run(collection.readers, configuration.output)
    results = names.all_files(configuration.output)
    with output_folder(folder, results, paths) as staging, unchanged(paths) as state:
        if one_tile:
            size = output_size(collection, configuration)
            check_space(folder, 0, size, configuration.output.keep_free)
        digest = _hashed(collection, observer)
        if one_tile:
            remove_work(work)
            cleaned = clean_in_memory(collection, configuration, names, staging, observer)
        else:
            whole = collection.with_poses(digest)
            job = open_job(work, paths, state, whole, configuration, fresh, observer)
            cleaned = _clean_in_tiles(job, collection, names, staging, observer)
        report = write_account(
            folder, collection, digest, configuration, cleaned, names, staging, observer
        )
    _give_up_work(work, configuration, observer)
    return report


def _check_what_is_asked(
    maps: Sequence[str | Path],
    folder: Path,
    collection: MapCollection,
    configuration: Configuration,
) -> None:
    """Refuse, before any work, what this map or this installation has not."""
    if any(Path(each).is_dir() and Path(each).resolve() == folder.resolve() for each in maps):
        raise OutputError(f"{folder}: this folder is the input; choose another -o")
    asked = {
        "ground.method las_class": configuration.ground.method == "las_class",
        "removal.protect_classes": bool(configuration.removal.protect_classes),
    }
    for what, is_asked in asked.items():
        if is_asked and not collection.has_classification:
            raise MissingClassificationError(
                f"{collection.paths[0]}: {what} expects a LAS map with classes, found none"
            )
    if configuration.ground.method == "csf":
        cloth_library()
    check_time(collection, configuration)


def _clean_in_tiles(
    job: Job, collection: MapCollection, names: OutputNames, staging: Path, observer: StageObserver
) -> CleanedMap:
    """Clean a map of several tiles, and write its results."""
    find_times(job, collection, observer)
    observer.finish()  # workers may be long in coming
    with workers_for(job) as executor:
        counts, clusters, sample = clean_tiles(
            job, executor, observer, lambda plan: check_plan(plan, job.configuration, job.root)
        )
        labels = open_rows(job.rows_path("label"), np.uint8)
        decision = gather_decision(job)
        views, tiles = None, None
        if job.configuration.output.report == "html":
            views = partial(_views, job, sample, clusters, decision)
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


def _views(
    job: Job, sample: MapSample, clusters: Sequence[ClusterSummary], decision: Decision
) -> Views:
    return Views.of(seen_by_scans(job, sample), clusters, job.configuration.removal, decision)


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


def write_account(
    folder: Path,
    collection: MapCollection,
    digest: str,
    configuration: Configuration,
    cleaned: CleanedMap,
    names: OutputNames,
    staging: Path,
    observer: StageObserver,
) -> RunReport:
    """Write what comes of a cleaned map beside it: thinned map, labels, page, figures."""
    if configuration.output.voxel is not None:
        places = [staging / name for name in names.thinned]
        write_thinned(
            collection, cleaned.rows["label"], configuration.output, places, staging, observer
        )
    if configuration.output.labels:
        write_labels(cleaned, staging / LABELS_FILE)
    observer.finish()
    report = RunReport.of(
        folder,
        collection,
        digest,
        configuration,
        cleaned.counts,
        cleaned.clusters,
        cleaned.decision,
        cleaned.time,
        names,
        observer,
    )
    (staging / CONFIGURATION_FILE).write_text(configuration.to_yaml(), encoding="utf-8")
    if cleaned.views is not None:
        report = _write_page(staging, report, cleaned.views, cleaned.tiles, observer)
    (staging / RUN_FILE).write_text(report.to_json(), encoding="utf-8")
    return report


def _give_up_work(work: Path, configuration: Configuration, observer: StageObserver) -> None:
    """Remove work of which the results are there: whatever happens, the run has succeeded."""
    try:
        if not configuration.output.keep_work:
            remove_work(work)
    except OSError as error:
        observer.warn(f"{work}: cannot be removed: {error.strerror or error}")


def _write_page(
    staging: Path,
    report: RunReport,
    views: Callable[[], Views],
    tiles: TileWork | None,
    observer: StageObserver,
) -> RunReport:
    """Write the report to look at; return that of `run.json`, which knows how long it took."""
    observer.stage("report", report.points)
    page, shown = staging / REPORT_FILE, report.without_page()
    with only_showing(REPORT_FILE, observer.warn):
        prepared = views()
        observer.advance(report.points)
        observer.finish()
        whole = report.with_seconds(observer)
        page.write_text(render_page(whole, prepared, tiles), encoding="utf-8")
        shown = whole
    observer.finish()
    if REPORT_FILE not in shown.outputs:
        page.unlink(missing_ok=True)
    return shown.with_seconds(observer)


def _warn_of_what_is_lost(collection: MapCollection, observer: StageObserver) -> None:
    """Say what the outputs cannot carry over, each sentence once."""
    notes = (note for reader in collection.readers for note in reader.description.notes)
    for note in dict.fromkeys(notes):
        observer.warn(note)


def _hashed(collection: MapCollection, observer: StageObserver) -> str:
    observer.stage("hashing", collection.point_count)
    digest = content_hash(collection.paths)
    observer.advance(collection.point_count)
    observer.finish()
    return digest
