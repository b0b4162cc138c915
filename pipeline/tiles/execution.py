"""Where tasks run: in this process, on workers of this machine, or on a cluster that is running.

One interface, `Executor.run`: a stream of task numbers goes in, reports come out as they are ready.
Few tasks are in flight at a time, and none is kept once it is finished, so that a run of a hundred
thousand tiles holds no graph of itself.
"""

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from importlib import import_module
from operator import length_hint
from time import monotonic
from typing import Any, Protocol

from pipeline.tiles.fork_server import ONE_THREAD, START_METHOD, start_fork_server, stop_fork_server
from pipeline.tiles.work import TaskReport

IN_FLIGHT_PER_WORKER = 2
"""Tasks handed to the scheduler for each worker: one that runs, and one that waits."""

_LONG = 1.0
"""Seconds from which on a task is handed out only when a worker is free, as the last ones always
are: one that waits at a worker is not done by another that has nothing left to do."""

_COUNT_EVERY = 5.0
"""Seconds between two counts of the workers: asking the scheduler costs more than a task."""

RETRIES = 2
"""Times that a task is tried again after a fault of the file system."""


@dataclass(frozen=True, slots=True)
class TaskFailure:
    """Why a task did not come to its end.

    Attributes
    ----------
    reason : str
        In one line.
    short_of_memory : bool
        Whether it would help to do less at a time.
    """

    reason: str
    short_of_memory: bool = False


Task = Callable[[str, int], TaskReport]
"""A pure function of a run's work folder and the number of a task."""

Outcome = TaskReport | TaskFailure


class Executor(Protocol):
    """Runs tasks."""

    @property
    def workers(self) -> int:
        """Tasks that run at a time."""

    def run(self, task: Task, folder: str, numbers: Iterable[int]) -> Iterator[tuple[int, Outcome]]:
        """Do the tasks of some numbers, and yield number and outcome of each as it is ready.

        A task that fails does not stop the others.
        """


class InProcess:
    """Runs one task after the other in this process."""

    workers = 1

    def run(self, task: Task, folder: str, numbers: Iterable[int]) -> Iterator[tuple[int, Outcome]]:
        """Do the tasks, here and now."""
        for number in numbers:
            try:
                outcome = _guarded(task, folder, number)
            except OSError as error:
                outcome = _failure(error)
            yield number, outcome


class Starting:
    """Runs tasks on workers that are being started, once they are there.

    Parameters
    ----------
    workers : int
    started : Future
        What runs tasks on them.
    """

    def __init__(self, workers: int, started: "Future[Executor]") -> None:
        self.workers = workers
        self._started = started

    def run(self, task: Task, folder: str, numbers: Iterable[int]) -> Iterator[tuple[int, Outcome]]:
        """Do the tasks on the workers."""
        yield from self._started.result().run(task, folder, numbers)


class OnDask:
    """Runs tasks on the workers of a Dask scheduler.

    Parameters
    ----------
    client : distributed.Client
        Of which only `submit` and the number of workers are used.
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    @property
    def workers(self) -> int:
        """Workers that are there now: on a cluster they come and go."""
        return max(1, len(self._client.scheduler_info(n_workers=-1)["workers"]))

    def run(self, task: Task, folder: str, numbers: Iterable[int]) -> Iterator[tuple[int, Outcome]]:
        """Do the tasks, a sliding window of them at a time."""
        from dask.utils import key_split  # noqa: PLC0415 (a second of import time)
        from distributed import as_completed  # noqa: PLC0415

        waiting = iter(numbers)
        flying: dict[Any, int] = {}
        completed = as_completed(loop=self._client.loop)
        workers, counted = 0, -_COUNT_EVERY
        seconds = _LONG  # of the latest task; what the first will take is not known
        ready: list[tuple[int, Outcome]] = []
        while True:
            if monotonic() - counted >= _COUNT_EVERY:
                workers, counted = self.workers, monotonic()
                key_split.cache_clear()  # it holds the names of the last 100,000 tasks
            last = length_hint(waiting, workers + 1) <= workers  # more, where it is not known
            window = workers if last or seconds >= _LONG else IN_FLIGHT_PER_WORKER * workers
            while len(flying) < window and (number := next(waiting, None)) is not None:
                future = self._client.submit(
                    _guarded, task, folder, number, pure=False, retries=RETRIES
                )
                flying[future] = number
                completed.add(future)
            yield from ready  # now that its worker has another
            if not flying:
                return
            future = next(completed)
            number = flying.pop(future)
            finished = future.status == "finished"
            outcome = future.result() if finished else _failure(future.exception())
            future.release()
            del future
            seconds = outcome.seconds if isinstance(outcome, TaskReport) else seconds
            ready = [(number, outcome)]


def _guarded(task: Task, folder: str, number: int) -> Outcome:
    """Do a task; let only faults of the file system through, which are worth another try.

    The text of an error is returned and not the error: not all of them survive being sent.
    """
    try:
        return task(folder, number)
    except OSError:
        raise
    except Exception as error:
        return _failure(error)


def _failure(error: BaseException | None) -> TaskFailure:
    # A worker that goes beyond its memory is killed, and its task with it.
    starved = isinstance(error, MemoryError) or type(error).__name__ == "KilledWorker"
    return TaskFailure(_reason(error), starved)


def _reason(error: BaseException | None) -> str:
    name = type(error).__name__
    if name == "KilledWorker":
        return "its workers died, probably for want of memory"
    if name == "FutureCancelledError":
        return "the connection to the scheduler was lost"
    return " ".join(str(error).split()) or name


@contextmanager
def local_workers(workers: int, memory: int) -> Iterator[Executor]:
    """Start workers on this machine, one process with one thread each, and do not wait for them.

    Parameters
    ----------
    workers : int
    memory : int
        Bytes that a worker may take; beyond them it is stopped and its task tried elsewhere.
    """
    start_fork_server()
    # Not in that thread: what this one imports meanwhile would hold it up.
    import_module("distributed")
    try:
        with ExitStack() as stack, ThreadPoolExecutor(1) as thread:
            yield Starting(workers, thread.submit(_start_workers, workers, memory, stack))
    finally:
        stop_fork_server()


def _start_workers(workers: int, memory: int, stack: ExitStack) -> Executor:
    """Start workers that last as long as the stack."""
    import dask  # noqa: PLC0415 (only where it is used)
    from distributed import Client, LocalCluster, scheduler, worker  # noqa: PLC0415

    # It tells how every process and connection comes and goes.
    logging.getLogger("distributed").setLevel(logging.ERROR)
    settings: dict[str, Any] = {
        # Dask sets them in this process too, and does not take them back; a worker that is forked
        # has those of the process that it is forked from.
        "distributed.nanny.pre-spawn-environ": {} if START_METHOD == "forkserver" else ONE_THREAD,
        "distributed.worker.multiprocessing-method": START_METHOD,
        "distributed.worker.memory.target": False,
        "distributed.worker.memory.spill": False,
        "distributed.worker.memory.pause": False,
        "distributed.admin.log-length": 1_000,
        # They look at what tasks do a hundred times a second, and tell a page that is not shown.
        "distributed.worker.profile.enabled": False,
        "distributed.admin.tick.interval": "1s",
        # By default they look twice a second at what that page would show, and ten times at memory.
        "distributed.admin.system-monitor.interval": "10s",
        "distributed.admin.system-monitor.disk": False,
        "distributed.worker.memory.monitor-interval": "250ms",
        # What the ports below would show: nothing.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
        "distributed.comm.timeouts.connect": "60s",
    }
    stack.enter_context(dask.config.set(settings))
    cluster = LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        memory_limit=memory,
        dashboard_address=None,
        # Even without a dashboard it opens a port: any that is free, for runs side by side.
        scheduler_kwargs={
            "dashboard_address": "127.0.0.1:0",
            "extensions": _without_spans(scheduler.DEFAULT_EXTENSIONS),
        },
        extensions=_without_spans(worker.DEFAULT_EXTENSIONS),
        silence_logs=50,
    )
    stack.enter_context(cluster)
    return OnDask(stack.enter_context(Client(cluster, set_as_default=False)))


def _without_spans(extensions: Mapping[str, type]) -> dict[str, type]:
    """Leave out what would keep a note of every task for pages that are not shown."""
    return {name: extension for name, extension in extensions.items() if name != "spans"}
