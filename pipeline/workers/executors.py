"""Where tasks run: in this process, on workers of this machine, or on a cluster that is running.

One interface, `Executor.run`: a stream of task numbers goes in, reports come out as they are ready.
Few tasks are in flight at a time, and none is kept once it is finished, so that a run of a hundred
thousand tiles holds no graph of itself.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from time import monotonic
from typing import Any, Protocol

from pipeline.work.folder import TaskReport
from tiling.errors import ChunkError, MapFormatError

_COUNT_EVERY = 5.0
"""Seconds between two counts of the workers: asking the scheduler costs more than a task."""

RETRIES = 2
"""Times that a task is tried again after a fault of the file system."""


@dataclass(frozen=True, slots=True)
class TaskFailure:
    """Why a task did not come to its end."""

    reason: str
    """In one line."""
    short_of_memory: bool = False
    """Whether it would help to do less at a time."""
    refuses_map: bool = False
    """Whether the map is not what its format demands."""


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
        outcome: Outcome
        for _ in range(1 + RETRIES):
            try:
                return _guarded(task, folder, number)
            except OSError as error:
                outcome = _failure(error)
        return outcome


class OnDask:
    """Runs tasks on the workers of a Dask scheduler.

    Of the client only `submit` and the number of workers are used.
    """

    def __init__(self, client: Any) -> None:
        self._client = client

    @property
    def workers(self) -> int:
        """Workers that are there now: on a cluster they come and go."""
        return max(1, len(self._client.scheduler_info(n_workers=-1)["workers"]))

    def run(self, task: Task, folder: str, numbers: Iterable[int]) -> Iterator[tuple[int, Outcome]]:
        """Do the tasks, one at a time for each worker: none waits at one that is busy."""
        from distributed import as_completed  # noqa: PLC0415 (a second of import time)

        waiting = iter(numbers)
        flying: dict[Any, int] = {}
        completed = as_completed(loop=self._client.loop)
        workers, counted = 0, -_COUNT_EVERY
        ready: list[tuple[int, Outcome]] = []
        while True:
            if monotonic() - counted >= _COUNT_EVERY:
                workers, counted = self.workers, monotonic()
            while len(flying) < workers and (number := next(waiting, None)) is not None:
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
    refused = isinstance(error, MapFormatError) and not isinstance(error, ChunkError)
    return TaskFailure(_reason(error), starved, refused)


def _reason(error: BaseException | None) -> str:
    name = type(error).__name__
    if name == "KilledWorker":
        return "its workers died, probably for want of memory"
    if name == "FutureCancelledError":
        return "the connection to the scheduler was lost"
    return " ".join(str(error).split()) or name
