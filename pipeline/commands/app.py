"""The command line. Heavy imports live inside the commands, so that `--help` answers at once."""

import inspect
import io
import logging
import os
import signal
import sys
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, NoReturn, TextIO

import typer

from pipeline.commands import evaluate, run, tiles, tools
from tiling.foreign_text import LONGEST_LINE, printable

EXIT_FAILURE = 1
EXIT_USAGE = 2
EXIT_BAD_INPUT = 3
EXIT_INTERRUPTED = 130
EXIT_NOT_READ = 141

logger = logging.getLogger("dynahull")


Quiet = Annotated[
    bool, typer.Option("-q", "--quiet", help="Say no more than warnings and the answer.")
]
Verbose = Annotated[
    bool, typer.Option("-v", "--verbose", help="Say all, and where an error comes from.")
]


def telling(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of how much it says."""

    @wraps(command)
    def told(*, quiet: bool, verbose: bool, **given: Any) -> None:
        if quiet or verbose:
            logger.setLevel(logging.DEBUG if verbose else logging.WARNING)
        command(**given)

    own = inspect.signature(command)
    more = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=False, annotation=kind)
        for name, kind in (("quiet", Quiet), ("verbose", Verbose))
    ]
    told.__signature__ = own.replace(parameters=[*own.parameters.values(), *more])  # type: ignore[attr-defined]
    told.__annotations__ = {**command.__annotations__, "quiet": Quiet, "verbose": Verbose}
    return told


app = typer.Typer(
    name="dynahull-pipeline",
    help="Remove the ghosts of moving things from a finished LiDAR map (DynaHull, arXiv "
    "2401.07541).",
    epilog="Exit codes: 0 done, 1 failed, 2 wrong usage or configuration, 3 a map cannot be read, "
    "130 interrupted; `nightly` has more, see its help.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


class StandardErrorHandler(logging.StreamHandler[TextIO]):
    """Logs to what standard error is now: a progress bar puts itself in its place meanwhile."""

    def __init__(self) -> None:
        logging.Handler.__init__(self)

    @property
    def stream(self) -> TextIO:
        """Standard error."""
        return sys.stderr

    @stream.setter
    def stream(self, stream: TextIO) -> None:
        raise AttributeError("the stream is standard error, whatever that is")


def _show_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version  # noqa: PLC0415

        typer.echo(version("dynahull-pipeline"))
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool,
        typer.Option("--version", callback=_show_version, is_eager=True, help="Show the version."),
    ] = False,
) -> None:
    """Take the options of every command."""


for name, command in (  # in the order of a first day
    ("simulate", tools.simulate_command),
    ("info", tools.info_command),
    ("preview", run.preview_command),
    ("run", run.run_command),
    ("view", tools.view_command),
    ("evaluate", evaluate.evaluate_command),
    ("apply", run.apply_command),
    ("verify", tools.verify_command),
    ("plan", tiles.plan_command),
    ("status", tiles.status_command),
    ("discard", tiles.discard_command),
    ("submit", run.submit_command),
    ("cancel", run.cancel_command),
    ("nightly", run.nightly_command),
    ("tile", tiles.tile_command),
    ("keys", tools.keys_command),
    ("manual", tools.manual_command),
):
    app.command(name)(telling(command))
app.command("clean", hidden=True)(telling(tiles.clean_command))


def main() -> NoReturn:
    """Run the command line, and turn every error that is expected into one line."""
    _open_streams()
    logging.basicConfig(
        level=logging.WARNING,
        format="%(asctime)s %(levelname)s %(message)s",
        handlers=[StandardErrorHandler()],
    )
    logger.setLevel(logging.INFO)
    # A scheduler stops a job with SIGTERM, a lost terminal with SIGHUP: leave through the same door
    # as Ctrl-C, tidily.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        signal.signal(signal.SIGHUP, signal.default_int_handler)
    output = sys.stdout
    try:
        app(prog_name="dynahull-pipeline")
    except SystemExit as ended:
        if ended.code == EXIT_FAILURE and sys.stdout is not output:
            # Typer's own end where the reader of the output has gone. Other tools die of that
            # signal: so do pipes see it here, and it is not taken for a failure of the command.
            sys.exit(EXIT_NOT_READ)
        if ended.code == EXIT_INTERRUPTED:  # Typer's own end of Ctrl-C, which says nothing
            _fail("interrupted", EXIT_INTERRUPTED)
        raise
    except Exception as error:
        code = _expected_exit_code(error)
        if code is None:
            logger.exception("this is a defect of dynahull-pipeline; please report it")
            sys.exit(EXIT_FAILURE)
        logger.debug("where it came from", exc_info=True)
        message = " ".join(str(error).split()) or type(error).__name__
        _fail(printable(message, LONGEST_LINE), code)
    sys.exit(0)


def _open_streams() -> None:
    """Make up for streams that the caller closed, and let no name that is not text end a command.

    A file that is opened later would else get the number of a closed stream, and whatever is
    printed there.
    """
    for number in range(3):
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # the lowest number that is free
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if stream is None:
            stream = Path(os.devnull).open("w", encoding="utf-8")  # noqa: SIM115
            setattr(sys, name, stream)
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")


def _expected_exit_code(error: Exception) -> int | None:
    """Return the exit code of an error that users can act on, None for a defect."""
    from dynahull.errors import (  # noqa: PLC0415
        DynaHullError,
        InvalidParametersError,
        MissingClassificationError,
    )
    from pipeline.errors import ConfigurationError, PipelineError  # noqa: PLC0415
    from tiling.errors import ChunkError, TilingError  # noqa: PLC0415

    if isinstance(error, ConfigurationError | InvalidParametersError):
        return EXIT_USAGE
    if isinstance(error, ChunkError):  # it is about work, and not about the map
        return EXIT_FAILURE
    if isinstance(error, TilingError | MissingClassificationError):
        return EXIT_BAD_INPUT
    if isinstance(error, DynaHullError | PipelineError | OSError | MemoryError):
        return EXIT_FAILURE
    return None


def _fail(message: str, code: int) -> NoReturn:
    print(f"error: {message}", file=sys.stderr)
    sys.exit(code)
