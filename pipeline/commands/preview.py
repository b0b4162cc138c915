"""The command `preview`."""

from pathlib import Path
from typing import Annotated

import typer

from pipeline.commands.options import ConfigurationSource, Maps, Settings


def preview_command(
    maps: Maps,
    output: Annotated[
        str | None,
        typer.Option("-o", "--output", metavar="DIR", help="Folder. [default: <map>_preview]"),
    ] = None,
    config: ConfigurationSource = None,
    settings: Settings = None,
    window: Annotated[
        tuple[float, float, float, float] | None,
        typer.Option(metavar="X0 Y0 X1 Y1", help="Clean this window, metres."),
    ] = None,
    centre: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="X Y", help="Clean a square window around this place."),
    ] = None,
    size: Annotated[
        float, typer.Option(metavar="M", help="Side of the window around --centre, metres.")
    ] = 20.0,
    thin: Annotated[
        bool, typer.Option("--thin", help="Clean the whole map, thinned, instead of a window.")
    ] = False,
    points: Annotated[
        int, typer.Option(metavar="N", min=1_000, help="Points to clean, at most.")
    ] = 500_000,
    open_page: Annotated[
        bool, typer.Option("--open", help="Open the report in the browser.")
    ] = False,
) -> None:
    """Clean a small part of a map in seconds, and show the report: to choose parameters by.

    The part is a typical place of the map, unless a window is given; a small map is cleaned whole.
    """
    from pipeline.configuration.run import load_configuration  # noqa: PLC0415
    from pipeline.errors import ConfigurationError  # noqa: PLC0415
    from pipeline.outputs.folder import REPORT_FILE  # noqa: PLC0415
    from pipeline.preview import WHOLE, Window, preview  # noqa: PLC0415
    from pipeline.progress import watching  # noqa: PLC0415

    if (window is not None) + (centre is not None) + thin > 1:
        raise ConfigurationError("expected one of --window, --centre and --thin, found several")
    if output == "":
        raise ConfigurationError("-o: expected a folder, found nothing")
    chosen = WHOLE if thin else None
    if window is not None:
        chosen = Window(window[:2], window[2:])
    elif centre is not None:
        (x, y), half = centre, size / 2
        chosen = Window((x - half, y - half), (x + half, y + half))
    if chosen is not None and not (
        chosen.low[0] < chosen.high[0] and chosen.low[1] < chosen.high[1]
    ):
        raise ConfigurationError(f"expected a window with X0 < X1 and Y0 < Y1, found {chosen}")
    configuration = load_configuration(config, settings or [])
    with watching() as observer:
        report = preview(
            maps,
            Path(output) if output else None,
            configuration,
            observer,
            points=points,
            window=chosen,
        )
    page = (Path(report.output) / REPORT_FILE).resolve()
    typer.echo(report.summary())
    typer.echo(f"report: {page}")
    if open_page:
        typer.launch(page.as_uri())
