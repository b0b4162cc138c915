"""The minutes of a night: each map's line, on the disk at once, and the summary of all."""

import logging
from importlib.metadata import version
from pathlib import Path

from pipeline.nightly.clock import Clock, Ending
from pipeline.nightly.journal import Failure
from pipeline.nightly.results import MapFolder, begun, report_page, run_report
from pipeline.nightly.summary import (
    FAILURES,
    SUMMARY_FILE,
    MapLine,
    MapOutcome,
    NightSummary,
    append_line,
    count_outcomes,
    exit_code,
    put_long_file_aside,
    time_text,
    was_cleaned,
)
from pipeline.showing import only_showing, printable

logger = logging.getLogger("dynahull")


class Minutes:
    """Writes `nightly.jsonl` line by line, and `nightly.json` anew with every line.

    Parameters
    ----------
    output : Path
        Folder of both.
    clock : Clock
    """

    def __init__(self, output: Path, clock: Clock) -> None:
        self._output, self._clock = output, clock
        self._night = time_text(clock.now())
        self._lines: dict[str, MapLine] = {}
        self._problems: list[str] = []
        put_long_file_aside(output)
        self._write(self._summary(None, running=True))

    def problems(self, messages: list[str]) -> None:
        """Put down what could not be looked at, once each."""
        for message in map(printable, messages):
            if message not in self._problems:
                self._problems.append(message)
                logger.error(message)

    def say(
        self,
        path: Path,
        outcome: MapOutcome,
        folder: MapFolder,
        *,
        reason: str | None = None,
        attempts: int = 0,
        seconds: float | None = None,
    ) -> None:
        """Put down what became of a map."""
        line = self._line(path, outcome, folder, reason, attempts, seconds)
        self._lines[str(path)] = line
        append_line(self._output, line)
        self._write(self._summary(None, running=True))
        level = logging.WARNING if outcome in FAILURES else logging.INFO
        why = f" ({printable(reason)})" if reason else ""
        logger.log(level, "%s: %s%s", printable(path), outcome, why)

    def mention(self, path: Path, outcome: MapOutcome, folder: MapFolder) -> None:
        """Put a map into the summary alone, of which nothing new is to be said."""
        self._lines.setdefault(str(path), self._line(path, outcome, folder))

    def say_once(
        self, path: Path, outcome: MapOutcome, folder: MapFolder, failure: Failure | None
    ) -> None:
        """Put down what became of a map, if nothing was said of it in this night."""
        if str(path) in self._lines:
            return
        if outcome is MapOutcome.SET_ASIDE and failure is not None:
            self.say(path, outcome, folder, reason=failure.reason, attempts=failure.attempts)
        else:
            self.say(path, outcome, folder)

    def cleaned_earlier(self, path: Path, run: Path) -> None:
        """Put down a result that a night finished which was killed before it could say so."""
        if not was_cleaned(self._output, self._relative(run)):
            self.say(path, MapOutcome.CLEANED, MapFolder(run.parent))
        else:
            logger.info("%s: cleaned %s", printable(path), time_text(begun(run)))

    def close(self, ending: Ending | None) -> NightSummary:
        """Write the summary of a night that has ended, and return it."""
        summary = self._summary(ending, running=False)
        self._write(summary)
        logger.info(summary.to_text())
        return summary

    def _write(self, summary: NightSummary) -> None:
        with only_showing(SUMMARY_FILE, logger.warning):
            summary.write(self._output)

    def _summary(self, ending: Ending | None, *, running: bool) -> NightSummary:
        lines = sorted(self._lines.values(), key=lambda line: line.map)
        return NightSummary(
            version=version("dynahull-pipeline"),
            night=self._night,
            finished=None if running else time_text(self._clock.now()),
            ended="running" if running else ending or "done",
            exit_code=None if running else exit_code(lines, self._problems, ending == "signal"),
            counts=count_outcomes(lines),
            problems=self._problems,
            maps=lines,
        )

    def _line(
        self,
        path: Path,
        outcome: MapOutcome,
        folder: MapFolder,
        reason: str | None = None,
        attempts: int = 0,
        seconds: float | None = None,
    ) -> MapLine:
        latest = folder.latest()
        report = run_report(latest) if latest is not None else {}
        return MapLine(
            night=self._night,
            time=time_text(self._clock.now()),
            map=str(path),
            outcome=outcome,
            reason=reason,
            attempts=attempts,
            run=self._relative(latest) if latest else None,
            report=self._relative(report_page(latest)) if latest else None,
            points=report.get("points"),
            removed=report.get("counts", {}).get("dynamic"),
            seconds=None if seconds is None else round(seconds, 1),
        )

    def _relative(self, path: Path) -> str:
        return path.relative_to(self._output).as_posix()
