"""Dask on this machine for one run: its scheduler and workers take orders from that run only.

A site's settings of Dask are for its own clusters: here they would encrypt by other keys, load
other programs, or end workers early. So they are set aside while a run's own Dask is at work.
"""

import logging
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from copy import deepcopy
from typing import Any

from pipeline.errors import ConfigurationError
from pipeline.temporary import temporary_folder
from pipeline.workers.fork_server import ONE_THREAD, START_METHOD

_LOOPBACK = "127.0.0.1"

_SETTINGS: Mapping[str, Any] = {
    # Dask sets them in this process too, and does not take them back; a worker that is forked
    # has those of the process that it is forked from.
    "distributed.nanny.pre-spawn-environ": {}
    if START_METHOD == "forkserver"
    else {**ONE_THREAD, "PYTHONSAFEPATH": "1"},
    "distributed.worker.multiprocessing-method": START_METHOD,
    "distributed.worker.memory.target": False,
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": 0.95,
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


@contextmanager
def site_settings_aside() -> Iterator[None]:
    """Let Dask have its own defaults in this block, whatever files and environment say.

    Raises
    ------
    ConfigurationError
        When Dask cannot read them: it reads them as it is imported.
    """
    try:
        import dask  # noqa: PLC0415 (only where it is used)
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


def start_local_cluster(workers: int, memory: int, stack: ExitStack) -> Any:
    """Start a scheduler and workers of this run, that last as long as the stack.

    Parameters
    ----------
    workers : int
    memory : int
        Bytes that a worker may take.
    stack : ExitStack

    Returns
    -------
    distributed.Client
    """
    import dask  # noqa: PLC0415 (only where it is used)
    from distributed import Client, LocalCluster, scheduler, worker  # noqa: PLC0415

    from pipeline.tiles.run_security import RunSecurity  # noqa: PLC0415

    # It tells how every process and connection comes and goes.
    logging.getLogger("distributed").setLevel(logging.ERROR)
    stack.enter_context(dask.config.set(_SETTINGS))
    security = RunSecurity.temporary()
    cluster = LocalCluster(
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
        scheduler_kwargs={
            "dashboard_address": f"{_LOOPBACK}:0",
            "extensions": _without_spans(scheduler.DEFAULT_EXTENSIONS),
        },
        extensions=_without_spans(worker.DEFAULT_EXTENSIONS),
        silence_logs=50,
    )
    stack.enter_context(cluster)
    return stack.enter_context(Client(cluster, security=security, set_as_default=False))


def _without_spans(extensions: Mapping[str, type]) -> dict[str, type]:
    """Leave out what would keep a note of every task for pages that are not shown."""
    return {name: extension for name, extension in extensions.items() if name != "spans"}
