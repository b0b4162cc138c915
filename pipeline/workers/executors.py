"""Where tasks run: in this process, on workers of this machine, or on a cluster that is running.

One interface, `Executor.run`: a stream of task numbers goes in, reports come out as they are ready.
Few tasks are in flight at a time, and none is kept once it is finished, so that a run of a hundred
thousand tiles holds no graph of itself.
"""

from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from importlib import import_module
from operator import length_hint
from time import monotonic
from typing import Any, Protocol

from pipeline.tiles.local_dask import site_settings_aside, start_local_cluster
from pipeline.work.folder import TaskReport
from pipeline.workers.fork_server import start_fork_server, stop_fork_server

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
            yield number, self._outcome(task, folder, number)

    def _outcome(self, task: Task, folder: str, number: int) -> Outcome:
        for _ in range(RETRIES):
            with suppress(OSError):
                return _guarded(task, folder, number)
        try:
            return _guarded(task, folder, number)
        except OSError as error:
            return _failure(error)


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
    with site_settings_aside(), _fork_server():
        # Not in that thread: what this one imports meanwhile would hold it up.
        import_module("distributed")
        with ExitStack() as cluster, ThreadPoolExecutor(1) as thread:

            def start() -> Executor:
                return OnDask(start_local_cluster(workers, memory, cluster))

            yield Starting(workers, thread.submit(start))


@contextmanager
def _fork_server() -> Iterator[None]:
    start_fork_server()
    try:
        yield
    finally:
        stop_fork_server()
