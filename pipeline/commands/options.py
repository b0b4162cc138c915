"""Arguments and options that several commands share."""

from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from pipeline.configuration.run import Configuration

MAPS = typer.Argument(
    metavar="MAP...",
    help="One or more files, a folder, or a glob: together they are one map. "
    "PCD, LAS, LAZ, COPC, PLY, Parquet, npy, npz; a folder of scans with poses.",
    show_default=False,
)
Maps = Annotated[list[str], MAPS]
Output = Annotated[
    str | None,
    typer.Option("-o", "--output", metavar="DIR", help="Output folder. [default: <map>_dynahull]"),
]
ConfigurationSource = Annotated[
    str | None,
    typer.Option(
        "-c",
        "--config",
        metavar="CONFIG.yaml",
        help="Configuration file, or one of: paper, auto, indoor, outdoor.",
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="One setting, such as neighbours.k=50."),
]
Scheduler = Annotated[
    str | None,
    typer.Option(metavar="ADDRESS", help="Use the workers of a running Dask scheduler."),
]
ClusterName = Annotated[
    str | None,
    typer.Option(
        "--cluster",
        metavar="NAME",
        help="Workers are jobs of a batch system: slurm, pbs, lsf, sge or htcondor.",
    ),
]
TLS = Annotated[
    bool,
    typer.Option("--tls", help="Encrypt between scheduler, workers and run (cluster.tls)."),
]


def worker_settings(scheduler: str | None, cluster: str | None, tls: bool) -> list[str]:
    """Return the options about workers elsewhere as settings of the configuration."""
    settings = [f"execution.scheduler={scheduler}"] if scheduler else []
    settings += [f"execution.cluster={cluster}"] if cluster else []
    return settings + (["cluster.tls.enabled=true"] if tls else [])


def check_encryption(configuration: "Configuration", tls: bool) -> None:
    """Refuse `--tls` where there is nobody elsewhere to talk to."""
    from pipeline.configuration.run import is_elsewhere  # noqa: PLC0415 (slow to import)
    from pipeline.errors import ConfigurationError  # noqa: PLC0415

    if tls and not is_elsewhere(configuration):
        raise ConfigurationError("--tls: expected --cluster or --scheduler with it, found neither")
