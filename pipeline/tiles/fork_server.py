"""Workers of this machine are forked from one process that has imported what they need.

A process that starts anew spends a second and a half on imports and on loading compiled code, as
often as there are workers. Where processes cannot be forked safely each worker starts anew.
"""

import multiprocessing
import os
import sys
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from multiprocessing import forkserver

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

START_METHOD = "forkserver" if sys.platform == "linux" else "spawn"
"""How worker processes start; forking after imports is sound on Linux only."""


def start_fork_server() -> None:
    """Start the process that workers are forked from, and do not wait for it.

    It imports `pipeline.tiles.preloaded` while the caller goes on. Does nothing where it runs.
    """
    if START_METHOD != "forkserver":
        return
    multiprocessing.get_context("forkserver").set_forkserver_preload(["pipeline.tiles.preloaded"])
    with _environment(ONE_THREAD):
        forkserver.ensure_running()


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
