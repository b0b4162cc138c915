"""The results of a run: the maps, and a table of what became of each point."""

from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.configuration.run import OutputParameters
from pipeline.errors import LostPointsError
from pipeline.outputs.folder import OutputNames
from pipeline.outputs.modes import PointScores, mode_of
from pipeline.progress import StageObserver
from pipeline.tiles.stages import do_stage, exhaust
from pipeline.tiles.writing import (
    BATCH,
    check_written,
    finish_parts,
    growing_outputs,
    plan_parts,
    write_stream,
)
from pipeline.work.job import Job
from pipeline.workers.executors import Executor
from tiling.collection import MapCollection
from tiling.formats import PointBatch


def write_maps(
    collection: MapCollection,
    output: OutputParameters,
    labels: NDArray[np.uint8],
    scores: PointScores | None,
    names: OutputNames,
    folder: Path,
    observer: StageObserver,
    job: Job | None = None,
    executor: Executor | None = None,
    read: Callable[[int], Iterable[PointBatch]] | None = None,
) -> None:
    """Stream the input once more into its outputs.

    Parameters
    ----------
    collection : MapCollection
    output : OutputParameters
    labels : (N,) uint8 array
    scores : PointScores or None
        There where the outputs are labelled.
    names : OutputNames
    folder : Path
    observer : StageObserver
    job, executor : Job and Executor, optional
        Files whose records are of one size are then written by several workers, and of others
        points are read and selected while those before are written.
    read : callable, optional
        Gives the points of a file of the map, `BATCH` at a time; otherwise it is read again.

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
        plan = plan_parts(job, in_parts)
        exhaust(do_stage(job, executor, observer, "write", [len(part.rows) for part in plan.parts]))
        finish_parts(job, plan)
        for index in in_parts:
            growing = growing_outputs(job, index, len(outputs[index]))
            for grown, place in zip(growing, outputs[index], strict=True):
                grown.replace(place)
    ahead = executor is not None and executor.workers > 1
    streams = sorted(set(range(len(outputs))) - set(in_parts))
    first_rows = [*collection.first_rows, collection.point_count]
    observer.stage("write", sum(first_rows[index + 1] - first_rows[index] for index in streams))
    for index in streams:
        rows = slice(first_rows[index], first_rows[index + 1])
        own = None if scores is None else scores.of(rows)
        mode = mode_of(collection.readers[index], output, labels[rows], own)
        batches = mode.reader.batches(BATCH) if read is None else read(index)
        write_stream(mode, batches, outputs[index], observer.advance, ahead)
    for reader, of_file in zip(collection.readers, outputs, strict=True):
        check_written(reader, of_file)
