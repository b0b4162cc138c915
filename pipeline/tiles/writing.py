"""The input streamed once more into the outputs, in order, with all fields.

Outputs whose records are of one size are written in parts by several workers, each its own range
of rows; the others by one process, as a stream.
"""

import pickle
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynahull.labels import Label
from pipeline.errors import LostPointsError
from pipeline.tiles.job import Job
from pipeline.tiles.rows import open_rows
from pipeline.tiles.work import TaskReport
from tiling.formats import MapReader, open_map
from tiling.formats.parts import PartSummary, PartWriter

BATCH = 500_000
PARTS_FILE = "parts.pickle"

Labels = NDArray[np.uint8]


@dataclass(frozen=True, slots=True)
class OutputPart:
    """A range of one input file's rows, and where its points go.

    Attributes
    ----------
    file : int
        The input file.
    rows : range
        Of that file.
    first_static, first_dynamic : int
        Points of each output before those of this part.
    """

    file: int
    rows: range
    first_static: int
    first_dynamic: int


@dataclass(frozen=True, slots=True)
class OutputPlan:
    """All outputs that are written in parts.

    Attributes
    ----------
    writers : dict of int to (PartWriter, PartWriter)
        Of each input file: what stays, what goes.
    parts : tuple of OutputPart
    """

    writers: dict[int, tuple[PartWriter, PartWriter]]
    parts: tuple[OutputPart, ...]


def write_stream(
    reader: MapReader,
    labels: Labels,
    static: Path,
    dynamic: Path,
    advance: Callable[[int], None],
) -> None:
    """Write what stays and what goes of one file of the map.

    Parameters
    ----------
    reader : MapReader
    labels : (n,) uint8 array
        Of the file's points.
    static, dynamic : Path
        To be written.
    advance : callable
        Told of points done.
    """
    staying = count_kept(labels)
    with ExitStack() as stack:
        cleaned = stack.enter_context(reader.writer(static, staying))
        ghosts = stack.enter_context(reader.writer(dynamic, len(labels) - staying))
        for batch in reader.batches(BATCH):
            chosen = labels[batch.first_row : batch.first_row + len(batch.xyz)] != Label.DYNAMIC
            cleaned.write(batch.select(chosen))
            ghosts.write(batch.select(~chosen))
            advance(len(batch.xyz))


def count_kept(labels: Labels) -> int:
    """Return how many points stay, a bounded part of the labels at a time."""
    starts = range(0, len(labels), 1 << 22)
    return sum(int(np.count_nonzero(labels[a : a + (1 << 22)] != Label.DYNAMIC)) for a in starts)


def check_written(reader: MapReader, static: Path, dynamic: Path) -> None:
    """Check that the outputs of a file together have its points.

    Raises
    ------
    LostPointsError
        When they do not.
    """
    description = reader.description
    written = sum(open_map(path).description.point_count for path in (static, dynamic))
    if written != description.point_count:
        raise LostPointsError(
            f"{description.path}: {description.point_count} points read, {written} written"
        )


def plan_parts(job: Job, files: Sequence[int], outputs: Sequence[tuple[Path, Path]]) -> OutputPlan:
    """Create the outputs of some files, to be written in parts, and keep the plan.

    Parameters
    ----------
    job : Job
        Whose labels are known.
    files : sequence of int
        Files of the map whose format is written in parts.
    outputs : sequence of (Path, Path)
        Static and dynamic output of every file of the map.
    """
    labels = open_rows(job.rows_path("label"), np.uint8)
    writers: dict[int, tuple[PartWriter, PartWriter]] = {}
    parts = []
    for file in files:
        reader, first_row = job.collection.readers[file], job.collection.first_rows[file]
        first_static = first_dynamic = 0
        count = reader.description.point_count
        for start in range(0, count, 2 * BATCH):
            rows = range(start, min(start + 2 * BATCH, count))
            parts.append(OutputPart(file, rows, first_static, first_dynamic))
            kept = count_kept(labels[first_row + rows.start : first_row + rows.stop])
            first_static += kept
            first_dynamic += len(rows) - kept
        static, dynamic = outputs[file]
        writers[file] = (
            reader.part_writer(static.resolve(), first_static),
            reader.part_writer(dynamic.resolve(), first_dynamic),
        )
        for writer in writers[file]:
            writer.create()
    plan = OutputPlan(writers, tuple(parts))
    job.work.make("write")
    _parts_path(job).write_bytes(pickle.dumps(plan))
    return plan


def write_part(job: Job, number: int) -> TaskReport:
    """Write one part of the outputs, and keep its summaries."""
    plan: OutputPlan = pickle.loads(_parts_path(job).read_bytes())
    part = plan.parts[number]
    first_row = job.collection.first_rows[part.file]
    labels = open_rows(job.rows_path("label"), np.uint8)
    firsts = (part.first_static, part.first_dynamic)
    with ExitStack() as stack:
        static, dynamic = (
            stack.enter_context(writer.open_part(first))
            for writer, first in zip(plan.writers[part.file], firsts, strict=True)
        )
        for batch in job.collection.readers[part.file].batches(BATCH, part.rows):
            row = first_row + batch.first_row
            kept = labels[row : row + len(batch.xyz)] != Label.DYNAMIC
            static.write(batch.select(kept))
            dynamic.write(batch.select(~kept))
    job.work.path("write", number, ".pickle").write_bytes(
        pickle.dumps((static.summary, dynamic.summary))
    )
    return TaskReport(len(part.rows))


def finish_parts(job: Job, plan: OutputPlan) -> None:
    """Write what only all parts of an output together tell."""
    summaries: dict[int, list[tuple[PartSummary, PartSummary]]] = {
        file: [] for file in plan.writers
    }
    for number, part in enumerate(plan.parts):
        kept = job.work.path("write", number, ".pickle").read_bytes()
        summaries[part.file].append(pickle.loads(kept))
    for file, writers in plan.writers.items():
        for output, writer in enumerate(writers):
            writer.finish([summary[output] for summary in summaries[file]])


def _parts_path(job: Job) -> Path:
    return job.root / PARTS_FILE
