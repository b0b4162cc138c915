"""One run: a map goes in, the cleaned map and the ghosts come out.

The map is streamed for its coordinates, and once more against one label a point, so that its
fields never pass through the method. A map of one tile is cleaned in memory; a larger one is cut
into tiles, whose work is shared out to workers and kept until all of it is done.
"""

import hashlib
import json
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from threading import Thread

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynahull import Label, clean
from dynahull.errors import MissingClassificationError
from dynahull.loading import load_libraries
from dynahull.result import ClusterSummary
from pipeline.configuration import Configuration, OutputParameters, is_elsewhere
from pipeline.errors import LostPointsError, OutputError
from pipeline.machine import available_cores
from pipeline.map_state import MapState, unchanged
from pipeline.output_modes import check_mode, mode_of
from pipeline.outputs import (
    CONFIGURATION_FILE,
    LABELS_FILE,
    REPORT_FILE,
    RUN_FILE,
    OutputNames,
    default_folder,
    output_folder,
)
from pipeline.plan import check_one_tile, check_plan, check_space, is_one_tile, worker_memory_limit
from pipeline.progress import StageObserver
from pipeline.report import RunReport
from pipeline.report_page.page import render_page
from pipeline.report_page.sample import MapSample
from pipeline.report_page.tile_chart import TileWork
from pipeline.tiles.cleaning import clean_tiles, exhaust
from pipeline.tiles.execution import Executor, InProcess, local_workers
from pipeline.tiles.fork_server import start_fork_server
from pipeline.tiles.job import JOB_FILE, Job
from pipeline.tiles.rows import open_rows
from pipeline.tiles.sampling import gather_sample, tile_work
from pipeline.tiles.stages import do_stage
from pipeline.tiles.work import WORK_FOLDER, remove_work
from pipeline.tiles.writing import (
    BATCH,
    GROWING,
    check_written,
    finish_parts,
    plan_parts,
    write_stream,
)
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
            size = sum(path.stat().st_size for path in paths)
            check_space(folder, 0, size, configuration.output.keep_free)
        else:
            prepare_workers(configuration)
        observer.stage("hashing", collection.point_count)
        digest = content_hash(paths)
        observer.advance(collection.point_count)
        work = folder / WORK_FOLDER
        if one_tile:
            remove_work(work)
            cleaned = clean_in_memory(collection, configuration, observer)
            write_maps(
                collection,
                configuration.output,
                cleaned.labels,
                cleaned.density,
                names,
                staging,
                observer,
            )
        else:
            job = open_job(work, paths, state, digest, configuration, fresh, observer)
            cleaned = clean_in_tiles(job, collection, names, staging, observer)
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
    collection: MapCollection, configuration: Configuration, observer: StageObserver
) -> CleanedMap:
    """Clean a map of one tile."""
    # Reading leaves this process time to load what the method needs.
    Thread(target=load_libraries, daemon=True).start()
    points, classification = read_points(collection, observer)
    result = clean(
        points,
        configuration.method(),
        classification=classification,
        threads=available_cores(configuration.execution.workers),
        observer=observer,
    )
    sample = None
    if configuration.output.report == "html":
        sample = MapSample.of_map(points, result.labels, result.cluster, result.density)
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


def prepare_workers(configuration: Configuration) -> None:
    """Let workers of this machine load what they need while something else is done."""
    if _are_local(configuration):
        start_fork_server()


def _are_local(configuration: Configuration) -> bool:
    execution = configuration.execution
    if is_elsewhere(configuration) or execution.cluster == "none":
        return False
    return available_cores(execution.workers) > 1


@contextmanager
def workers_for(job: Job) -> Iterator[Executor]:
    """Open what does the tasks of a run: this process, workers of this machine, or a cluster."""
    configuration = job.configuration
    workers = available_cores(configuration.execution.workers)
    if is_elsewhere(configuration):
        from pipeline.cluster.workers import workers_elsewhere  # noqa: PLC0415 (rarely used)

        with workers_elsewhere(configuration, job.root, job.paths) as executor:
            yield executor
    elif _are_local(configuration):
        with local_workers(workers, worker_memory_limit(configuration, workers)) as executor:
            yield executor
    else:
        yield InProcess()


def open_job(
    work: Path,
    paths: Sequence[Path],
    state: MapState,
    digest: str,
    configuration: Configuration,
    fresh: bool,
    observer: StageObserver,
) -> Job:
    """Go on with the work of an earlier run of the same map and configuration, or begin anew.

    Parameters
    ----------
    work : Path
        The work folder.
    paths : sequence of Path
        The map's files.
    state : MapState
        Theirs, from before the bytes were hashed.
    digest : str
        Of their bytes.
    configuration : Configuration
    fresh : bool
        Begin anew in any case.
    observer : StageObserver
        Told when work of another map or configuration is given up.
    """
    work = work.resolve()  # workers may have another current folder
    job = Job(work, job_key(digest, configuration), tuple(paths), state, configuration)
    if work.exists():
        try:
            stored = json.loads((work / JOB_FILE).read_text(encoding="utf-8"))["key"]
        except (OSError, ValueError, KeyError):
            stored = None
        if fresh or stored != job.key:
            if not fresh:
                observer.warn(
                    f"{work}: holds the work of another map or configuration; starting over"
                )
            remove_work(work)
    work.mkdir(exist_ok=True)
    job.save()
    return job


def job_key(digest: str, configuration: Configuration) -> str:
    """Return the hash of all that decides what tasks leave: map, configuration, version."""
    decisive = configuration.model_dump(mode="json", exclude={"execution", "cluster"})
    output = configuration.output
    decisive["output"] = {"labels": output.needs_scores, "report": output.report}
    text = json.dumps([version("dynahull-pipeline"), digest, decisive], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def read_points(
    collection: MapCollection, observer: StageObserver
) -> tuple[NDArray[np.float64], NDArray[np.uint8] | None]:
    """Read the coordinates of a map, and its classes where all its files have them.

    Returns
    -------
    points : (N, 3) float64 array
    classification : (N,) uint8 array or None
    """
    observer.stage("reading", collection.point_count)
    points = np.empty((collection.point_count, 3))
    classes = np.zeros(collection.point_count, np.uint8) if collection.has_classification else None
    for _, batch in collection.batches(BATCH):
        rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
        points[rows] = batch.xyz
        if classes is not None and batch.classification is not None:
            classes[rows] = batch.classification
        observer.advance(len(batch.xyz))
    return points, classes


def write_maps(
    collection: MapCollection,
    output: OutputParameters,
    labels: NDArray[np.uint8],
    density: NDArray[np.float64] | None,
    names: OutputNames,
    folder: Path,
    observer: StageObserver,
    job: Job | None = None,
    executor: Executor | None = None,
) -> None:
    """Stream the input once more into its outputs.

    Parameters
    ----------
    collection : MapCollection
    output : OutputParameters
    labels : (N,) uint8 array
    density : (N,) float64 array or None
        There where the outputs are labelled.
    names : OutputNames
    folder : Path
    observer : StageObserver
    job, executor : Job and Executor, optional
        Files whose records are of one size are then written by several workers.

    Raises
    ------
    LostPointsError
        When the files written do not add up to the input.
    """
    outputs = [tuple(folder / name for name in of_file) for of_file in names.by_file]
    places = [place for of_file in outputs for place in of_file]
    if len(set(places)) < len(places):
        twice = next(place for place in places if places.count(place) > 1)
        raise LostPointsError(f"{twice}: two files of the map would be written here")
    for place in places:
        place.parent.mkdir(parents=True, exist_ok=True)
    in_parts = []
    if job is not None and executor is not None:
        in_parts = [index for index, each in enumerate(collection.readers) if each.writes_parts]
        # They grow in the work folder, where a run that goes on finds what is done of them.
        growing = [tuple(job.root / GROWING / name for name in each) for each in names.by_file]
        plan = plan_parts(job, in_parts, growing)
        exhaust(do_stage(job, executor, observer, "write", [len(part.rows) for part in plan.parts]))
        finish_parts(job, plan)
        for index in in_parts:
            for grown, place in zip(growing[index], outputs[index], strict=True):
                grown.replace(place)
    streams = [index for index in range(len(outputs)) if index not in set(in_parts)]
    first_rows = [*collection.first_rows, collection.point_count]
    observer.stage("write", sum(first_rows[index + 1] - first_rows[index] for index in streams))
    for index in streams:
        rows = slice(first_rows[index], first_rows[index + 1])
        densities = None if density is None else density[rows]
        mode = mode_of(collection.readers[index], output, labels[rows], densities)
        write_stream(mode, outputs[index], observer.advance)
    for reader, of_file in zip(collection.readers, outputs, strict=True):
        check_written(reader, of_file)


def write_labels(cleaned: CleanedMap, path: Path) -> None:
    """Write label, cluster and density of every point, in input order, as Parquet."""
    titles = pa.array([label.title for label in Label])
    schema = pa.schema(
        {
            "label": pa.dictionary(pa.int8(), pa.string()),
            "cluster": pa.int32(),
            "density": pa.float64(),
        }
    )
    assert cleaned.cluster is not None and cleaned.density is not None  # asked for
    with ExitStack() as stack:
        writer = stack.enter_context(pq.ParquetWriter(path, schema, compression="zstd"))
        for start in range(0, len(cleaned.labels), BATCH):
            rows = slice(start, start + BATCH)
            codes = pa.array(np.asarray(cleaned.labels[rows]).astype(np.int8))
            columns = [
                pa.DictionaryArray.from_arrays(codes, titles),
                pa.array(np.asarray(cleaned.cluster[rows])),
                pa.array(np.asarray(cleaned.density[rows])),
            ]
            writer.write_table(pa.table(columns, schema=schema), row_group_size=BATCH)


def _notes(collection: MapCollection) -> list[str]:
    """Return what the outputs cannot carry over, each sentence once."""
    notes = dict.fromkeys(
        note for reader in collection.readers for note in reader.description.notes
    )
    return list(notes)
