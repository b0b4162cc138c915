"""Progress for people and for logs: one interface, a bar at a terminal, plain lines elsewhere."""

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from time import monotonic

from pipeline.showing import only_showing
from tiling.foreign_text import LONGEST_LINE, printable

logger = logging.getLogger("dynahull")

_LINE_EVERY = 10.0
"""Seconds between the lines of a log."""


class Display:
    """Shows one stage at a time; this one shows nothing."""

    def begin(self, stage: str, total: int) -> None:
        """Show a stage of `total` points."""

    def update(self, done: int) -> None:
        """Show how many points of the stage are done."""

    def end(self) -> None:
        """Take the stage away, finished or not."""

    def close(self) -> None:
        """Show nothing any more."""


class StageObserver:
    """Keeps the seconds of each stage and the warnings, and drives a display.

    An `Observer` in the sense of `dynahull.observer`.

    Attributes
    ----------
    seconds : dict of str to float
        Wall time of each stage, in the order of their beginning.
    warnings : list of str
        All warnings, in order.
    """

    def __init__(self, display: Display) -> None:
        self.seconds: dict[str, float] = {}
        self.warnings: list[str] = []
        self._display = display
        self._stage: str | None = None
        self._begun = 0.0
        self._done = 0

    def stage(self, name: str, total: int) -> None:
        """Begin a stage; the one before it has ended."""
        self.finish()
        self._stage, self._begun, self._done = name, monotonic(), 0
        self._show(lambda display: display.begin(name, total))

    def advance(self, points: int) -> None:
        """Count points of the present stage as done."""
        self._done += points
        self._show(lambda display: display.update(self._done))

    def warn(self, message: str) -> None:
        """Keep a warning and log it."""
        message = printable(message, LONGEST_LINE)
        self.warnings.append(message)
        logger.warning("%s", message)

    def finish(self) -> None:
        """End the present stage, if there is one."""
        if self._stage is not None:
            self._show(lambda display: display.end())
            elapsed = monotonic() - self._begun
            self.seconds[self._stage] = self.seconds.get(self._stage, 0.0) + elapsed
            self._stage = None

    def _show(self, call: Callable[[Display], None]) -> None:
        """Show progress; not any more once that failed."""
        with only_showing("the display of progress", self._hide):
            call(self._display)

    def _hide(self, reason: str) -> None:
        self._display = Display()
        logger.warning(reason)


class LogDisplay(Display):
    """Plain lines, now and then: for logs, cron, and pipes."""

    def __init__(self) -> None:
        self._stage, self._total, self._done = "", 0, 0
        self._begun = self._said = 0.0
        self._seen = False

    def begin(self, stage: str, total: int) -> None:
        """Log the stage."""
        self._stage, self._total, self._done, self._seen = stage, total, 0, False
        self._begun = self._said = monotonic()
        logger.info("%s: %s points", stage, f"{total:,}")

    def update(self, done: int) -> None:
        """Log the rate since the last line and the time left, if that is some seconds old.

        What comes first after such a time tells no rate: code was compiled meanwhile.
        """
        if not done:
            return
        now, is_first, self._seen = monotonic(), not self._seen, True
        if now - self._said < _LINE_EVERY:
            return
        rate = max(done - self._done, 1) / (now - self._said)
        self._said, self._done = now, done
        left = max(self._total - done, 0) / rate
        share = min(done / self._total, 1.0) if self._total else 1.0
        more = "" if is_first else f", {rate:,.0f} points/s, {left:.0f} s left"
        logger.info("%s: %.0f %%%s", self._stage, 100 * share, more)

    def end(self) -> None:
        """Log the time the stage took."""
        logger.info("%s: done in %.1f s", self._stage, monotonic() - self._begun)


class TerminalDisplay(Display):
    """A bar with the stage, the rate and the time left."""

    def __init__(self) -> None:
        from rich import console, progress  # noqa: PLC0415 (only a terminal needs it)

        self._progress = progress.Progress(
            progress.TextColumn("{task.description:<12}"),
            progress.BarColumn(),
            progress.TaskProgressColumn(),
            progress.TextColumn("{task.fields[rate]:>18}"),
            progress.TimeElapsedColumn(),
            progress.TextColumn("left"),
            progress.TimeRemainingColumn(),
            console=console.Console(stderr=True),
        )
        self._task, self._total, self._begun = progress.TaskID(0), 1, 0.0

    def begin(self, stage: str, total: int) -> None:
        """Show a new bar below those that are done."""
        self._progress.start()
        self._total = max(total, 1)
        self._task = self._progress.add_task(stage, total=self._total, rate="")
        self._begun = monotonic()

    def update(self, done: int) -> None:
        """Move the bar."""
        rate = done / max(monotonic() - self._begun, 1e-3)
        self._progress.update(self._task, completed=done, rate=f"{rate:,.0f} points/s")

    def end(self) -> None:
        """Leave a full bar: a stage of which no more is told is done."""
        self._progress.update(self._task, completed=self._total)
        self._progress.stop_task(self._task)
        self._progress.refresh()

    def close(self) -> None:
        """Give the terminal back."""
        self._progress.stop()


@contextmanager
def watching() -> Iterator[StageObserver]:
    """Observe a run: with a bar at a terminal, with plain lines on standard error elsewhere."""
    display = Display()
    if logger.isEnabledFor(logging.INFO):  # else --quiet
        with only_showing("the bar of progress", logger.warning):
            display = TerminalDisplay() if sys.stderr.isatty() else LogDisplay()
    observer = StageObserver(display)
    try:
        yield observer
        observer.finish()
    finally:
        with only_showing("the bar of progress", logger.warning):
            display.close()
