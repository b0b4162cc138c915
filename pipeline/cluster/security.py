"""TLS between the scheduler, its workers and the run: with files given, or a key of this run's."""

from typing import Any

from pipeline.configuration.cluster import TLSParameters
from pipeline.errors import ConfigurationError
from pipeline.home import in_home


def cluster_security(tls: TLSParameters) -> Any:
    """Return distributed's `Security` for a cluster that this run starts, None without TLS.

    Raises
    ------
    ConfigurationError
        When a file is not there.
    """
    if tls.ca_file is not None:
        return _of_files(tls)
    if not tls.enabled:
        return None
    from pipeline.tiles.run_security import RunSecurity  # noqa: PLC0415 (a second of import time)

    return RunSecurity.temporary()


def scheduler_security(tls: TLSParameters, address: str) -> Any:
    """Return distributed's `Security` for a scheduler that is running, None without TLS.

    Raises
    ------
    ConfigurationError
        When files are wanted and not given, or not there.
    """
    if tls.ca_file is not None:
        return _of_files(tls)
    if tls.enabled or address.startswith("tls://"):
        raise ConfigurationError(
            f"{address}: expected cluster.tls.ca_file, cluster.tls.certificate and "
            "cluster.tls.key, as the scheduler was given them, found none"
        )
    return None


def _of_files(tls: TLSParameters) -> Any:
    from distributed import Security  # noqa: PLC0415 (a second of import time)

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
