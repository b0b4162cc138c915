"""`run`: clean a map."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import (
    TLS,
    ClusterName,
    ConfigurationSource,
    Maps,
    Output,
    Scheduler,
    Settings,
    check_encryption,
    worker_settings,
)


def run_command(
    maps: Maps,
    output: Output = None,
    config: ConfigurationSource = None,
    settings: Settings = None,
    labels: Annotated[
        bool,
        typer.Option("--labels", help="Write label, cluster and density of every point as well."),
    ] = False,
    fresh: Annotated[
        bool,
        typer.Option("--fresh", help="Start over, whatever an earlier run left half done."),
    ] = False,
    keep_work: Annotated[
        bool,
        typer.Option("--keep-work", help="Keep the work folder of a map of several tiles."),
    ] = False,
    scheduler: Scheduler = None,
    cluster: ClusterName = None,
    tls: TLS = False,
) -> None:
    """Clean a map: write it without its ghosts, and the ghosts beside it.

    A run that was interrupted goes on where it was when the same command is given again.
    """
    from pipeline.configuration.run import load_configuration  # noqa: PLC0415
    from pipeline.errors import ConfigurationError  # noqa: PLC0415
    from pipeline.progress import watching  # noqa: PLC0415
    from pipeline.run import run  # noqa: PLC0415

    wanted = [*(settings or []), *(["output.labels=true"] if labels else [])]
    wanted += ["output.keep_work=true"] if keep_work else []
    wanted += worker_settings(scheduler, cluster, tls)
    if output == "":
        raise ConfigurationError("-o: expected a folder, found nothing")
    configuration = load_configuration(config, wanted)
    check_encryption(configuration, tls)
    with watching() as observer:
        report = run(maps, Path(output) if output else None, configuration, observer, fresh=fresh)
    typer.echo(report.summary())
