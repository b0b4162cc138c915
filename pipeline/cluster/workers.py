"""Executors on a cluster: workers that a batch system starts, or those of a running scheduler."""

import logging
import os
import shlex
import socket
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path
from typing import Any
from uuid import uuid4

import dask
from distributed import Client, Security, Worker
from distributed.diagnostics.plugin import WorkerPlugin

from pipeline.cluster.batch_systems import BatchSystem, JobDescription, batch_system, cluster_class
from pipeline.cluster.record import check_folder, cluster_folder, logs_folder, record_workers
from pipeline.cluster.supervisor import Supervisor
from pipeline.configuration.cluster import ClusterParameters, TLSParameters
from pipeline.configuration.quantities import in_home
from pipeline.configuration.run import Configuration
from pipeline.errors import ClusterError, ConfigurationError
from pipeline.workers.executors import Executor, OnDask, Outcome, Task
from pipeline.workers.local_dask import ONE_THREAD

TOPIC = "dynahull-refused"
"""Under which a worker that cannot take part says why."""


@dataclass(frozen=True, slots=True)
class SharedFiles:
    """What every worker must find where the run finds it: the work folder, to be written into."""

    folder: str
    token: str
    """Name of a file in it that the run made just now."""
    sizes: tuple[tuple[str, int], ...]
    """The map's files and their bytes."""
    version: str
    """Of this package: another one may give other results."""

    @classmethod
    def of(cls, folder: Path, maps: Sequence[Path]) -> "SharedFiles":
        """Look at them from here, and make the token; `remove` takes it away."""
        token = f".shared-{uuid4().hex}"
        (folder / token).touch()
        sizes = tuple((str(path.resolve()), path.stat().st_size) for path in maps)
        return cls(str(folder.resolve()), token, sizes, version("dynahull-pipeline"))

    def remove(self) -> None:
        """Remove the token."""
        (Path(self.folder) / self.token).unlink(missing_ok=True)

    def trouble(self) -> str | None:
        """Return, in one line, what this machine does not share; None if nothing is wrong."""
        here = socket.gethostname()
        folder = Path(self.folder)
        if not (folder / self.token).is_file():
            return (
                f"{here} does not see {folder}: map and output folder must lie on a file system "
                "that every node mounts at the same place"
            )
        if not os.access(folder, os.W_OK):
            return f"{here} may not write into {folder}"
        for path, size in self.sizes:
            try:
                found = Path(path).stat().st_size
            except OSError as error:
                return f"{here} cannot read {path}: {error.strerror}"
            if found != size:
                return f"{here} sees {found} bytes of {path}, which has {size}"
        found_version = version("dynahull-pipeline")
        if found_version != self.version:
            return f"{here} has dynahull-pipeline {found_version}, the run has {self.version}"
        return None


class SharingCheck(WorkerPlugin):  # type: ignore[misc]
    """Makes a worker leave that does not share what it must, and say why."""

    name = "dynahull-sharing"

    def __init__(self, files: SharedFiles) -> None:
        self._files = files

    async def setup(self, worker: Worker) -> None:
        """Check, before the worker takes tasks."""
        trouble = self._files.trouble()
        if trouble is not None:
            worker.log_event(TOPIC, trouble)
            await worker.close(reason="dynahull-not-shared")


def check_running_workers(client: Any, files: SharedFiles) -> str | None:
    """Return what a worker of a running cluster that is in trouble says, None if all is well."""
    return next(filter(None, client.run(files.trouble).values()), None)


logger = logging.getLogger("dynahull")

_ALLOWED_FAILURES = 10
"""Workers that may be lost with a task before it is given up; rarely is it the task's fault."""

_LOOPBACK = "127.0.0.1:0"

JOB_ENVIRONMENT = {
    **ONE_THREAD,
    "DASK_DISTRIBUTED__WORKER__MEMORY__TARGET": "False",
    "DASK_DISTRIBUTED__WORKER__MEMORY__SPILL": "False",
    "DASK_DISTRIBUTED__WORKER__MEMORY__PAUSE": "False",
    "DASK_DISTRIBUTED__WORKER__MEMORY__TERMINATE": "0.95",
    "DASK_DISTRIBUTED__COMM__TIMEOUTS__CONNECT": "60s",
}
"""Set in the job of a worker: what a run's own workers have set in their processes."""


class OnCluster(OnDask):
    """Runs tasks on workers that come and go, of which a fixed number is kept."""

    def __init__(self, client: Any, supervisor: Supervisor, workers: int) -> None:
        super().__init__(client)
        self._supervisor, self._kept = supervisor, workers

    @property
    def workers(self) -> int:
        """Workers that are there, or will be again."""
        return self._kept

    def run(self, task: Task, folder: str, numbers: Iterable[int]) -> Iterator[tuple[int, Outcome]]:
        """Do the tasks; raise a `ClusterError` where no workers come any more."""
        for number, outcome in super().run(task, folder, numbers):
            self._supervisor.check()
            yield number, outcome


@contextmanager
def cluster_workers(
    configuration: Configuration, work: Path, maps: Sequence[Path]
) -> Iterator[Executor]:
    """Start workers as jobs of a batch system, and keep their number until the end.

    They work in the run's work folder, and read the files of the map.

    Raises
    ------
    ClusterError
        When jobs cannot be submitted, or end before their workers are there.
    ConfigurationError, MissingPackageError
        Before any job.
    """
    parameters, output = configuration.cluster, work.parent
    system = batch_system(configuration.execution.cluster)
    check_ready(system, parameters, output)
    # Who comes and goes is said by Supervisor, and not by a scheduler in this process.
    logging.getLogger("distributed").setLevel(logging.CRITICAL)
    settings = {
        "distributed.scheduler.allowed-failures": _ALLOWED_FAILURES,
        "distributed.admin.log-length": 1_000,
        "distributed.comm.timeouts.connect": "60s",
        # Who is lost is decided by Supervisor.
        "distributed.deploy.lost-worker-timeout": "3650 days",
    }
    with (
        dask.config.set(settings),
        _cluster(system, parameters, output) as cluster,
        Client(cluster, set_as_default=False) as client,
    ):
        if parameters.dashboard is not None:
            logger.info("dashboard: %s", cluster.dashboard_link)
        supervisor = Supervisor(cluster, client, system, parameters, output)
        client.subscribe_topic(TOPIC, supervisor.refused)
        shared = SharedFiles.of(work, maps)
        try:
            client.register_plugin(SharingCheck(shared))
            supervisor.begin()
            yield OnCluster(client, supervisor, parameters.workers)
        finally:
            supervisor.end()
            shared.remove()
    record_workers(output, system.name, [])


@contextmanager
def running_scheduler(
    configuration: Configuration, work: Path, maps: Sequence[Path]
) -> Iterator[Executor]:
    """Use the workers of a scheduler that is running, such as `tcp://10.0.0.1:8786`.

    One of them that does not share what it must is a `ClusterError`.
    """
    address = str(configuration.execution.scheduler)
    security = scheduler_security(configuration.cluster.tls, address)
    with Client(address, security=security, set_as_default=False) as client:
        shared = SharedFiles.of(work, maps)
        try:
            trouble = check_running_workers(client, shared)
        finally:
            shared.remove()
        if trouble is not None:
            raise ClusterError(f"{address}: the worker on {trouble}")
        yield OnDask(client)


def check_ready(system: BatchSystem, parameters: ClusterParameters, output: Path) -> None:
    """Raise, before anything is started, where jobs cannot be started at all."""
    if parameters.workers == 0:
        raise ConfigurationError("cluster.workers: 0 is for `submit`; a run needs one at least")
    check_folder(output)
    if parameters.dashboard is not None and find_spec("bokeh") is None:
        raise ConfigurationError("cluster.dashboard: the dashboard needs the package bokeh")
    cluster_class(system)
    system.require()


@contextmanager
def _cluster(system: BatchSystem, parameters: ClusterParameters, output: Path) -> Iterator[Any]:
    """Open dask-jobqueue's cluster with a scheduler in this process and no workers yet."""
    job = worker_job(parameters, output)
    shared = cluster_folder(output)
    shared.mkdir(parents=True, exist_ok=True)
    keys = {name: shared / f"tls-{name}.pem" for name in ("ca_file", "certificate", "key")}
    options: dict[str, Any] = {"dashboard_address": parameters.dashboard or _LOOPBACK}
    if parameters.scheduler_interface is not None:
        options["interface"] = parameters.scheduler_interface
    try:
        with cluster_class(system)(
            n_workers=0,
            security=cluster_security(parameters.tls, keys),
            scheduler_options=options,
            silence_logs=50,
            **worker_keywords(system, parameters, job),
        ) as cluster:
            yield cluster
    finally:
        for path in keys.values():
            path.unlink(missing_ok=True)


def cluster_security(tls: TLSParameters, keys: Mapping[str, Path]) -> Security | None:
    """Return the keys of a cluster that this run starts, None without TLS.

    If none are given they are made, where `keys` says, for jobs to find them.
    """
    if tls.ca_file is not None:
        return _of_files(tls)
    if not tls.enabled:
        return None
    made = Security.temporary()
    texts = (made.tls_ca_file, made.tls_worker_cert, made.tls_worker_key)
    for path, text in zip(keys.values(), texts, strict=True):
        path.unlink(missing_ok=True)
        path.touch(0o600, exist_ok=False)  # never what somebody else put there
        path.write_text(text, encoding="ascii")
    return _of_files(TLSParameters(**{name: str(path) for name, path in keys.items()}))


def scheduler_security(tls: TLSParameters, address: str) -> Security | None:
    """Return the keys of a scheduler that is running, None without TLS."""
    if tls.ca_file is not None:
        return _of_files(tls)
    if tls.enabled or address.startswith("tls://"):
        raise ConfigurationError(
            f"{address}: expected cluster.tls.ca_file, cluster.tls.certificate and "
            "cluster.tls.key, as the scheduler was given them, found none"
        )
    return None


def _of_files(tls: TLSParameters) -> Security:
    """Return keys that are given, or raise a `ConfigurationError` if one is not there."""
    files = {}
    for name in ("ca_file", "certificate", "key"):
        path = in_home(getattr(tls, name)).resolve()
        if not path.is_file():
            raise ConfigurationError(f"cluster.tls.{name}: {path}: expected a file, found none")
        files[name] = str(path)
    roles = ("client", "scheduler", "worker")
    return Security(
        require_encryption=True,
        tls_ca_file=files["ca_file"],
        **{f"tls_{role}_cert": files["certificate"] for role in roles},
        **{f"tls_{role}_key": files["key"] for role in roles},
    )


def worker_job(parameters: ClusterParameters, output: Path) -> JobDescription:
    """Return what the job of a worker, or of several, asks for."""
    environment = [f"export {name}={value}" for name, value in JOB_ENVIRONMENT.items()]
    return JobDescription(
        name=f"{parameters.job_name}-worker",
        cores=parameters.workers_per_job,
        memory=parameters.memory * parameters.workers_per_job,
        walltime=parameters.walltime,
        queue=parameters.queue,
        resource_spec=parameters.resource_spec,
        logs=logs_folder(output).resolve(),
        prologue=[*parameters.prologue, *environment],
    )


def worker_keywords(
    system: BatchSystem, parameters: ClusterParameters, job: JobDescription
) -> dict[str, Any]:
    """Return how dask-jobqueue is told of the workers."""
    arguments = ["--dashboard-address", _LOOPBACK]
    if parameters.lifetime_seconds is not None:
        arguments += ["--lifetime", f"{parameters.lifetime_seconds}s"]
        arguments += ["--lifetime-stagger", f"{parameters.stagger_seconds}s"]
    # Without -P the folder that a job begins in would come before what is installed.
    keywords = {
        **system.keywords(parameters, job),
        "processes": parameters.workers_per_job,
        "worker_extra_args": arguments,
        "python": f"{shlex.quote(parameters.python or sys.executable)} -P",
    }
    if parameters.interface is not None:
        keywords["interface"] = parameters.interface
    if parameters.local_directory is not None:
        keywords["local_directory"] = shlex.quote(parameters.local_directory)
    return keywords
