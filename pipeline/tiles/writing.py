"""The input streamed once more into the outputs, in order, with all fields.

Outputs whose records are of one size are written in parts by several workers, each its own range
of rows; the others by one process, as a stream.
"""

import pickle
import shutil
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pipeline.errors import LostPointsError
from pipeline.output_modes import OutputMode, mode_of
from pipeline.tiles.ahead import made_ahead
from pipeline.tiles.job import Job
from pipeline.tiles.rows import open_rows
from pipeline.tiles.work import TaskReport
from tiling.atomic import atomic_file
from tiling.formats import MapReader, PointBatch, open_map
from tiling.formats.parts import PartSummary, PartWriter

BATCH = 500_000
PARTS_FILE = "parts.pickle"
GROWING = "outputs"
"""Within the work folder: outputs that are being written in parts."""


@dataclass(frozen=True, slots=True)
class OutputPart:
    """A range of one input file's rows, and where its points go.

    Attributes
    ----------
    file : int
        The input file.
    rows : range
        Of that file.
    firsts : tuple of int
        Points of each output before those of this part.
    """

    file: int
    rows: range
    firsts: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class OutputPlan:
    """All outputs that are written in parts.

    Attributes
    ----------
    writers : dict of int to tuple of PartWriter
        Of each input file, for its outputs.
    parts : tuple of OutputPart
    mode : str
        The configuration that decides what goes where.
    """

    writers: dict[int, tuple[PartWriter, ...]]
    parts: tuple[OutputPart, ...]
    mode: str


def write_stream(
    mode: OutputMode,
    batches: Iterable[PointBatch],
    outputs: Sequence[Path],
    advance: Callable[[int], None],
    ahead: bool,
) -> None:
    """Write the outputs of one file of the map.

    Parameters
    ----------
    mode : OutputMode
        Of the file.
    batches : iterable of PointBatch
        The points of the file.
    outputs : sequence of Path
        To be written.
    advance : callable
        Told of points done.
    ahead : bool
        Whether there is a core to read and select points while those before are written.
    """
    counts = mode.counts(range(mode.reader.description.point_count))
    with ExitStack() as stack:
        writers = [
            stack.enter_context(each.writer(path, count))
            for each, path, count in zip(mode.formats, outputs, counts, strict=True)
        ]
        selected = ((len(batch.xyz), mode.records(batch)) for batch in batches)
        for points, records in made_ahead(selected) if ahead else selected:
            for writer, of_output in zip(writers, records, strict=True):
                writer.write(of_output)
            advance(points)


def check_written(reader: MapReader, outputs: Sequence[Path]) -> None:
    """Check that the outputs of a file together have its points.

    Raises
    ------
    LostPointsError
        When they do not.
    """
    description = reader.description
    written = sum(open_map(path).description.point_count for path in outputs)
    if written != description.point_count:
        raise LostPointsError(
            f"{description.path}: {description.point_count} points read, {written} written"
        )


def plan_parts(job: Job, files: Sequence[int], outputs: Sequence[Sequence[Path]]) -> OutputPlan:
    """Create the outputs of some files, to be written in parts, and keep the plan.

    Where an earlier run left them, and the same is wanted, its parts are gone on with.

    Parameters
    ----------
    job : Job
        Whose labels are known.
    files : sequence of int
        Files of the map whose format is written in parts.
    outputs : sequence of sequence of Path
        Of every file of the map.
    """
    mode_wanted = job.configuration.output.model_dump_json()
    earlier = _earlier_plan(job)
    if earlier is not None and earlier.mode == mode_wanted:
        return earlier
    _parts_path(job).unlink(missing_ok=True)
    for left in ("write", GROWING):
        shutil.rmtree(job.root / left, ignore_errors=True)
    writers: dict[int, tuple[PartWriter, ...]] = {}
    parts = []
    for file in files:
        mode = mode_of_file(job, file)
        firsts = (0,) * len(mode.formats)
        count = mode.reader.description.point_count
        for start in range(0, count, 2 * BATCH):
            rows = range(start, min(start + 2 * BATCH, count))
            parts.append(OutputPart(file, rows, firsts))
            firsts = tuple(map(sum, zip(firsts, mode.counts(rows), strict=True)))
        writers[file] = tuple(
            each.part_writer(path.resolve(), points)
            for each, path, points in zip(mode.formats, outputs[file], firsts, strict=True)
        )
        for writer in writers[file]:
            writer.path.parent.mkdir(parents=True, exist_ok=True)
            writer.create()
    plan = OutputPlan(writers, tuple(parts), mode_wanted)
    job.work.make("write")
    # Last, as a plan tells that its outputs were created.
    with atomic_file(_parts_path(job)) as temporary:
        temporary.write_bytes(pickle.dumps(plan))
    return plan


def _earlier_plan(job: Job) -> OutputPlan | None:
    """Return the plan of a run that did not come to its end, if all its outputs are still there."""
    try:
        plan: OutputPlan = pickle.loads(_parts_path(job).read_bytes())
    except FileNotFoundError:
        return None
    paths = [writer.path for writers in plan.writers.values() for writer in writers]
    return plan if all(path.is_file() for path in paths) else None


def write_part(job: Job, number: int) -> TaskReport:
    """Write one part of the outputs, and keep its summaries."""
    plan: OutputPlan = pickle.loads(_parts_path(job).read_bytes())
    part = plan.parts[number]
    mode = mode_of_file(job, part.file)
    with ExitStack() as stack:
        outputs = [
            stack.enter_context(writer.open_part(first))
            for writer, first in zip(plan.writers[part.file], part.firsts, strict=True)
        ]
        for batch in mode.reader.batches(BATCH, part.rows):
            for output, records in zip(outputs, mode.records(batch), strict=True):
                output.write(records)
        for output in outputs:
            output.flush()
    with atomic_file(job.work.path("write", number, ".pickle")) as temporary:
        temporary.write_bytes(pickle.dumps([output.summary for output in outputs]))
    return TaskReport(len(part.rows))


def mode_of_file(job: Job, file: int) -> OutputMode:
    """Return how the points of a file of the map go into its outputs, by the job's labels."""
    output, reader = job.configuration.output, job.collection.readers[file]
    first_row = job.collection.first_rows[file]
    rows = slice(first_row, first_row + reader.description.point_count)
    labels = open_rows(job.rows_path("label"), np.uint8)[rows]
    density = None
    if output.needs_scores:
        density = open_rows(job.rows_path("density"), np.float64)[rows]
    return mode_of(reader, output, labels, density)


def finish_parts(job: Job, plan: OutputPlan) -> None:
    """Write what only all parts of an output together tell."""
    summaries: dict[int, list[list[PartSummary]]] = {file: [] for file in plan.writers}
    for number, part in enumerate(plan.parts):
        kept = job.work.path("write", number, ".pickle").read_bytes()
        summaries[part.file].append(pickle.loads(kept))
    for file, writers in plan.writers.items():
        for output, writer in enumerate(writers):
            writer.finish([summary[output] for summary in summaries[file]])


def _parts_path(job: Job) -> Path:
    return job.root / PARTS_FILE
