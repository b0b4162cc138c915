"""The command `nightly`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.options import Settings

if TYPE_CHECKING:
    from pipeline.nightly.settings import NightlySettings


def nightly_command(
    source: Annotated[
        Path | None,
        typer.Argument(
            metavar="NIGHTLY.yaml", help="What is cleaned every night.", show_default=False
        ),
    ] = None,
    settings: Settings = None,
    retry: Annotated[
        bool, typer.Option("--retry", help="Try once more what was set aside.")
    ] = False,
    schedule: Annotated[
        bool,
        typer.Option(
            "--schedule", help="Print a line for cron, and a service and timer of systemd."
        ),
    ] = False,
    install: Annotated[bool, typer.Option("--install", hidden=True)] = False,
    example: Annotated[
        bool, typer.Option("--example", help="Print a commented NIGHTLY.yaml to begin with.")
    ] = False,
) -> None:
    """Clean the maps that are new or changed, one after the other: for cron and systemd.

    Exit codes: 0 all well, 4 some maps failed, 75 another night holds the lock, 130 stopped by a
    signal, 2 wrong configuration, 1 anything else.
    """
    from pipeline.configuration.run import NIGHTLY_EXAMPLE, configurations_folder  # noqa: PLC0415
    from pipeline.errors import ConfigurationError  # noqa: PLC0415

    if example:
        text = (configurations_folder() / NIGHTLY_EXAMPLE).read_text(encoding="utf-8")
        typer.echo(text, nl=False)
        return
    if source is None:
        raise ConfigurationError("nightly: expected a YAML file, found none; see --example")

    from pipeline.nightly.settings import load_nightly_settings  # noqa: PLC0415

    found = load_nightly_settings(source, settings or [])
    if install:
        typer.echo("note: --install is called --schedule now, as it installs nothing", err=True)
    if install or schedule:
        from pipeline.nightly.install import install_text  # noqa: PLC0415

        typer.echo(install_text(found, source, settings or []))
        return
    raise typer.Exit(_exit_code_of_night(found, retry))


def _exit_code_of_night(settings: "NightlySettings", retry: bool) -> int:
    """Spend a night, and return what the command ends with."""
    from pipeline.errors import NightLockedError, NightlyError  # noqa: PLC0415
    from pipeline.nightly.clock import Clock, NightEnd  # noqa: PLC0415
    from pipeline.nightly.night import clean_nightly  # noqa: PLC0415
    from pipeline.nightly.one_map import Cleaner  # noqa: PLC0415
    from pipeline.nightly.summary import EXIT_LOCKED, EXIT_WELL  # noqa: PLC0415

    clock = Clock()
    end = NightEnd(clock, settings.stop_after)
    try:
        with end.listening():
            summary = clean_nightly(settings, Cleaner(), clock, end, retry=retry)
    except NightLockedError as error:
        typer.echo(f"error: {error}", err=True)
        return EXIT_LOCKED
    except OSError as error:
        place = error.filename or settings.output
        raise NightlyError(f"{place}: {error.strerror or error}") from error
    return EXIT_WELL if summary.exit_code is None else summary.exit_code
