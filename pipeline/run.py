"""One run: a map goes in, the cleaned map and the ghosts come out.

The map is streamed for its coordinates, and once more against one label a point, so that its
fields never pass through the method. A map of one tile is cleaned in memory; a larger one is cut
into tiles, whose work is shared out to workers and kept until all of it is done.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from dynahull import clean
from dynahull.errors import MissingClassificationError
from dynahull.loading import load_libraries
from dynahull.result import ClusterSummary
from pipeline.configuration import Configuration
from pipeline.decoded import MOST_KEPT, read_map
from pipeline.errors import OutputError
from pipeline.machine import available_cores
from pipeline.map_state import unchanged
from pipeline.output_modes import check_mode
from pipeline.outputs import (
    CONFIGURATION_FILE,
    LABELS_FILE,
    REPORT_FILE,
    RUN_FILE,
    OutputNames,
    default_folder,
    output_folder,
)
from pipeline.plan import (
    check_one_tile,
    check_plan,
    check_space,
    is_one_tile,
    memory_left,
    output_size,
)
from pipeline.progress import StageObserver
from pipeline.report import RunReport
from pipeline.report_page.page import render_page
from pipeline.report_page.sample import MapSample
from pipeline.report_page.tile_chart import TileWork
from pipeline.tiles.cleaning import clean_tiles
from pipeline.tiles.job import Job
from pipeline.tiles.opening import open_job
from pipeline.tiles.rows import open_rows
from pipeline.tiles.sampling import gather_sample, tile_work
from pipeline.tiles.stages import do_stage, exhaust
from pipeline.tiles.work import WORK_FOLDER, remove_work
from pipeline.workers import prepare_workers, workers_for
from pipeline.write_results import write_labels, write_maps
from tiling.formats.collection import MapCollection, content_hash, find_map_files


@dataclass(frozen=True, slots=True)
class CleanedMap:
    """What became of every point, in memory or in files that look like it.

    Attributes
    ----------
    labels : (N,) uint8 array
    cluster : (N,) int32 array or None
    density : (N,) float64 array or None
        None where nobody asked for them.
    counts : dict of str to int
        Points of each label.
    clusters : tuple of ClusterSummary
    sample : MapSample or None
        What the report shows; None where none is wanted.
    tiles : TileWork or None
        What they took; None where no report is wanted, or the map is one tile.
    """

    labels: NDArray[np.uint8]
    cluster: NDArray[np.int32] | None
    density: NDArray[np.float64] | None
    counts: dict[str, int]
    clusters: tuple[ClusterSummary, ...]
    sample: MapSample | None = None
    tiles: TileWork | None = None


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
    collection = MapCollection(paths, threads=cores)
    folder = output or default_folder(paths)
    if any(Path(each).is_dir() and Path(each).resolve() == folder.resolve() for each in maps):
        raise OutputError(f"{folder}: this folder is the input; choose another -o")
    if configuration.ground.method == "las_class" and not collection.has_classification:
        raise MissingClassificationError(
            f"{paths[0]}: ground.method las_class expects a LAS map with classes, found none"
        )
    if is_one_tile(collection, configuration):
        check_one_tile(collection, configuration)
    for note in _notes(collection):
        observer.warn(note)
    check_mode(collection.readers, configuration.output)
    names = OutputNames.of(collection.readers, configuration.output.mode)
    wants_page = configuration.output.report == "html"
    results = names.all_files(configuration.output.labels, wants_page)
    with output_folder(folder, results, paths) as staging, unchanged(paths) as state:
        one_tile = is_one_tile(collection, configuration)
        if one_tile:
            size = output_size(collection, configuration)
            check_space(folder, 0, size, configuration.output.keep_free)
        else:
            prepare_workers(configuration)
        observer.stage("hashing", collection.point_count)
        digest = content_hash(paths)
        observer.advance(collection.point_count)
        work = folder / WORK_FOLDER
        if one_tile:
            remove_work(work)
            cleaned = clean_in_memory(collection, configuration, names, staging, observer)
        else:
            job = open_job(work, paths, state, digest, configuration, fresh, observer)
            cleaned = clean_in_tiles(job, collection, names, staging, observer)
        if configuration.output.labels:
            assert cleaned.cluster is not None and cleaned.density is not None  # asked for
            write_labels(cleaned.labels, cleaned.cluster, cleaned.density, staging / LABELS_FILE)
        observer.finish()
        report = RunReport.of(
            folder,
            collection,
            digest,
            configuration,
            cleaned.counts,
            cleaned.clusters,
            names,
            observer,
        )
        (staging / CONFIGURATION_FILE).write_text(configuration.to_yaml(), encoding="utf-8")
        if cleaned.sample is not None:
            page = render_page(report, cleaned.sample, cleaned.tiles)
            (staging / REPORT_FILE).write_text(page, encoding="utf-8")
        (staging / RUN_FILE).write_text(report.to_json(), encoding="utf-8")
    if not configuration.output.keep_work:
        remove_work(work)
    return report


def clean_in_memory(
    collection: MapCollection,
    configuration: Configuration,
    names: OutputNames,
    staging: Path,
    observer: StageObserver,
) -> CleanedMap:
    """Clean a map of one tile, and write its results."""
    # Reading leaves this process time to load what the method needs.
    Thread(target=load_libraries, daemon=True).start()
    most_kept = min(MOST_KEPT, memory_left(collection, configuration) // 2)
    decoded = read_map(collection, most_kept, observer)
    result = clean(
        decoded.points,
        configuration.method(),
        classification=decoded.classification,
        threads=available_cores(configuration.execution.workers),
        observer=observer,
    )
    sample = None
    if configuration.output.report == "html":
        sample = MapSample.of_map(decoded.points, result.labels, result.cluster, result.density)
    output = configuration.output
    write_maps(
        collection,
        output,
        result.labels,
        result.density,
        names,
        staging,
        observer,
        read=decoded.batches,
    )
    return CleanedMap(
        result.labels, result.cluster, result.density, result.counts(), result.clusters, sample
    )


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
        sample, tiles = None, None
        if job.configuration.output.report == "html":
            exhaust(do_stage(job, executor, observer, "sample", job.store.layout.counts.tolist()))
            sample, tiles = gather_sample(job), tile_work(job)
        output = job.configuration.output
        cluster, density = None, None
        if output.needs_scores:
            cluster = open_rows(job.rows_path("cluster"), np.int32)
            density = open_rows(job.rows_path("density"), np.float64)
        write_maps(collection, output, labels, density, names, staging, observer, job, executor)
    return CleanedMap(labels, cluster, density, result.counts, result.clusters, sample, tiles)


def _notes(collection: MapCollection) -> list[str]:
    """Return what the outputs cannot carry over, each sentence once."""
    notes = dict.fromkeys(
        note for reader in collection.readers for note in reader.description.notes
    )
    return list(notes)
