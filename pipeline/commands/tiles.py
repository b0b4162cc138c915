"""The commands about tiles: `plan`, `tile`, `status`, `clean`."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import (
    TLS,
    ClusterName,
    ConfigurationSource,
    Maps,
    Scheduler,
    Settings,
    check_encryption,
    worker_settings,
)

Folder = Annotated[Path, typer.Argument(metavar="DIR", help="Output folder of a run.")]


def plan_command(
    maps: Maps,
    config: ConfigurationSource = None,
    settings: Settings = None,
    picture: Annotated[
        Path | None,
        typer.Option("-p", "--picture", metavar="PNG", help="Draw the tiles into this file."),
    ] = None,
) -> None:
    """Show how a map would be cut, and what that takes: tiles, memory, disk, time."""
    from pipeline.configuration.run import load_configuration  # noqa: PLC0415
    from pipeline.planning import plan_map  # noqa: PLC0415
    from pipeline.progress import watching  # noqa: PLC0415

    configuration = load_configuration(config, settings or [])
    with watching() as observer:
        text = plan_map(maps, configuration, observer, picture)
    typer.echo(text)


def tile_command(
    maps: Maps,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the chunks.")
    ],
    config: ConfigurationSource = None,
    settings: Settings = None,
    scheduler: Scheduler = None,
    cluster: ClusterName = None,
    tls: TLS = False,
) -> None:
    """Cut a map into tiles with halos: a file each, Parquet or LAS (--set tiling.format=las)."""
    from pipeline.configuration.run import load_configuration  # noqa: PLC0415
    from pipeline.planning import tile_map  # noqa: PLC0415
    from pipeline.progress import watching  # noqa: PLC0415

    wanted = [*(settings or []), *worker_settings(scheduler, cluster, tls)]
    configuration = load_configuration(config, wanted)
    check_encryption(configuration, tls)
    with watching() as observer:
        tiles = tile_map(maps, output, configuration, observer)
    typer.echo(f"written: {tiles} tiles in {output / 'chunks'}, described in store.json")


def status_command(folder: Folder) -> None:
    """Tell how far a run is: its stage, tasks done, failed and waiting, rate and time left."""
    from pipeline.cluster.record import state_lines  # noqa: PLC0415
    from pipeline.errors import WorkError  # noqa: PLC0415
    from pipeline.status import status_text  # noqa: PLC0415

    jobs = state_lines(folder)
    try:
        jobs.append(status_text(folder))
    except WorkError:
        if not jobs:  # a run that was submitted and has not begun leaves no work yet
            raise
    typer.echo("\n".join(jobs))


def clean_command(folder: Folder) -> None:
    """Remove what a run that failed left in its output folder; results stay."""
    from pipeline.status import clean_folder  # noqa: PLC0415

    typer.echo(clean_folder(folder))
