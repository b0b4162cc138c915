"""The commands about tiles: `plan`, `tile`, `status`, `discard`."""

import time
from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import (
    TLS,
    AsJson,
    ClusterName,
    ConfigurationSource,
    Folder,
    Maps,
    Scheduler,
    Settings,
    check_encryption,
    telling_how_to_go_on,
    worker_settings,
)


def plan_command(
    maps: Maps,
    config: ConfigurationSource = None,
    settings: Settings = None,
    picture: Annotated[
        Path | None,
        typer.Option("-p", "--picture", metavar="PNG", help="Draw the tiles into this file."),
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Show how a map would be cut, and what that takes: tiles, memory, disk, time."""
    from pipeline.configuration.run import load_configuration  # noqa: PLC0415
    from pipeline.planning import plan_map  # noqa: PLC0415
    from pipeline.progress import watching  # noqa: PLC0415

    configuration = load_configuration(config, settings or [])
    with watching() as observer:
        text, refused = plan_map(maps, configuration, observer, picture, as_json=as_json)
    typer.echo(text)
    if refused is not None:
        raise refused


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
    with telling_how_to_go_on(), watching() as observer:
        tiles = tile_map(maps, output, configuration, observer)
    told = "1 tile" if tiles == 1 else f"{tiles:,} tiles"
    typer.echo(f"written: {told} in {output / 'chunks'}, described in store.json")


def status_command(
    folder: Folder,
    as_json: AsJson = False,
    watch: Annotated[
        bool, typer.Option("--watch", help="Print again every two seconds, until the run ends.")
    ] = False,
) -> None:
    """Tell how far a run is: its stage, tasks done, failed and waiting, rate and time left."""
    from rich.console import Console  # noqa: PLC0415

    from pipeline.status import run_status  # noqa: PLC0415

    found = run_status(folder)
    while watch and found.is_alive:
        Console().clear()  # a terminal, that is
        typer.echo(found.to_json() if as_json else found.to_text())
        time.sleep(2)
        found = run_status(folder)
    typer.echo(found.to_json() if as_json else found.to_text())


def clean_command(folder: Folder) -> None:
    """Do what `discard` does, by its former name."""
    typer.echo("note: clean is called discard now, as it cleans no map", err=True)
    discard_command(folder)


def discard_command(folder: Folder) -> None:
    """Remove the unfinished work of a run from its output folder; results stay."""
    from pipeline.status import discard_work  # noqa: PLC0415

    typer.echo(discard_work(folder))
