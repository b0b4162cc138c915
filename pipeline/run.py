"""One run: a map goes in, the cleaned map and the ghosts come out.

The map is streamed for its coordinates, and once more against one label a point, so that its
fields never pass through the method. A map of one tile is cleaned in memory; a larger one is cut
into tiles, whose work is shared out to workers and kept until all of it is done.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from dynahull.errors import MissingClassificationError
from dynahull.ground.cloth import cloth_library
from pipeline.configuration.run import Configuration
from pipeline.errors import OutputError
from pipeline.in_memory import clean_in_memory
from pipeline.in_tiles import clean_in_tiles
from pipeline.outputs.folder import OutputNames, default_folder, output_folder
from pipeline.outputs.modes import check_mode
from pipeline.outputs.run_report import RunReport
from pipeline.outputs.thinning import write_thinned
from pipeline.outputs.writing import CleanedMap, write_labels
from pipeline.plan.machine import available_cores
from pipeline.plan.resources import check_one_tile, check_space, is_one_tile, output_size
from pipeline.progress import StageObserver
from pipeline.replacing import CONFIGURATION_FILE, LABELS_FILE, REPORT_FILE, RUN_FILE
from pipeline.report_page.charts import TileWork
from pipeline.report_page.page import Views, render_page
from pipeline.scan_numbers import check_time
from pipeline.showing import only_showing
from pipeline.units import open_collection
from pipeline.work.folder import WORK_FOLDER, remove_work
from pipeline.work.map_state import unchanged
from pipeline.work.opening import open_job
from tiling.collection import MapCollection, content_hash, find_map_files


def run(
    maps: Sequence[str | Path],
    output: Path | None,
    configuration: Configuration,
    observer: StageObserver,
    *,
    fresh: bool = False,
) -> RunReport:
    """Clean one map.

    Parameters
    ----------
    maps : sequence of str or Path
        Files, folders or globs that together are one map.
    output : Path or None
        Output folder; `<map>_dynahull` in the current folder by default.
    configuration : Configuration
    observer : StageObserver
        Told of stages, progress and warnings; its seconds go into the report.
    fresh : bool
        Start over, whatever an earlier run of this map left in the output folder.

    Returns
    -------
    RunReport
        What `run.json` holds.

    Raises
    ------
    TilingError, DynaHullError, PipelineError
        With no result written. Of a map of several tiles, the work that is done is kept in the
        output folder, and the same call goes on from there.
    """
    paths = find_map_files(maps)
    cores = available_cores(configuration.execution.workers)
    collection = open_collection(paths, configuration.input, cores)
    configuration = configuration.of_size(collection.point_count)
    folder = output or default_folder(paths)
    if any(Path(each).is_dir() and Path(each).resolve() == folder.resolve() for each in maps):
        raise OutputError(f"{folder}: this folder is the input; choose another -o")
    if configuration.ground.method == "las_class" and not collection.has_classification:
        raise MissingClassificationError(
            f"{paths[0]}: ground.method las_class expects a LAS map with classes, found none"
        )
    if configuration.removal.protect_classes and not collection.has_classification:
        raise MissingClassificationError(
            f"{paths[0]}: removal.protect_classes expects a LAS map with classes, found none"
        )
    if configuration.ground.method == "csf":
        cloth_library()  # before the work, not after it
    check_time(collection, configuration)
    begun = (folder / WORK_FOLDER).exists() and not fresh
    one_tile = is_one_tile(collection, configuration, begun=begun)
    if one_tile:
        check_one_tile(collection, configuration)
    for note in _notes(collection):
        observer.warn(note)
    check_mode(collection.readers, configuration)
    names = OutputNames.of_run(collection.readers, configuration.output)
    wants_page = configuration.output.report == "html"
    results = names.all_files(bool(configuration.output.labels), wants_page)
    with (
        output_folder(folder, results, paths) as staging,
        unchanged(paths) as state,
    ):
        if one_tile:
            size = output_size(collection, configuration)
            check_space(folder, 0, size, configuration.output.keep_free)
        observer.stage("hashing", collection.point_count)
        digest = content_hash(paths)
        observer.advance(collection.point_count)
        observer.finish()
        work = folder / WORK_FOLDER
        if one_tile:
            remove_work(work)
            cleaned = clean_in_memory(collection, configuration, names, staging, observer)
        else:
            whole = collection.with_poses(digest)
            job = open_job(work, paths, state, whole, configuration, fresh, observer)
            cleaned = clean_in_tiles(job, collection, names, staging, observer)
        report = write_account(
            folder, collection, digest, configuration, cleaned, names, staging, observer
        )
    if not configuration.output.keep_work:
        _give_up_work(work, observer)
    return report


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
        write_thinned(collection, cleaned.labels, configuration.output, places, staging, observer)
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


def _give_up_work(work: Path, observer: StageObserver) -> None:
    """Remove work of which the results are there: whatever happens, the run has succeeded."""
    try:
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


def _notes(collection: MapCollection) -> list[str]:
    """Return what the outputs cannot carry over, each sentence once."""
    notes = dict.fromkeys(
        note for reader in collection.readers for note in reader.description.notes
    )
    return list(notes)
