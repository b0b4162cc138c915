"""Workers of this machine are forked from one process that has imported what they need.

A process that starts anew spends a second and a half on imports and on loading compiled code, as
often as there are workers. Where processes cannot be forked safely each worker starts anew.

That one process, multiprocessing's fork server, imports while this one goes on.
"""

import atexit
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import forkserver
from threading import Thread
from typing import Any

from pipeline.temporary import socket_folder

ONE_THREAD = dict.fromkeys(
    (
        "OMP_NUM_THREADS",
        "OPENBLAS_NUM_THREADS",
        "MKL_NUM_THREADS",
        "NUMBA_NUM_THREADS",
        "RAYON_NUM_THREADS",
        "ARROW_NUM_THREADS",
    ),
    "1",
)
"""Environment of a worker: no library starts threads of its own."""

_MALLOC = {
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_THRESHOLD_": str(1 << 25),
    "MALLOC_TRIM_THRESHOLD_": str((1 << 31) - 1),
}
"""Settings of glibc in a worker, by their names in the environment.

It keeps what is freed for what comes next, in the same task and the one after it: to get memory
from the system and to wipe it takes longer than to read what is put there. Tasks that need most
give it back themselves.
"""

START_METHOD = "forkserver" if sys.platform == "linux" else "spawn"
"""How worker processes start; forking after imports is sound on Linux only."""

_PRELOADED = "pipeline.workers.preloaded"

FROM_HERE_ALONE = {"PYTHONSAFEPATH": "1"}
"""What lies in the current folder is not for us to import."""

_stopping: list[Thread] = []
"""Wait for the end of an earlier such process, which must not be taken for the next."""


def start_fork_server() -> None:
    """Start the process that workers are forked from; does nothing where it runs.

    It imports `pipeline.workers.preloaded` while the caller goes on.
    """
    if START_METHOD != "forkserver":
        return
    while _stopping:
        _stopping.pop().join()
    multiprocessing.get_context("forkserver").set_forkserver_preload([_PRELOADED])
    with _own_temporary_files(), _environment(ONE_THREAD | _MALLOC | FROM_HERE_ALONE):
        forkserver.ensure_running()


@contextmanager
def _own_temporary_files() -> Iterator[None]:
    """Let multiprocessing put what it makes in this block where the next run would find it.

    Its own folder is made once a process, when it is first needed. Semaphores, which are made later
    and lie elsewhere, are named after that of this process.
    """
    folder = socket_folder()
    multiprocessing.current_process()._config["semprefix"] = f"/{folder.name}"  # type: ignore[attr-defined]
    with _replaced(tempfile, "tempdir", str(folder)), _environment({"TMPDIR": str(folder)}):
        yield


def can_start_workers() -> bool:
    """Tell whether processes can wait for each other: semaphores lie in `/dev/shm` on Linux."""
    return sys.platform != "linux" or os.access("/dev/shm", os.W_OK | os.X_OK)


def stop_fork_server() -> None:
    """Let that process end, and do not wait for it: by itself it outlives this one.

    Its memory takes a tenth of a second to free, and who reads what the command says through a
    pipe would wait for it.
    """
    server: Any = forkserver._forkserver  # there is no public way
    _stopping.append(Thread(target=server._stop))
    _stopping[-1].start()
    atexit.register(_stopping[-1].join)  # it removes what multiprocessing removes the folder of


@contextmanager
def _replaced(module: Any, name: str, value: object) -> Iterator[None]:
    """Give a name of a module another value in this block."""
    before = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, before)


@contextmanager
def _environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set variables for processes started in this block."""
    before = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
