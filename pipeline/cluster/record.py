"""What a run on a cluster leaves in its output folder: job scripts, logs, and numbers of jobs.

So that `status` and `cancel` find the jobs by the folder, from any machine that sees it.
"""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.cluster.batch_systems import BatchSystem, JobState, batch_system, count_words
from pipeline.errors import ClusterError
from tiling.output_file import atomic_file

CLUSTER_FOLDER = ".dynahull-cluster"
"""Within the output folder."""

_SUBMITTED = "submitted.json"
_WORKERS = "workers.json"


@dataclass(frozen=True, slots=True)
class RecordedJobs:
    """Jobs of a run: the one that `submit` handed over, or those of the workers it has now."""

    system: str
    """Name of the batch system."""
    jobs: tuple[str, ...]
    """Their numbers."""

    def states(self) -> dict[str, JobState]:
        """Ask the batch system for their states; no answer is a `ClusterError`."""
        return dict(self.batch_system.states(self.jobs)) if self.jobs else {}

    @property
    def batch_system(self) -> BatchSystem:
        """The batch system that has them."""
        return batch_system(self.system)


def check_folder(output: Path) -> None:
    """Raise where a job script could not name the folder."""
    if re.search(r"[\s'\"%\\]", str(output.resolve())):
        raise ClusterError(
            f"{output}: expected a path without blanks, quotes, % and \\, which job scripts cannot "
            "name; choose another -o"
        )


def cluster_folder(output: Path) -> Path:
    """Return where the run of an output folder keeps what is about its cluster."""
    return output / CLUSTER_FOLDER


def logs_folder(output: Path) -> Path:
    """Return where the jobs of a run write what they say."""
    return cluster_folder(output) / "logs"


def record_submitted(output: Path, system: str, job: str) -> None:
    """Keep the number of the job that holds the whole run."""
    _write(cluster_folder(output) / _SUBMITTED, system, [job])


def record_workers(output: Path, system: str, jobs: Sequence[str]) -> None:
    """Keep the numbers of the workers' jobs; none when all are over."""
    path = cluster_folder(output) / _WORKERS
    if jobs:
        _write(path, system, jobs)
    else:
        path.unlink(missing_ok=True)


def submitted_job(output: Path) -> RecordedJobs | None:
    """Return the job that holds the whole run, if one was submitted."""
    return _read(cluster_folder(output) / _SUBMITTED)


def worker_jobs(output: Path) -> RecordedJobs | None:
    """Return the jobs of the workers, where the run has, or left, some."""
    return _read(cluster_folder(output) / _WORKERS)


def state_lines(output: Path) -> list[str]:
    """Return what `status` says of the jobs of a run, nothing where it has none."""
    lines = []
    if (submitted := submitted_job(output)) is not None:
        lines.append(f"{output}: {submitted.system} job {submitted.jobs[0]}: {_words(submitted)}")
    if (workers := worker_jobs(output)) is not None:
        lines.append(f"{output}: {workers.system} jobs of workers: {_words(workers)}")
    return lines


def _words(recorded: RecordedJobs) -> str:
    try:
        states = list(recorded.states().values())
    except ClusterError as error:
        return f"unknown ({error})"
    return states[0].word if len(states) == 1 else count_words(states)


def _write(path: Path, system: str, jobs: Sequence[str]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_file(path) as temporary:
        temporary.write_text(json.dumps({"system": system, "jobs": list(jobs)}), encoding="utf-8")


def _read(path: Path) -> RecordedJobs | None:
    try:
        values: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return RecordedJobs(values["system"], tuple(values["jobs"]))
    except (OSError, ValueError, KeyError, TypeError):
        return None
