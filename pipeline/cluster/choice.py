"""What does the tasks of a run: this process, workers of this machine, or a cluster."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

from pipeline.configuration.run import Configuration, is_elsewhere
from pipeline.plan.machine import available_cores
from pipeline.plan.resources import worker_memory_limit
from pipeline.workers.executors import Executor, InProcess, local_workers
from pipeline.workers.fork_server import can_start_workers, start_fork_server

if TYPE_CHECKING:
    from pipeline.work.job import Job

logger = logging.getLogger("dynahull")


def prepare_workers(configuration: Configuration) -> None:
    """Start the process that workers of this machine are forked from, if there will be any."""
    if _are_local(configuration):
        start_fork_server()


def _are_local(configuration: Configuration) -> bool:
    execution = configuration.execution
    if is_elsewhere(configuration) or execution.cluster == "none":
        return False
    if available_cores(execution.workers) == 1:
        return False
    if not can_start_workers():
        _warn_of_one_process()
        return False
    return True


@cache
def _warn_of_one_process() -> None:
    logger.warning(
        "/dev/shm: expected a folder that can be written into, as workers need for semaphores; the "
        "tiles are cleaned one after the other, by this process"
    )


@contextmanager
def workers_for(job: "Job") -> Iterator[Executor]:
    """Open what does the tasks of a run: this process, workers of this machine, or a cluster."""
    configuration = job.configuration
    workers = available_cores(configuration.execution.workers)
    if is_elsewhere(configuration):
        from pipeline.cluster.workers import workers_elsewhere  # noqa: PLC0415 (rarely used)

        with workers_elsewhere(configuration, job.root, job.paths) as executor:
            yield executor
    elif _are_local(configuration):
        with local_workers(workers, worker_memory_limit(configuration, workers)) as executor:
            yield executor
    else:
        yield InProcess()
