"""What a work folder tells: how far its run is, and whether it still goes on."""

import os
import shutil
import time
from pathlib import Path
from typing import Any

from pipeline.cluster.record import CLUSTER_FOLDER, submitted_job
from pipeline.configuration.quantities import in_time
from pipeline.errors import WorkError
from pipeline.outputs.folder_lock import folder_is_locked
from pipeline.replacing import STAGING
from pipeline.work.files import read_if_whole
from pipeline.work.folder import REMOVED_FOLDER, WORK_FOLDER, remove_work, stages_begun


def status_text(folder: Path) -> str:
    """Return the lines that `status` prints of an output folder.

    Raises
    ------
    WorkError
        When no run is, or was, at work there.
    """
    work = folder / WORK_FOLDER
    if not work.is_dir():
        if folder.is_dir() and folder_is_locked(folder):
            return f"{folder}: running; the map is one tile, in memory"
        if (folder / "run.json").is_file():
            return f"{folder}: finished"
        raise WorkError(f"{folder}: expected the output folder of a run, found no work in it")
    lines = [f"{folder}: {'running' if folder_is_locked(folder) else 'not running'}"]
    state = read_if_whole(work / "state.json")
    for stage, done, failed in stages_begun(work):
        if state is None or stage != state["stage"]:
            trouble = f", {failed} failed" if failed else ""
            lines.append(f"{stage:<10} {done} tasks done{trouble}")
    if state is not None:
        lines += _present_stage(state)
    return "\n".join(lines)


def _present_stage(state: dict[str, Any]) -> list[str]:
    failed = len(state["failed"])
    waiting = state["tasks"] - state["done_tasks"] - failed
    share = 100 * state["done_points"] / state["points"] if state["points"] else 100.0
    lines = [
        f"{state['stage']:<10} {state['done_tasks']} of {state['tasks']} tasks done, {failed} "
        f"failed, {waiting} waiting; {share:.0f} % of the points"
    ]
    if state["rate"] > 0 and waiting:
        left = (state["points"] - state["done_points"]) / state["rate"]
        lines.append(f"{'':<10} {state['rate']:,.0f} points/s, {in_time(left)} left in this stage")
    lines.append(f"{'':<10} last heartbeat {in_time(time.time() - state['updated'])} ago")
    for number, reason in state["failed"].items():
        lines.append(f"{'':<10} task {number} failed: {reason}")
    return lines


def clean_folder(folder: Path) -> str:
    """Remove what a run that did not end left in an output folder; results stay.

    Returns
    -------
    str
        What was removed.

    Raises
    ------
    WorkError
        When nothing is there to remove, or a run is at work.
    """
    if not folder.is_dir():
        raise WorkError(f"{folder}: expected the output folder of a run, found no such folder")
    if folder_is_locked(folder):
        raise WorkError(f"{folder}: a run is at work in this folder")
    submitted = submitted_job(folder)
    if submitted is not None and any(state.alive for state in submitted.states().values()):
        raise WorkError(f"{folder}: {submitted.system} job {submitted.jobs[0]} is to work here")
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
