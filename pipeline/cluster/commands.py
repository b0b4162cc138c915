"""The commands about clusters: `submit` and `cancel`."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.options import ConfigurationSource, Maps, Output, Settings

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


def cluster_settings(cluster: str | None, tls: bool) -> list[str]:
    """Return the options about clusters as settings of the configuration."""
    settings = [f"execution.cluster={cluster}"] if cluster else []
    return settings + (["cluster.tls.enabled=true"] if tls else [])


def submit_command(
    maps: Maps,
    output: Output = None,
    config: ConfigurationSource = None,
    settings: Settings = None,
    cluster: ClusterName = None,
    tls: TLS = False,
    fresh: Annotated[
        bool,
        typer.Option("--fresh", help="Start over, whatever an earlier run left half done."),
    ] = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the script of the job, and submit nothing.")
    ] = False,
) -> None:
    """Hand a whole run over to a batch system; `status` and `cancel` follow it by its folder."""
    from pipeline.cluster.submitting import run_script, submit_run  # noqa: PLC0415
    from pipeline.configuration import load_configuration  # noqa: PLC0415
    from pipeline.errors import ConfigurationError  # noqa: PLC0415

    if output == "":
        raise ConfigurationError("-o: expected a folder, found nothing")
    wanted = [*(settings or []), *cluster_settings(cluster, tls)]
    configuration = load_configuration(config, wanted)
    place = Path(output) if output else None
    if dry_run:
        typer.echo(run_script(maps, place, configuration, fresh=fresh), nl=False)
        return
    job, folder = submit_run(maps, place, configuration, fresh=fresh)
    system = configuration.execution.cluster
    typer.echo(f"submitted: {system} job {job}; follow it with dynahull-pipeline status {folder}")


def cancel_command(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="Output folder of a run.")],
) -> None:
    """Cancel a run that was submitted, and the jobs of its workers; what is done is kept."""
    from pipeline.cluster.cancelling import cancel_run  # noqa: PLC0415

    typer.echo(cancel_run(folder))
