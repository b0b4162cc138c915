"""Looking at maps and results, making maps, and the keys of the configuration."""

import json
import re
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.commands.options import MAPS, AsJson, Folder, Poses, Scans, named_maps
from tiling.foreign_text import printable_path


def manual_page(context: Any) -> str:
    """Return the page of all commands, as roff for `man`, by the context of their group."""
    group, name = context.command, "dynahull-pipeline"
    lines = [
        f'.TH {name.upper()} 1 "" "{name} {version(name)}" "User commands"',
        ".SH NAME",
        _text(f"{name} - {group.help}"),
        ".SH SYNOPSIS",
        _text(f"{name} COMMAND [OPTIONS] ..."),
        ".SH COMMANDS",
    ]
    for title in group.list_commands(context):
        command = group.get_command(context, title)
        if command.hidden:
            continue
        own = type(context)(command, info_name=title, parent=context)
        lines += [f'.SS "{_text(" ".join([title, *command.collect_usage_pieces(own)]))}"']
        lines += [_text(command.help or "")]
        for parameter in command.params:
            record = parameter.get_help_record(own)
            if record is not None:
                lines += [".TP", f".B {_text(record[0])}", _text(record[1])]
    return "\n".join([*lines, ".SH EXIT STATUS", _text(group.epilog or "")])


def _text(text: str) -> str:
    """Return text for roff: one line, without what roff takes for its own."""
    text = re.sub(r"\[/?\w*\]", "", " ".join(text.split()))  # rich's marks
    return text.replace("\\", "\\e").replace("-", "\\-")


def info_command(
    maps: Annotated[list[str] | None, MAPS] = None,
    scans: Scans = None,
    poses: Poses = None,
    as_json: AsJson = False,
) -> None:
    """Show what a map holds: format, points, fields, bounds, CRS, non-finite points, duplicates."""
    from pipeline.info import inspect_map  # noqa: PLC0415

    info = inspect_map(named_maps(maps, scans), poses)
    typer.echo(json.dumps(info.model_dump(mode="json"), indent=2) if as_json else info.to_text())


def verify_command(
    folders: Annotated[
        list[Path],
        typer.Argument(metavar="DIR...", help="Output folders of runs, or folders of such."),
    ],
) -> None:
    """Prove from the files that outputs make up the input, and that labels follow; a line a map."""
    from pipeline.errors import PipelineError  # noqa: PLC0415
    from pipeline.verifying import find_results, verify  # noqa: PLC0415
    from tiling.errors import TilingError  # noqa: PLC0415

    failed = False
    found: list[Path] = []
    for given in folders:
        try:
            found += find_results(given)
        except PipelineError:
            if len(folders) == 1:
                raise
            found.append(given)  # the others are verified all the same
    for folder in found:
        try:
            typer.echo(f"verified: {printable_path(folder)}: {verify(folder)}")
        except (PipelineError, TilingError, OSError) as error:
            failed = True
            typer.echo(f"NOT VERIFIED: {printable_path(folder)}: {error}")
    if failed:
        raise typer.Exit(1)


def view_command(
    folder: Folder,
    save: Annotated[
        Path | None,
        typer.Option(metavar="FILE.rrd", help="Write a recording to open elsewhere instead."),
    ] = None,
    viewer: Annotated[
        str, typer.Option("--with", metavar="VIEWER", help="rerun or open3d: an extra each.")
    ] = "rerun",
) -> None:
    """Open a result in a window, coloured by label, and by density (rerun)."""
    from pipeline.errors import ConfigurationError  # noqa: PLC0415
    from pipeline.view import view_result, view_with_open3d  # noqa: PLC0415

    if viewer not in ("rerun", "open3d") or (save is not None and viewer != "rerun"):
        raise ConfigurationError(
            f"--with {viewer}: expected rerun, which alone takes --save, or open3d"
        )
    if viewer == "open3d":
        view_with_open3d(folder)
    else:
        view_result(folder, save)
        if save is not None:
            typer.echo(f"written: {printable_path(save)}; rerun {printable_path(save)} opens it")


def simulate_command(
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="DIR", help="Folder for the map.")
    ] = Path("simulated"),
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="SCENE",
            help="Of boxes: indoor (default), storeys, ramp or street. Of meshes, with Open3D: "
            "office, lobby, warehouse, garage, corridor, stairs, park, room; street with --sensor.",
        ),
    ] = None,
    sensor: Annotated[
        str | None,
        typer.Option(
            metavar="SENSOR",
            help="Of scenes of meshes: vlp16 (default), ring32, ring64, os64 or mid360.",
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option(help="Seed of plan, people, noise and drift; 0 if not given.")
    ] = None,
    points: Annotated[
        int | None,
        typer.Option(
            metavar="N",
            help="Points of the map, exactly; more blocks of scene are added as needed.",
        ),
    ] = None,
    map_only: Annotated[
        bool | None,
        typer.Option(
            "--map-only/--all",
            help="Leave out the scans, the static truth and the low-activity map. "
            "Default: all files; with --points, only the map.",
            show_default=False,
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="KEY=VALUE", help="One parameter, such as walkers=20."),
    ] = None,
) -> None:
    """Make a map with ghosts in it, and the truth about it: a robot drives among people."""
    from pipeline.progress import watching  # noqa: PLC0415
    from pipeline.simulation import load_simulation, write_simulation  # noqa: PLC0415

    given = {"scene": scene, "sensor": sensor, "seed": seed, "points": points}
    options = [f"{name}={value}" for name, value in given.items() if value is not None]
    parameters = load_simulation([*(settings or []), *options])
    map_only = parameters.points is not None if map_only is None else map_only
    with watching() as observer:
        observer.stage("simulate", parameters.expected_points)
        files = write_simulation(parameters, output, map_only=map_only, advance=observer.advance)
    typer.echo(f"written: {files.map} and its truth beside it")


def keys_command() -> None:
    """Show every key of the configuration: its meaning, unit, default, and what is allowed."""
    from pipeline.configuration.page import configuration_page  # noqa: PLC0415

    typer.echo(configuration_page(), nl=False)


def manual_command(context: typer.Context) -> None:
    """Print the manual page: dynahull-pipeline manual > dynahull-pipeline.1, for `man`."""
    parent = context.parent
    assert parent is not None  # of the group
    typer.echo(manual_page(parent))
