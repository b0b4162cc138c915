"""The commands that clean maps: `run`, `submit` and `cancel` on a cluster, `preview`, `nightly`."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pipeline.commands.options import (
    MAPS,
    TLS,
    ClusterName,
    Confidence,
    ConfigurationSource,
    Folder,
    Fresh,
    HeightOption,
    Maps,
    Output,
    Poses,
    Protect,
    Scans,
    Scheduler,
    Settings,
    WindowOption,
    check_encryption,
    configured,
    named_maps,
    output_folder,
    part_settings,
    pose_settings,
    telling_how_to_go_on,
    worker_settings,
)

if TYPE_CHECKING:
    from pipeline.nightly.settings import NightlySettings
    from pipeline.preview import Window

_WINDOW_SIDE = 20.0


def run_command(
    maps: Annotated[list[str] | None, MAPS] = None,
    output: Output = None,
    config: ConfigurationSource = None,
    settings: Settings = None,
    labels: Annotated[
        bool,
        typer.Option("--labels", help="Write label, cluster and density of every point as well."),
    ] = False,
    fresh: Fresh = False,
    keep_work: Annotated[
        bool, typer.Option("--keep-work", help="Keep the work folder of a map of several tiles.")
    ] = False,
    window: WindowOption = None,
    height: HeightOption = None,
    protect: Protect = None,
    confidence: Confidence = None,
    scans: Scans = None,
    poses: Poses = None,
    scheduler: Scheduler = None,
    cluster: ClusterName = None,
    tls: TLS = False,
) -> None:
    """Clean a map: write it without its ghosts, and the ghosts beside it.

    A run that was interrupted goes on where it was when the same command is given again.
    """
    from pipeline.progress import watching  # noqa: PLC0415
    from pipeline.run import run  # noqa: PLC0415

    wanted = [*(settings or []), *(["output.labels=true"] if labels else [])]
    wanted += ["output.keep_work=true"] if keep_work else []
    wanted += worker_settings(scheduler, cluster, tls) + pose_settings(poses)
    wanted += part_settings(window, height, protect, confidence)
    named, place = named_maps(maps, scans), output_folder(output)
    configuration = configured(config, wanted)
    check_encryption(configuration, tls)
    with telling_how_to_go_on(), watching() as observer:
        report = run(named, place, configuration, observer, fresh=fresh)
    typer.echo(report.summary())


def apply_command(
    folder: Folder,
    output: Annotated[
        str | None,
        typer.Option(
            "-o", "--output", metavar="DIR", help="Output folder.", show_default="the run's own"
        ),
    ] = None,
    confidence: Confidence = None,
    settings: Settings = None,
    protect: Protect = None,
    restore: Annotated[
        list[int] | None,
        typer.Option(metavar="N", help="Put back what was removed at this place of the report."),
    ] = None,
) -> None:
    """Decide again, without computing again: split the map of a run by other settings."""
    from pipeline.apply import decide_again  # noqa: PLC0415
    from pipeline.areas import read_areas  # noqa: PLC0415
    from pipeline.progress import watching  # noqa: PLC0415

    place = output_folder(output)
    wanted = [*(settings or []), *part_settings(None, None, None, confidence)]
    areas = [] if protect is None else read_areas(protect)
    with watching() as observer:
        report = decide_again(folder, place, wanted, areas, restore or [], observer)
    typer.echo(report.summary())


def submit_command(
    maps: Annotated[list[str] | None, MAPS] = None,
    output: Output = None,
    config: ConfigurationSource = None,
    settings: Settings = None,
    window: WindowOption = None,
    height: HeightOption = None,
    protect: Protect = None,
    confidence: Confidence = None,
    scans: Scans = None,
    poses: Poses = None,
    cluster: ClusterName = None,
    tls: TLS = False,
    fresh: Fresh = False,
    dry_run: Annotated[
        bool, typer.Option("--dry-run", help="Print the script of the job, and submit nothing.")
    ] = False,
) -> None:
    """Hand a whole run over to a batch system; `status` and `cancel` follow it by its folder."""
    from pipeline.cluster.submitting import run_script, submit_run  # noqa: PLC0415

    place = output_folder(output)
    wanted = [*(settings or []), *worker_settings(None, cluster, tls), *pose_settings(poses)]
    wanted += part_settings(window, height, protect, confidence)
    named = named_maps(maps, scans)
    configuration = configured(config, wanted)
    if dry_run:
        typer.echo(run_script(named, place, configuration, fresh=fresh), nl=False)
        return
    job, folder = submit_run(named, place, configuration, fresh=fresh)
    system = configuration.execution.cluster
    typer.echo(f"submitted: {system} job {job}; follow it with dynahull-pipeline status {folder}")


def cancel_command(folder: Folder) -> None:
    """Cancel a run that was submitted, and the jobs of its workers; what is done is kept."""
    from pipeline.cluster.submitting import cancel_run  # noqa: PLC0415

    typer.echo(cancel_run(folder))


def preview_command(
    maps: Maps,
    output: Annotated[
        str | None,
        typer.Option(
            "-o", "--output", metavar="DIR", help="Output folder.", show_default="<map>_preview"
        ),
    ] = None,
    config: ConfigurationSource = None,
    settings: Settings = None,
    window: WindowOption = None,
    height: HeightOption = None,
    protect: Protect = None,
    confidence: Confidence = None,
    centre: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="X Y", help="Clean a square window around this place."),
    ] = None,
    size: Annotated[
        float | None,
        typer.Option(
            metavar="M",
            help="Side of the window around --centre, metres.",
            show_default=f"{_WINDOW_SIDE:g}",
        ),
    ] = None,
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
    from pipeline.preview import preview  # noqa: PLC0415
    from pipeline.progress import watching  # noqa: PLC0415
    from pipeline.replacing import REPORT_FILE  # noqa: PLC0415

    place = output_folder(output)
    chosen = _chosen_window(window, centre, size, thin)
    wanted = [*(settings or []), *part_settings(None, height, protect, confidence)]
    configuration = configured(config, wanted)
    with watching() as observer:
        report = preview(maps, place, configuration, observer, points=points, window=chosen)
    page = (Path(report.output) / REPORT_FILE).resolve()
    typer.echo(report.summary())
    typer.echo(f"report: {page}")
    if open_page:
        typer.launch(page.as_uri())


def _chosen_window(
    window: tuple[float, float, float, float] | None,
    centre: tuple[float, float] | None,
    size: float | None,
    thin: bool,
) -> "Window | None":
    """Return the part of the map that is asked for, None for a typical one."""
    from pipeline.errors import ConfigurationError  # noqa: PLC0415
    from pipeline.preview import WHOLE, Window  # noqa: PLC0415

    if (window is not None) + (centre is not None) + thin > 1:
        raise ConfigurationError("expected one of --window, --centre and --thin, found several")
    if size is not None and centre is None:
        raise ConfigurationError("--size: expected --centre with it, found none")
    if thin:
        return WHOLE
    if centre is not None:
        (x, y), half = centre, (_WINDOW_SIDE if size is None else size) / 2
        window = x - half, y - half, x + half, y + half
    if window is None:
        return None
    chosen = Window(window[:2], window[2:])
    if not (chosen.low[0] < chosen.high[0] and chosen.low[1] < chosen.high[1]):
        raise ConfigurationError(f"expected a window with X0 < X1 and Y0 < Y1, found {chosen}")
    return chosen


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
    from pipeline.nightly.minutes import EXIT_LOCKED, EXIT_WELL  # noqa: PLC0415
    from pipeline.nightly.night import clean_nightly  # noqa: PLC0415
    from pipeline.nightly.one_map import Cleaner  # noqa: PLC0415

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
    return summary.exit_code or EXIT_WELL
