"""Workers of this machine are forked from one process that has imported what they need.

A process that starts anew spends a second and a half on imports and on loading compiled code, as
often as there are workers. Where processes cannot be forked safely each worker starts anew.

That one process, multiprocessing's fork server, is itself forked from this one where this one has
a single thread: what both need is then imported once, and lies once in memory. Otherwise it starts
anew as well, and imports while this one goes on.
"""

import atexit
import ctypes
import multiprocessing
import os
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib import import_module
from itertools import pairwise
from multiprocessing import forkserver, resource_tracker, util
from pathlib import Path
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
    # The option of `mallopt`, in glibc's malloc.h, and its value: the largest that it takes, but
    # for all threads together. Only what they have in common is kept whatever its size.
    "MALLOC_ARENA_MAX": (-8, 1),
    "MALLOC_MMAP_THRESHOLD_": (-3, 1 << 25),
    "MALLOC_TRIM_THRESHOLD_": (-1, (1 << 31) - 1),
}
"""Settings of glibc in a worker, by their names in the environment.

It keeps what is freed for what comes next, in the same task and the one after it: to get memory
from the system and to wipe it takes longer than to read what is put there. Tasks that need most
give it back themselves.
"""

START_METHOD = "forkserver" if sys.platform == "linux" else "spawn"
"""How worker processes start; forking after imports is sound on Linux only."""

_PRELOADED = "pipeline.workers.preloaded"

_OF_ARROW = "jemalloc_bg_thd"
"""What the thread of Arrow's memory pool is called, which is there once Arrow is imported."""

_stopping: list[Thread] = []
"""Wait for the end of an earlier such process, which must not be taken for the next."""


def stay_forkable() -> None:
    """Keep NumPy from starting threads in this process; to be called before it is imported.

    Nothing here multiplies matrices large enough for them.
    """
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def start_fork_server() -> None:
    """Start the process that workers are forked from; does nothing where it runs.

    It has imported `pipeline.workers.preloaded`, or imports it while the caller goes on.
    """
    if START_METHOD != "forkserver":
        return
    while _stopping:
        _stopping.pop().join()
    multiprocessing.get_context("forkserver").set_forkserver_preload([_PRELOADED])
    variables = {name: str(value) for name, (_, value) in _MALLOC.items()}
    variables["PYTHONSAFEPATH"] = "1"  # what lies in the current folder is not for us to import
    with _own_temporary_files(), _environment(ONE_THREAD | variables):
        if has_one_thread():
            import_module(_PRELOADED)
            resource_tracker.ensure_running()  # which the server itself would start
            with _replaced(util, "spawnv_passfds", _fork_python):
                forkserver.ensure_running()
        else:
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


def has_one_thread() -> bool:
    """Tell whether a fork of this process would lose none of its threads, libraries' included.

    That of Arrow's memory pool does not count: it is made to be begun anew in a fork.
    """
    try:
        names = [(task / "comm").read_text().strip() for task in Path("/proc/self/task").iterdir()]
    except OSError:  # another system, or a thread that is just ending
        return False
    return len([name for name in names if name != _OF_ARROW]) == 1


def fork(work: Callable[[], None], descriptors: Sequence[int]) -> int:
    """Do some work in a fork of this process, which has one thread of its own.

    Parameters
    ----------
    work : callable
        Done there; then that process ends.
    descriptors : sequence of int
        Open files that it needs. All others are closed there: it would hold locks, for one.

    Returns
    -------
    int
        Number of the new process.
    """
    with warnings.catch_warnings():
        # Of the thread of Arrow's memory pool.
        warnings.simplefilter("ignore", DeprecationWarning)
        process = os.fork()
    if process:
        return process
    try:
        for number in (signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_DFL)
        kept = [*sorted({0, 1, 2, *descriptors}), os.sysconf("SC_OPEN_MAX")]
        for one, following in pairwise(kept):
            os.closerange(one + 1, following)
        work()
    except SystemExit:
        pass  # how a fork server ends
    except BaseException:
        traceback.print_exc()
    finally:
        os._exit(0)


def _fork_python(_program: str, arguments: Sequence[str], descriptors: Sequence[int]) -> int:
    """Fork this process where multiprocessing would start Python anew, with a text to run."""
    *_, text = arguments

    def serve() -> None:
        # What the environment says is read as a program starts.
        with suppress(OSError, AttributeError):
            for option, value in _MALLOC.values():
                ctypes.CDLL(None).mallopt(option, value)
        exec(text, {})

    return fork(serve, descriptors)


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
