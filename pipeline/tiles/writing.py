"""Outputs whose records are of one size: written by several workers, each its own range of rows."""

import shutil
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.errors import WorkError
from pipeline.outputs.modes import OutputMode, Scores, mode_of, scores_of
from pipeline.work.files import open_rows, read_if_whole, write_sealed
from pipeline.work.folder import TaskReport
from pipeline.work.job import CREATING, Job
from tiling.formats.parts import PartSummary, PartWriter
from tiling.formats.points import DEFAULT_BATCH
from tiling.ledger import note_end, noting

PARTS_FILE = "parts.json"
GROWING = "outputs"
"""Within the work folder: outputs that are being written in parts."""


@dataclass(frozen=True, slots=True)
class OutputPart:
    """A range of one input file's rows, and where its points go."""

    file: int
    """The input file."""
    rows: range
    """Of that file."""
    firsts: tuple[int, ...]
    """Points of each output before those of this part."""


@dataclass(frozen=True, slots=True)
class OutputPlan:
    """All outputs that are written in parts."""

    points: dict[int, tuple[int, ...]]
    """Of each input file, the points of its outputs."""
    parts: tuple[OutputPart, ...]

    def counts(self, number: int) -> tuple[int, ...]:
        """Return the points of each output in a part."""
        part, *following = self.parts[number : number + 2]
        same_file = bool(following) and following[0].file == part.file
        ends = following[0].firsts if same_file else self.points[part.file]
        return tuple(end - first for end, first in zip(ends, part.firsts, strict=True))


def growing_outputs(job: Job, file: int, outputs: int) -> tuple[Path, ...]:
    """Return where the outputs of a file of the map grow, by names that follow from no other."""
    return tuple(job.root / GROWING / f"{file:06d}-{output}" for output in range(outputs))


def plan_parts(job: Job) -> OutputPlan:
    """Create the outputs of the files whose format is written in parts, and keep the plan.

    Where an earlier run left them, and the same is wanted, its parts are gone on with.
    """
    plan = _plan_of(job)
    writers = [writer for file in plan.points for writer in _writers(job, plan, file)]
    earlier = read_if_whole(job.root / PARTS_FILE)
    if job.work.has_done(CREATING) and earlier == _kept(job, plan, writers):
        for number in range(len(plan.parts)):
            if _summaries(job, plan, number) is None:
                job.work.forget("write", number)
        return plan
    job.work.step_path(CREATING).unlink(missing_ok=True)
    for folder in ("write", GROWING):
        shutil.rmtree(job.root / folder, ignore_errors=True)
        job.work.make(folder)
    with noting() as written:
        for writer in writers:
            writer.create()
            note_end(writer.path)
        write_sealed(job.root / PARTS_FILE, _kept(job, plan, writers))
    job.work.finish_step(CREATING, written)
    return plan


def _plan_of(job: Job) -> OutputPlan:
    points, parts = {}, []
    for file, reader in enumerate(job.collection.readers):
        if not reader.writes_parts:
            continue
        mode = _mode_of_file(job, file)
        firsts = (0,) * len(mode.formats)
        count = mode.reader.description.point_count
        for start in range(0, count, 2 * DEFAULT_BATCH):
            rows = range(start, min(start + 2 * DEFAULT_BATCH, count))
            parts.append(OutputPart(file, rows, firsts))
            firsts = tuple(map(sum, zip(firsts, mode.counts(rows), strict=True)))
        points[file] = firsts
    return OutputPlan(points, tuple(parts))


def _kept(job: Job, plan: OutputPlan, writers: Sequence[PartWriter]) -> dict[str, Any]:
    """Return what is kept of a plan whose outputs were created.

    It is compared with what is wanted, and never believed.
    """
    paths = [writer.path for writer in writers]
    sizes = [path.stat().st_size if path.is_file() else None for path in paths]
    points = [[file, list(counts)] for file, counts in plan.points.items()]
    mode = job.configuration.output.model_dump_json()
    return {"points": points, "mode": mode, "sizes": sizes}


def _writers(job: Job, plan: OutputPlan, file: int) -> list[PartWriter]:
    counts = plan.points[file]
    paths = growing_outputs(job, file, len(counts))
    formats = _mode_of_file(job, file).formats
    return [
        each.part_writer(path, count)
        for each, path, count in zip(formats, paths, counts, strict=True)
    ]


def write_part(job: Job, number: int) -> TaskReport:
    """Write one part of the outputs, and keep its summaries."""
    plan = _plan(job)
    part = plan.parts[number]
    mode = _mode_of_file(job, part.file)
    with ExitStack() as stack:
        outputs = [
            stack.enter_context(writer.open_part(first))
            for writer, first in zip(_writers(job, plan, part.file), part.firsts, strict=True)
        ]
        for batch in mode.reader.batches(DEFAULT_BATCH, part.rows):
            for output, records in zip(outputs, mode.records(batch), strict=True):
                output.write(records)
        for output in outputs:
            output.flush()
    summaries = [output.summary.to_json() for output in outputs]
    write_sealed(job.work.path("write", number, ".json"), {"summaries": summaries})
    return TaskReport(len(part.rows))


def file_of_part(job: Job, number: int) -> int:
    """Return the file of the map that a part is read from."""
    return _plan(job).parts[number].file


def _plan(job: Job) -> OutputPlan:
    return _planned(str(job.root), (job.root / PARTS_FILE).stat().st_mtime_ns)


@lru_cache(maxsize=2)
def _planned(folder: str, _changed: int) -> OutputPlan:
    """Return the plan, made once for all parts that a process writes."""
    return _plan_of(Job.open(folder))


def _summaries(job: Job, plan: OutputPlan, number: int) -> list[PartSummary] | None:
    """Return the summaries of a part that was written; None where what was kept is no such."""
    part = plan.parts[number]
    stored = read_if_whole(job.work.path("write", number, ".json")) or {}
    kept = stored.get("summaries")
    if not isinstance(kept, list) or len(kept) != len(part.firsts):
        return None
    writers = _writers(job, plan, part.file)
    summaries = [
        writer.new_summary(first) for writer, first in zip(writers, part.firsts, strict=True)
    ]
    try:
        for summary, of_output in zip(summaries, kept, strict=True):
            summary.restore(of_output)
    except ValueError:
        return None
    counts = tuple(summary.count for summary in summaries)
    return summaries if counts == plan.counts(number) else None


def _mode_of_file(job: Job, file: int) -> OutputMode:
    """Return how the points of a file of the map go into its outputs, by the job's labels."""
    output, reader = job.configuration.output, job.collection.readers[file]
    first_row = job.collection.first_rows[file]
    rows = slice(first_row, first_row + reader.description.point_count)
    labels = open_rows(job.rows_path("label"), np.uint8)[rows]
    scores = {name: values[rows] for name, values in kept_scores(job).items()}
    return mode_of(reader, output, labels, scores)


def kept_scores(job: Job) -> Scores:
    """Return what was kept of the scores of all rows, in files; nothing where nobody asked."""
    if not job.configuration.output.needs_scores:
        return {}
    kinds = {"density": np.float64, "score": np.float32}
    kept = {name: open_rows(job.rows_path(name), kind) for name, kind in kinds.items()}
    return scores_of(kept, job.configuration)


def finish_parts(job: Job, plan: OutputPlan) -> None:
    """Write what only all parts of an output together tell; then they are not gone on with.

    Raises
    ------
    WorkError
        When what a part kept was changed meanwhile.
    """
    job.work.step_path(CREATING).unlink(missing_ok=True)
    of_files: dict[int, list[list[PartSummary]]] = {file: [] for file in plan.points}
    for number, part in enumerate(plan.parts):
        summaries = _summaries(job, plan, number)
        if summaries is None:
            path = job.work.path("write", number, ".json")
            raise WorkError(f"{path}: expected the summaries of a part, found others; run it again")
        of_files[part.file].append(summaries)
    for file, of_parts in of_files.items():
        for output, writer in enumerate(_writers(job, plan, file)):
            writer.finish([summaries[output] for summaries in of_parts])
