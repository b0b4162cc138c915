"""One run: a map goes in, the cleaned map and the ghosts come out.

The map is streamed twice: once for its coordinates, and once more against one label a point, so
that its fields never pass through the method.
"""

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynahull import CleaningResult, Label, clean
from dynahull.errors import MissingClassificationError
from pipeline.configuration import Configuration
from pipeline.errors import InputChangedError, LostPointsError, OutputError
from pipeline.machine import available_cores
from pipeline.outputs import (
    CONFIGURATION_FILE,
    LABELS_FILE,
    RUN_FILE,
    OutputNames,
    default_folder,
    output_folder,
)
from pipeline.progress import StageObserver
from pipeline.report import RunReport
from tiling.formats import open_map
from tiling.formats.collection import MapCollection, content_hash, find_map_files

_BATCH = 500_000


def run(
    maps: Sequence[str | Path],
    output: Path | None,
    configuration: Configuration,
    observer: StageObserver,
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

    Returns
    -------
    RunReport
        What `run.json` holds.

    Raises
    ------
    TilingError, DynaHullError, PipelineError
        With nothing written.
    """
    paths = find_map_files(maps)
    collection = MapCollection(paths)
    folder = output or default_folder(paths)
    if any(Path(each).is_dir() and Path(each).resolve() == folder.resolve() for each in maps):
        raise OutputError(f"{folder}: this folder is the input; choose another -o")
    if configuration.ground.method == "las_class" and not collection.has_classification:
        raise MissingClassificationError(
            f"{paths[0]}: ground.method las_class expects a LAS map with classes, found none"
        )
    for note in _notes(collection):
        observer.warn(note)
    names = OutputNames.of(collection.readers)
    results = names.all_files(configuration.output.labels)
    with output_folder(folder, results, paths) as staging:
        before = _states(paths)
        points, classification = read_points(collection, observer)
        result = clean(
            points,
            configuration.method(),
            classification=classification,
            threads=available_cores(configuration.execution.workers),
            observer=observer,
        )
        del points
        write_maps(collection, result, names, staging, observer)
        if configuration.output.labels:
            write_labels(result, staging / LABELS_FILE)
        observer.stage("hashing", collection.point_count)
        digest = content_hash(paths)
        observer.advance(collection.point_count)
        observer.finish()
        if _states(paths) != before:
            raise InputChangedError(f"{paths[0]}: the map changed while it was being cleaned")
        report = RunReport.of(folder, collection, digest, configuration, result, names, observer)
        (staging / CONFIGURATION_FILE).write_text(configuration.to_yaml(), encoding="utf-8")
        (staging / RUN_FILE).write_text(report.to_json(), encoding="utf-8")
    return report


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
    for _, batch in collection.batches(_BATCH):
        rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
        points[rows] = batch.xyz
        if classes is not None and batch.classification is not None:
            classes[rows] = batch.classification
        observer.advance(len(batch.xyz))
    return points, classes


def write_maps(
    collection: MapCollection,
    result: CleaningResult,
    names: OutputNames,
    folder: Path,
    observer: StageObserver,
) -> None:
    """Stream the input once more into its static and its dynamic part.

    Raises
    ------
    LostPointsError
        When the files written do not add up to the input.
    """
    observer.stage("writing", collection.point_count)
    kept = result.kept
    first_rows = [*collection.first_rows, collection.point_count]
    for index, reader in enumerate(collection.readers):
        kept_here = kept[first_rows[index] : first_rows[index + 1]]
        static, dynamic = folder / names.static[index], folder / names.dynamic[index]
        if static.exists() or dynamic.exists():
            raise LostPointsError(f"{static.name}: two files of the map would be written here")
        static.parent.mkdir(parents=True, exist_ok=True)
        dynamic.parent.mkdir(parents=True, exist_ok=True)
        staying = int(np.count_nonzero(kept_here))
        with ExitStack() as stack:
            cleaned = stack.enter_context(reader.writer(static, staying))
            ghosts = stack.enter_context(reader.writer(dynamic, len(kept_here) - staying))
            for batch in reader.batches(_BATCH):
                chosen = kept_here[batch.first_row : batch.first_row + len(batch.xyz)]
                cleaned.write(batch.select(chosen))
                ghosts.write(batch.select(~chosen))
                observer.advance(len(batch.xyz))
        written = sum(open_map(path).description.point_count for path in (static, dynamic))
        if written != len(kept_here):
            raise LostPointsError(
                f"{reader.description.path}: {len(kept_here)} points read, {written} written"
            )


def write_labels(result: CleaningResult, path: Path) -> None:
    """Write label, cluster and density of every point, in input order, as Parquet."""
    titles = pa.array([label.title for label in Label])
    columns = {
        "label": pa.DictionaryArray.from_arrays(pa.array(result.labels.astype(np.int8)), titles),
        "cluster": pa.array(result.cluster),
        "density": pa.array(result.density),
    }
    pq.write_table(pa.table(columns), path, compression="zstd", row_group_size=_BATCH)


def _notes(collection: MapCollection) -> list[str]:
    """Return what the outputs cannot carry over, each sentence once."""
    notes = dict.fromkeys(
        note for reader in collection.readers for note in reader.description.notes
    )
    return list(notes)


def _states(paths: Sequence[Path]) -> list[tuple[int, int]]:
    return [(path.stat().st_size, path.stat().st_mtime_ns) for path in paths]
