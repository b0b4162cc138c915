"""Cancelling a run that was submitted, and the jobs of its workers."""

from pathlib import Path
from time import monotonic, sleep

from pipeline.cluster.record import RecordedJobs, record_workers, submitted_job, worker_jobs
from pipeline.errors import WorkError
from pipeline.outputs.folder import folder_is_locked

_PATIENCE = 60.0
"""Seconds that the run is given to leave in order, its workers cancelled by itself."""


def cancel_run(folder: Path) -> str:
    """Cancel the job of a run and those of its workers; what is done is kept.

    Returns
    -------
    str
        What was cancelled.

    Raises
    ------
    WorkError
        When there is nothing to cancel.
    ClusterError
        When the batch system does not answer.
    """
    submitted = submitted_job(folder)
    if submitted is None and worker_jobs(folder) is None:
        raise WorkError(f"{folder}: nothing to cancel: no run was submitted for this folder")
    cancelled = [] if submitted is None else _cancel(submitted)
    if submitted is None and folder_is_locked(folder):
        raise WorkError(
            f"{folder}: the run was not submitted; stop it where it was started, its workers follow"
        )
    if cancelled and submitted is not None:
        _wait_for(submitted)
    workers = worker_jobs(folder)
    left = [] if workers is None else _cancel(workers)
    if workers is not None:
        record_workers(folder, workers.system, [])
    if not cancelled and not left:
        assert submitted is not None or workers is not None
        recorded = submitted or workers
        jobs = "" if recorded is None else f"{recorded.system} job {', '.join(recorded.jobs)}"
        raise WorkError(f"{folder}: nothing to cancel: {jobs} has ended")
    told = [f"job {job}" for job in cancelled]
    told += [f"{len(left)} jobs of workers"] if left else []
    return f"cancelled: {' and '.join(told)}; what is done is kept, and the same run goes on"


def _cancel(recorded: RecordedJobs) -> list[str]:
    """Cancel the jobs that wait or run, and return them."""
    alive = [job for job, state in recorded.states().items() if state.alive]
    recorded.batch_system.cancel_jobs(alive)
    return alive


def _wait_for(recorded: RecordedJobs) -> None:
    deadline = monotonic() + _PATIENCE
    while monotonic() < deadline and any(state.alive for state in recorded.states().values()):
        sleep(1)
