"""What a work folder tells: how far its run is, and whether it still goes on."""

import os
import shutil
import time
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import BaseModel

from pipeline.cluster.record import CLUSTER_FOLDER, state_lines, submitted_job
from pipeline.configuration.quantities import in_time
from pipeline.errors import WorkError
from pipeline.outputs.folder_lock import folder_is_locked
from pipeline.replacing import RUN_FILE, STAGING
from pipeline.showing import printable
from pipeline.work.files import read_if_whole
from pipeline.work.folder import REMOVED_FOLDER, WORK_FOLDER, remove_work, stages_begun


class StageStatus(BaseModel):
    """Tasks of a stage; what is None is known of the present stage only."""

    stage: str
    done: int
    failed: int
    waiting: int | None = None
    share_done: float | None = None
    points_per_second: float | None = None
    seconds_left: float | None = None
    heartbeat_seconds_ago: float | None = None
    failures: dict[str, str] = {}

    @classmethod
    def of(cls, state: dict[str, Any]) -> Self:
        """Take over what the run tells of the stage that it is in."""
        failed, rate = state["failed"], state["rate"]
        left = state["points"] - state["done_points"]
        waiting = state["tasks"] - state["done_tasks"] - len(failed)
        return cls(
            stage=state["stage"],
            done=state["done_tasks"],
            failed=len(failed),
            waiting=waiting,
            share_done=state["done_points"] / state["points"] if state["points"] else 1.0,
            points_per_second=rate,
            seconds_left=left / rate if rate > 0 and waiting else None,
            heartbeat_seconds_ago=time.time() - state["updated"],
            failures=failed,
        )

    def lines(self) -> list[str]:
        """Return what `status` prints of it."""
        if self.waiting is None or self.share_done is None:
            trouble = f", {self.failed} failed" if self.failed else ""
            return [f"{self.stage:<10} {self.done} tasks done{trouble}"]
        lines = [
            f"{self.stage:<10} {self.done} of {self.done + self.failed + self.waiting} tasks done, "
            f"{self.failed} failed, {self.waiting} waiting; {100 * self.share_done:.0f} % of the "
            "points"
        ]
        more = []
        if self.seconds_left is not None:
            left = in_time(self.seconds_left)
            more.append(f"{self.points_per_second:,.0f} points/s, {left} left in this stage")
        if self.heartbeat_seconds_ago is not None:
            more.append(f"last heartbeat {in_time(self.heartbeat_seconds_ago)} ago")
        more += [f"task {number} failed: {reason}" for number, reason in self.failures.items()]
        return lines + [f"{'':<10} {line}" for line in more]


class RunStatus(BaseModel):
    """How far a run is; `jobs` are those of a batch system, in words."""

    folder: str
    state: Literal["running", "not running", "finished", "waiting"]
    jobs: list[str] = []
    stages: list[StageStatus] = []
    is_alive: bool

    def to_json(self) -> str:
        """Return what `status --json` prints, in a line."""
        return self.model_dump_json(exclude_none=True)

    def to_text(self) -> str:
        """Return the lines that `status` prints."""
        untold = self.state == "running" and not self.stages
        more = {"running": "; a map of one tile shows no stages" if untold else ""}
        more["not running"] = "; the command that began it goes on"
        state = self.state + more.get(self.state, "")
        lines = [] if self.state == "waiting" else [f"{printable(self.folder)}: {state}"]
        return "\n".join(
            [*self.jobs, *lines, *(line for each in self.stages for line in each.lines())]
        )


def run_status(folder: Path) -> RunStatus:
    """Return how far a run is, by its output folder.

    Raises
    ------
    WorkError
        When no run is, or was, at work there.
    """
    work, jobs = folder / WORK_FOLDER, state_lines(folder)
    locked = folder.is_dir() and folder_is_locked(folder)
    stages = []
    if work.is_dir():
        state = read_if_whole(work / "state.json")
        present = None if state is None else StageStatus.of(state)
        stages = [
            present
            if present is not None and present.stage == stage
            else StageStatus(stage=stage, done=done, failed=failed)
            for stage, done, failed in stages_begun(work)
        ]
        if present is not None and present not in stages:
            stages.append(present)
        word = "running" if locked else "not running"
    elif locked:
        word = "running"
    elif (folder / RUN_FILE).is_file():
        word = "finished"
    elif jobs:  # a run that was submitted and has not begun leaves no work yet
        word = "waiting"
    else:
        raise WorkError(f"{folder}: expected the output folder of a run, found no work in it")
    alive = locked or (word != "finished" and _is_submitted(folder))
    return RunStatus(folder=str(folder), state=word, jobs=jobs, stages=stages, is_alive=alive)


def _is_submitted(folder: Path) -> bool:
    """Tell whether a job of a batch system is, or will be, at work in a folder."""
    submitted = submitted_job(folder)
    return submitted is not None and any(state.alive for state in submitted.states().values())


def discard_work(folder: Path) -> str:
    """Remove, and name, what a run that did not end left in an output folder; results stay.

    Raises
    ------
    WorkError
        When nothing is there to remove, or a run is at work.
    """
    if not folder.is_dir():
        raise WorkError(f"{folder}: expected the output folder of a run, found no such folder")
    if folder_is_locked(folder):
        raise WorkError(f"{folder}: a run is at work in this folder")
    if _is_submitted(folder):
        raise WorkError(f"{folder}: a job that was submitted is to work here")
    names = (WORK_FOLDER, REMOVED_FOLDER, STAGING, CLUSTER_FOLDER)
    left = [folder / name for name in names if (folder / name).is_dir()]
    if not left:
        raise WorkError(f"{folder}: no unfinished work of a run in this folder")
    remove_work(folder / WORK_FOLDER)
    for name in (STAGING, CLUSTER_FOLDER):
        shutil.rmtree(folder / name, ignore_errors=True)
    if not os.listdir(folder):  # noqa: PTH208 (whether there is any)
        folder.rmdir()
    return f"removed: {', '.join(str(path) for path in left)}"
