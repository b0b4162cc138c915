"""Dask on this machine for one run: its scheduler and workers take orders from that run only.

A site's settings of Dask are for its own clusters: here they would encrypt by other keys, load
other programs, or end workers early. So they are set aside while a run's own Dask is at work.

Workers are forked from one process, multiprocessing's fork server, which has imported what they
need. It ends with this process.
"""

import logging
import multiprocessing
import os
import sys
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from copy import deepcopy
from multiprocessing import forkserver
from typing import Any

from pipeline.errors import ConfigurationError
from pipeline.temporary import socket_folder, temporary_folder
from pipeline.workers.executors import Executor, OnDask

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

_LOCAL = ONE_THREAD | {
    # What lies in the current folder is not for us to import.
    "PYTHONSAFEPATH": "1",
    # What is freed is kept for what comes next: to get memory from the system and to wipe it takes
    # longer than to read what is put there. Tasks that need most give it back themselves.
    "MALLOC_ARENA_MAX": "1",
    "MALLOC_MMAP_THRESHOLD_": str(1 << 25),
    "MALLOC_TRIM_THRESHOLD_": str((1 << 31) - 1),
    "ARROW_DEFAULT_MEMORY_POOL": "system",
}
"""Environment of a worker of this machine."""

_LOOPBACK = "127.0.0.1"

_SETTINGS: Mapping[str, Any] = {
    # Dask sets them in this process too, and does not take them back; a worker that is forked
    # has those of the process that it is forked from.
    "distributed.nanny.pre-spawn-environ": {},
    "distributed.worker.multiprocessing-method": "forkserver",
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
    "distributed.admin.log-length": 1_000,
    # It looks at what tasks do a hundred times a second, for a page that is not shown.
    "distributed.worker.profile.enabled": False,
    # What the ports below would show: nothing.
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
    "distributed.comm.timeouts.connect": "60s",
}


def can_start_workers() -> bool:
    """Tell whether processes can wait for each other: on Linux, semaphores lie in `/dev/shm`."""
    return not sys.platform.startswith("linux") or os.access("/dev/shm", os.W_OK | os.X_OK)


@contextmanager
def local_workers(workers: int, memory: int) -> Iterator[Executor]:
    """Start workers on this machine, one process with one thread each.

    A worker that takes more bytes of memory is stopped, and its task tried elsewhere.
    """
    with site_settings_aside(), local_client(workers, memory) as client:
        yield OnDask(client)


@contextmanager
def site_settings_aside() -> Iterator[None]:
    """Let Dask have its own defaults in this block, whatever files and environment say.

    Raises
    ------
    ConfigurationError
        When Dask cannot read them: it reads them as it is imported.
    """
    try:
        import dask  # noqa: PLC0415 (it may fail, and only tiles need it)
    except ValueError as error:
        raise ConfigurationError(f"Dask's own configuration: {error}") from error
    settings = dask.config.config
    before, defaults = deepcopy(settings), len(dask.config.defaults)
    dask.config.refresh(paths=[], env={})
    try:
        yield
    finally:
        settings.clear()
        if len(dask.config.defaults) > defaults:  # those of what was imported meanwhile
            dask.config.refresh(paths=[], env={})
        dask.config.update(settings, before)


@contextmanager
def local_client(workers: int, memory: int) -> Iterator[Any]:
    """Start a scheduler and workers of this run, and yield the `distributed.Client` of theirs.

    They speak TLS, by a key that is made here and goes from process to process.
    """
    start_fork_server()  # it imports what workers need while this process imports Dask
    import dask  # noqa: PLC0415 (its settings are to be set aside first)
    from distributed import Client, LocalCluster, Security  # noqa: PLC0415

    # It tells how every process and connection comes and goes.
    logging.getLogger("distributed").setLevel(logging.ERROR)
    security = Security.temporary()
    with (
        dask.config.set(_SETTINGS),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            memory_limit=memory,
            host=_LOOPBACK,
            protocol="tls://",
            security=security,
            local_directory=str(temporary_folder()),
            dashboard_address=None,
            # Even without a dashboard it opens a port: any that is free, for runs side by side.
            scheduler_kwargs={"dashboard_address": f"{_LOOPBACK}:0"},
            silence_logs=50,
        ) as cluster,
        Client(cluster, security=security, set_as_default=False) as client,
    ):
        yield client


def start_fork_server() -> None:
    """Start the process that workers are forked from; does nothing where it runs."""
    multiprocessing.set_forkserver_preload(["pipeline.workers.preloaded"])
    before, folder = dict(os.environ), tempfile.tempdir
    os.environ.update(_LOCAL)
    # Where its sockets lie: the next run finds there what a killed one left.
    tempfile.tempdir = str(socket_folder())
    try:
        forkserver.ensure_running()
    finally:
        tempfile.tempdir = folder
        for name in _LOCAL:
            os.environ.pop(name)
        os.environ.update(before)
