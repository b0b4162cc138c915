"""What does the tasks of a run: this process, workers of this machine, or a cluster."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from pipeline.configuration.run import is_elsewhere
from pipeline.plan.machine import available_cores
from pipeline.plan.resources import worker_memory_limit
from pipeline.work.job import Job
from pipeline.workers.executors import Executor, InProcess
from pipeline.workers.local_dask import can_start_workers, local_workers

logger = logging.getLogger("dynahull")


@contextmanager
def workers_for(job: Job) -> Iterator[Executor]:
    """Open what does the tasks of a run: this process, workers of this machine, or a cluster."""
    configuration = job.configuration
    workers = available_cores(configuration.execution.workers)
    if is_elsewhere(configuration):
        from pipeline.cluster import workers as elsewhere  # noqa: PLC0415 (an extra)

        running = configuration.execution.scheduler is not None
        opened = elsewhere.running_scheduler if running else elsewhere.cluster_workers
        with opened(configuration, job.root, job.paths) as executor:
            yield executor
    elif configuration.execution.cluster == "none" or workers == 1:
        yield InProcess()
    elif not can_start_workers():
        logger.warning(
            "/dev/shm: expected a folder that can be written into, as workers need for semaphores; "
            "the tiles are cleaned one after the other, by this process"
        )
        yield InProcess()
    else:
        with local_workers(workers, worker_memory_limit(configuration, workers)) as executor:
            yield executor
