"""The commands about clusters: `submit` and `cancel`."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import (
    TLS,
    ClusterName,
    ConfigurationSource,
    Maps,
    Output,
    Settings,
    worker_settings,
)


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
    from pipeline.configuration.run import load_configuration  # noqa: PLC0415
    from pipeline.errors import ConfigurationError  # noqa: PLC0415

    if output == "":
        raise ConfigurationError("-o: expected a folder, found nothing")
    wanted = [*(settings or []), *worker_settings(None, cluster, tls)]
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
    from pipeline.cluster.submitting import cancel_run  # noqa: PLC0415

    typer.echo(cancel_run(folder))
