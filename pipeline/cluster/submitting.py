"""A whole run as a job of a batch system: its script, its submission, and how it is cancelled."""

import sys
from collections.abc import Sequence
from pathlib import Path
from time import monotonic, sleep

from pipeline.cluster.batch_systems import BatchSystem, JobDescription, batch_system
from pipeline.cluster.record import (
    RecordedJobs,
    check_folder,
    cluster_folder,
    logs_folder,
    record_submitted,
    record_workers,
    submitted_job,
    worker_jobs,
)
from pipeline.configuration.cluster import BATCH_SYSTEMS
from pipeline.configuration.run import Configuration
from pipeline.errors import ConfigurationError, OutputError, WorkError
from pipeline.outputs.folder import default_folder
from pipeline.outputs.folder_lock import folder_is_locked
from pipeline.replacing import CONFIGURATION_FILE, refuse_own_folders
from tiling.collection import find_map_files
from tiling.output_file import atomic_file

_PATIENCE = 60.0
"""Seconds that a cancelled run is given to leave in order, its workers cancelled by itself."""


def run_script(
    maps: Sequence[str], output: Path | None, configuration: Configuration, *, fresh: bool = False
) -> str:
    """Return the script of the job, or raise what would refuse it, and leave nothing behind."""
    system = _system(configuration)
    folder = _output(maps, output)
    logs = logs_folder(folder).resolve()
    missing = [path for path in (logs, *logs.parents) if not path.exists()]
    try:
        return _script(system, maps, folder, configuration, fresh)
    finally:
        for path in missing:  # dask-jobqueue makes the folder of the logs
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def submit_run(
    maps: Sequence[str], output: Path | None, configuration: Configuration, *, fresh: bool = False
) -> tuple[str, Path]:
    """Hand a run over to a batch system.

    Parameters
    ----------
    maps : sequence of str
        Files, folders or globs that together are one map.
    output : Path or None
        Output folder; `<map>_dynahull` in the current folder by default.
    fresh : bool
        Start over, whatever an earlier run of this map left in the output folder.

    Returns
    -------
    job : str
        Its number.
    output : Path

    Raises
    ------
    TilingError, PipelineError
        With nothing submitted.
    """
    system = _system(configuration)
    folder = _output(maps, output)
    _refuse_another(folder)
    system.require()
    script = _script(system, maps, folder, configuration, fresh)
    refuse_own_folders(folder, find_map_files(maps))
    logs_folder(folder).mkdir(parents=True, exist_ok=True)
    path = cluster_folder(folder) / f"run{system.script_suffix}"
    settings = _of_the_run(configuration).to_yaml()
    for name, text in ((path.with_name(CONFIGURATION_FILE), settings), (path, script)):
        with atomic_file(name) as temporary:
            temporary.write_text(text, encoding="utf-8", errors="surrogateescape")
    job = system.submit_script(path.resolve())
    record_submitted(folder, system.name, job)
    return job, folder


def _system(configuration: Configuration) -> BatchSystem:
    name = configuration.execution.cluster
    if name not in BATCH_SYSTEMS or configuration.execution.scheduler is not None:
        raise ConfigurationError(
            f"submit: expected one of --cluster {', '.join(BATCH_SYSTEMS)}, found "
            f"{configuration.execution.scheduler or name}"
        )
    return batch_system(name)


def _output(maps: Sequence[str], output: Path | None) -> Path:
    folder = output or default_folder(find_map_files(maps))
    check_folder(folder)
    return folder


def _refuse_another(folder: Path) -> None:
    """Refuse a folder in which a run is at work, or is going to be."""
    for recorded in (submitted_job(folder), worker_jobs(folder)):
        if recorded is None:
            continue
        for job, state in recorded.states().items():
            if state.alive:
                raise OutputError(
                    f"{folder}: {recorded.system} job {job} is there for this folder "
                    f"({state.word}); cancel it first: dynahull-pipeline cancel {folder}"
                )
    if folder.is_dir() and folder_is_locked(folder):
        raise OutputError(f"{folder}: another run is writing into this folder")


def _script(
    system: BatchSystem,
    maps: Sequence[str],
    folder: Path,
    configuration: Configuration,
    fresh: bool,
) -> str:
    find_map_files(maps)  # complains where there are none
    parameters, run = configuration.cluster, configuration.cluster.run
    job = JobDescription(
        name=parameters.job_name,
        cores=run.cores,
        memory=run.memory,
        walltime=run.walltime,
        queue=run.queue or parameters.queue,
        resource_spec=run.resource_spec,
        logs=logs_folder(folder).resolve(),
        prologue=parameters.prologue,
    )
    command = [
        parameters.python or sys.executable,
        *("-P", "-m", "pipeline", "run"),
        *(str(Path(each).absolute()) for each in maps),
        *("-o", str(folder.resolve())),
        *("-c", str(cluster_folder(folder).resolve() / CONFIGURATION_FILE)),
        *(["--fresh"] if fresh else []),
    ]
    return system.script(parameters, job, command)


def _of_the_run(configuration: Configuration) -> Configuration:
    """Return the configuration of the run within its job: it has the cores that the job has."""
    execution, job = configuration.execution, configuration.cluster.run
    changes: dict[str, object] = {}
    if execution.workers == "auto":
        changes["workers"] = job.cores
    if configuration.cluster.workers == 0:
        changes["cluster"] = "local"
        if execution.memory == "auto":
            changes["memory"] = job.memory * 9 // 10 // job.cores  # a tenth is for the run itself
    return configuration.model_copy(update={"execution": execution.model_copy(update=changes)})


def cancel_run(folder: Path) -> str:
    """Cancel the job of a run and those of its workers, and say which; what is done is kept.

    Raises
    ------
    WorkError
        When there is nothing to cancel.
    ClusterError
        When the batch system does not answer.
    """
    submitted, workers = submitted_job(folder), worker_jobs(folder)
    if submitted is None and workers is None:
        raise WorkError(f"{folder}: nothing to cancel: no run was submitted for this folder")
    if submitted is None and folder_is_locked(folder):
        raise WorkError(
            f"{folder}: the run was not submitted; stop it where it was started, its workers follow"
        )
    cancelled = _cancel(submitted)
    if cancelled and submitted is not None:
        _wait_for(submitted)
    left = _cancel(worker_jobs(folder))
    record_workers(folder, "", [])
    if (recorded := submitted or workers) is not None and not (cancelled or left):
        jobs = f"{recorded.system} job {', '.join(recorded.jobs)}"
        raise WorkError(f"{folder}: nothing to cancel: {jobs} has ended")
    told = [f"job {job}" for job in cancelled]
    told += [f"{len(left)} jobs of workers"] if left else []
    return f"cancelled: {' and '.join(told)}; what is done is kept, and the same run goes on"


def _cancel(recorded: RecordedJobs | None) -> list[str]:
    """Cancel the jobs that wait or run, and return them."""
    if recorded is None:
        return []
    alive = [job for job, state in recorded.states().items() if state.alive]
    recorded.batch_system.cancel_jobs(alive)
    return alive


def _wait_for(recorded: RecordedJobs) -> None:
    deadline = monotonic() + _PATIENCE
    while monotonic() < deadline and any(state.alive for state in recorded.states().values()):
        sleep(1)
