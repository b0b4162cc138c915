"""One stage of a run: its tasks done in any order, each once, whatever happened before."""

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import partial
from itertools import pairwise
from typing import Any

from pipeline.errors import TasksFailedError
from pipeline.plan.machine import give_memory_back
from pipeline.progress import StageObserver
from pipeline.tiles.cutting import cut_rows, gather_tile, survey_rows
from pipeline.tiles.density import SIDES, score_tile
from pipeline.tiles.ground import find_ground, find_high, summarise_tile
from pipeline.tiles.labelling import label_tile
from pipeline.tiles.weighing import weigh_tile
from pipeline.tiles.writing import file_of_part, write_part
from pipeline.work.files import write_sealed
from pipeline.work.folder import TaskReport
from pipeline.work.job import Job, check_map
from pipeline.workers.executors import Executor, Outcome, TaskFailure
from tiling.errors import TilingError
from tiling.ledger import noting
from tiling.output_file import writing_only_into

TASKS: Mapping[str, Callable[..., TaskReport]] = {
    "survey": survey_rows,
    "cut": cut_rows,
    "chunk": gather_tile,
    "columns": summarise_tile,
    "ground": find_ground,
    "height": find_high,
    "density": score_tile,
    "evidence": weigh_tile,
    "label": label_tile,
    "write": write_part,
}
"""The stages whose work is shared out, in their order."""

READING = ("survey", "cut", "write")
"""Stages that read the map. What they read of one that was changed is not kept: it must not meet
what others read before, even if the map is put back before the run goes on."""

DIVISIBLE = ("ground", "density", "evidence")
"""Stages that take most memory. Their tasks can be done in parts where it does not suffice for a
whole tile, and give it back when they are done; those of others leave it for the next task, as the
system takes longer to find pages, and to wipe them, than to copy what is put there."""

_STATE_EVERY = 1.0
"""Seconds between two updates of what other terminals are told."""

_NAMED = 10
"""Failed tasks that an error names one by one."""


def do_task(stage: str, folder: str, number: int, sides: int = 1) -> TaskReport:
    """Do one task of a run, and mark it as done. This is what workers are given.

    With `sides` above one it is done in so many parts each way, see `pipeline.tiles.density`.
    """
    job = Job.open(folder)
    begun = time.perf_counter()
    files = _files_read(job, stage, number)
    _check_files(job, files)
    with writing_only_into(job.root):
        with noting() as written:
            report = TASKS[stage](job, number) if sides == 1 else TASKS[stage](job, number, sides)
        _check_files(job, files)
        report = TaskReport(report.points, report.counts, round(time.perf_counter() - begun, 3))
        job.work.finish(stage, number, report, written)
    if stage in DIVISIBLE:
        give_memory_back()
    return report


def _files_read(job: Job, stage: str, number: int) -> range:
    """Return the files of the map, by index, that a task reads: with many, few of them."""
    if stage == "write":
        file = file_of_part(job, number)
        return range(file, file + 1)
    if stage in READING:
        rows = job.row_ranges[number] if stage == "survey" else job.cut_ranges[number]
        return job.collection.files_of(rows)
    return range(0)


def _check_files(job: Job, files: range) -> None:
    check_map(job.paths[files.start : files.stop], job.state[files.start : files.stop])


def do_stage(
    job: Job, executor: Executor, observer: StageObserver, stage: str, points: Sequence[int]
) -> Iterator[tuple[int, TaskReport]]:
    """Do the tasks of a stage that are not done yet, the largest first.

    Tasks that the memory did not suffice for are done again in parts, when the others are done.

    Parameters
    ----------
    observer : StageObserver
        Told of points, not of tasks.
    stage : str
        A key of `TASKS`.
    points : sequence of int
        Points that each task is about.

    Yields
    ------
    number : int
        Of a task that is done, now or in an earlier run, in any order.
    report : TaskReport

    Raises
    ------
    TilingError
        When the survey, which is the first to read all of a map, finds that it is no map.
    TasksFailedError
        In the end, when tasks failed: which, and why.
    """
    observer.stage(stage, sum(points))
    job.work.make(stage)
    state = _State(job, stage, points)
    waiting = []
    for number in sorted(range(len(points)), key=lambda task: -points[task]):
        earlier = job.work.report(stage, number)
        if earlier is None:
            waiting.append(number)
            continue
        state.count(earlier)
        observer.advance(earlier.points)
        yield number, earlier
    state.begin()
    failures: dict[int, str] = {}
    refused = None
    for number, outcome in _outcomes(job, executor, observer, stage, waiting):
        if isinstance(outcome, TaskFailure):
            if stage == "survey" and outcome.refuses_map:
                refused = outcome.reason
                continue
            advice = "; try a smaller tiling.max_points" if outcome.short_of_memory else ""
            failures[number] = outcome.reason + advice
            state.fail(number, failures[number])
            observer.warn(f"{stage} task {number} failed: {failures[number]}")
            continue
        state.count(outcome)
        observer.advance(outcome.points)
        yield number, outcome
    state.write()
    if refused is not None:
        raise TilingError(refused)
    if failures:
        raise TasksFailedError(_failure_line(stage, failures))


def exhaust(stage: Iterator[object]) -> None:
    """Do a stage whose reports say nothing more."""
    for _ in stage:
        pass


def _outcomes(
    job: Job, executor: Executor, observer: StageObserver, stage: str, waiting: Sequence[int]
) -> Iterator[tuple[int, Outcome]]:
    """Do tasks; those that memory did not suffice for again, in parts, when the others are done."""
    divisions = SIDES if stage in DIVISIBLE else ()
    for sides, next_sides in pairwise((1, *divisions, None)):
        if not waiting:
            return
        task = partial(do_task, stage) if sides == 1 else partial(do_task, stage, sides=sides)
        starved = []
        for number, outcome in executor.run(task, str(job.root), waiting):
            if next_sides and isinstance(outcome, TaskFailure) and outcome.short_of_memory:
                starved.append(number)
                parts = f"it is done again in {next_sides**2} parts"
                observer.warn(f"{stage} task {number}: {outcome.reason}; {parts}")
            else:
                yield number, outcome
        waiting = starved


def _failure_line(stage: str, failures: Mapping[int, str]) -> str:
    named = [f"{number}: {failures[number]}" for number in sorted(failures)[:_NAMED]]
    more = f"; and {len(failures) - _NAMED} more" if len(failures) > _NAMED else ""
    return (
        f"{len(failures)} tasks of the stage {stage} failed ({'; '.join(named)}{more}); "
        "what is done is kept, and the same command goes on from there"
    )


class _State:
    """How far a stage is, for `status` to read from another terminal."""

    def __init__(self, job: Job, stage: str, points: Sequence[int]) -> None:
        self._job = job
        self._values: dict[str, Any] = {
            "stage": stage,
            "tasks": len(points),
            "points": sum(points),
            "done_tasks": 0,
            "done_points": 0,
            "failed": {},
        }
        self._earlier = 0
        self._begun = time.time()
        self._written = 0.0

    def begin(self) -> None:
        """Start the clock: what is done so far was done in an earlier run."""
        self._earlier = self._values["done_points"]
        self._begun = time.time()
        self.write()

    def count(self, report: TaskReport) -> None:
        self._values["done_tasks"] += 1
        self._values["done_points"] += report.points
        if time.time() - self._written >= _STATE_EVERY:
            self.write()

    def fail(self, number: int, reason: str) -> None:
        self._values["failed"][number] = reason
        self.write()

    def write(self) -> None:
        now = self._written = time.time()
        elapsed = max(now - self._begun, 1e-3)
        rate = (self._values["done_points"] - self._earlier) / elapsed
        values = {**self._values, "updated": now, "rate": rate}
        with suppress(OSError):  # the work itself does not depend on it
            write_sealed(self._job.work.state_path, values)
