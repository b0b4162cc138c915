"""The minutes of a night: a line for each map, on the disk at once, and the summary of all."""

import json
import logging
import os
import re
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel

from pipeline.errors import NightlyError
from pipeline.nightly.clock import Clock, Ending
from pipeline.nightly.journal import Failure
from pipeline.nightly.results import MapFolder, begun, report_page, run_report
from pipeline.showing import only_showing, printable
from pipeline.templates import render
from tiling.output_file import atomic_file

logger = logging.getLogger("dynahull")

LINES_FILE = "nightly.jsonl"
SUMMARY_FILE = "nightly.json"
INDEX_FILE = "index.html"

EXIT_WELL = 0
EXIT_SOME_FAILED = 4
EXIT_LOCKED = 75
EXIT_SIGNALLED = 130

_INDEX_TITLE = "dynahull-pipeline: night of "

_NAMED = 5
"""Maps that failed, by name in the last line."""

_MINUTE = "%Y-%m-%d %H:%M UTC"

_MOST_NIGHTS = 30
_ICON = re.compile(r'<link rel="icon" href="(data:image/png;base64,[A-Za-z0-9+/=]+)">')
_HEAD = 100_000
"""Characters of a report within which its picture is."""


class MapOutcome(StrEnum):
    """What became of a map in a night."""

    CLEANED = "cleaned"
    UNCHANGED = "unchanged"
    """Its result is there."""
    WAITING = "waiting"
    """It is still being written, or was changed while it was read."""
    STOPPED = "stopped"
    """The night ended; what is done of it is kept."""
    LEFT = "left"
    """Not begun: the night was over."""
    FAILED = "failed"
    NO_SPACE = "no space"
    """It would take more disk than there is."""
    SET_ASIDE = "set aside"
    """It failed too often in earlier nights."""
    VANISHED = "vanished"
    """Its files are gone; results stay."""


FAILURES = (MapOutcome.FAILED, MapOutcome.NO_SPACE)
"""What makes the exit code 4."""


class MapLine(BaseModel, frozen=True):
    """One line of `nightly.jsonl`."""

    night: str
    time: str
    """Beginning of the night, and when this was said; UTC, ISO 8601."""
    map: str
    """The file or folder."""
    outcome: MapOutcome
    reason: str | None = None
    """Of a failure, in one line."""
    attempts: int = 0
    """Nights that this content failed, this one counted."""
    run: str | None = None
    """The last good result, relative to the output folder: this night's where it was cleaned."""
    report: str | None = None
    """The page to look at, relative to the output folder."""
    points: int | None = None
    removed: int | None = None
    warnings: list[str] = []
    """Of that result."""
    seconds: float | None = None
    """That this night took for the map."""


class NightSummary(BaseModel, frozen=True):
    """What `nightly.json` holds."""

    version: str
    night: str
    finished: str | None = None
    """Beginning and end; no end while the night lasts, or when it was killed."""
    ended: Literal["running", "done", "time", "signal"] = "running"
    """`done`: nothing was left to do. `time`: `stop_after`."""
    exit_code: int | None = None
    counts: dict[str, int]
    """Maps by outcome."""
    problems: list[str]
    """Inputs that could not be looked at."""
    maps: list[MapLine]
    """The last line of each map."""

    def write(self, folder: Path) -> None:
        """Replace `nightly.json`."""
        with atomic_file(folder / SUMMARY_FILE) as temporary:
            text = json.dumps(self.model_dump(mode="json"), indent=2)
            temporary.write_text(text + "\n", encoding="utf-8")

    def to_text(self) -> str:
        """Return the line at the end of a night."""
        counts = ", ".join(f"{count} {outcome}" for outcome, count in self.counts.items())
        why = {"time": "; stop_after is over", "signal": "; stopped by a signal"}
        failed = [printable(Path(line.map).name) for line in self.maps if line.outcome in FAILURES]
        more = f" and {len(failed) - _NAMED} more" if len(failed) > _NAMED else ""
        named = f"; failed: {', '.join(failed[:_NAMED])}{more}" if failed else ""
        return f"{counts or 'no maps'}{why.get(self.ended, '')}{named}"


def write_index(folder: Path, summary: NightSummary) -> None:
    """Replace the page to look at in the morning: what went wrong first, then the maps by name.

    It opens from the disk and needs nothing else.
    """
    bad = (*FAILURES, MapOutcome.SET_ASIDE)
    page = render(
        "nightly/index.html",
        title=_INDEX_TITLE,
        night=f"{datetime.fromisoformat(summary.night):{_MINUTE}}",
        summary=summary,
        lines=sorted(summary.maps, key=lambda line: (line.outcome not in bad, line.map)),
        bad=bad,
        nights=last_nights(folder / LINES_FILE),
        picture=lambda line: thumbnail(folder / line.report) if line.report else None,
        begun=lambda run: f"{datetime.fromtimestamp(begun(Path(run)), UTC):{_MINUTE}}",
    )
    with atomic_file(folder / INDEX_FILE) as temporary:
        temporary.write_text(page, encoding="utf-8")


def refuse_to_replace(output: Path) -> None:
    """Refuse an output folder with files that nights replace and that none of them wrote."""
    for name, mark in ((INDEX_FILE, f"<title>{_INDEX_TITLE}"), (SUMMARY_FILE, '\n  "night": "20')):
        path = output / name
        if os.path.lexists(path) and not _holds(path, mark):
            raise NightlyError(f"{path}: there is a file that no night wrote; use another output")
    lines = output / LINES_FILE
    if os.path.lexists(lines) and (lines.is_symlink() or not lines.is_file()):
        raise NightlyError(f"{lines}: expected a file of a night's, found a link or a folder")


def _holds(path: Path, mark: str) -> bool:
    try:
        return mark in path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False


def time_text(now: float) -> str:
    """Return a time as text: UTC, ISO 8601."""
    return datetime.fromtimestamp(now, UTC).isoformat(timespec="seconds")


def append_line(folder: Path, line: MapLine) -> None:
    """Append a line to `nightly.jsonl`; after one that was cut off, on a line of its own."""
    path = folder / LINES_FILE
    text = json.dumps(line.model_dump(mode="json", exclude_none=True)) + "\n"
    with path.open("ab+") as stream:
        if stream.tell():
            stream.seek(-1, 2)
            text = text if stream.read(1) == b"\n" else "\n" + text
        stream.write(text.encode())


def was_cleaned(folder: Path, run: str) -> bool:
    """Tell whether `nightly.jsonl` says of a result that it was made."""
    lines = _lines_of(folder / LINES_FILE)
    return any((line.get("outcome"), line.get("run")) == ("cleaned", run) for line in lines)


def _lines_of(path: Path) -> Iterator[dict[str, Any]]:
    """Yield the whole lines of a file that need not be there."""
    if path.is_file():
        with path.open(encoding="utf-8", errors="replace") as stream:
            for text in stream:
                with suppress(ValueError):  # cut off by a kill
                    yield json.loads(text)


@dataclass(slots=True)
class NightFigures:
    """Of one night: maps by outcome, points of those that were cleaned, and how many went."""

    night: str
    maps: Counter[str] = field(default_factory=Counter)
    points: int = 0
    removed: int = 0

    @property
    def total(self) -> int:
        """Maps that were cleaned or failed."""
        return self.maps["cleaned"] + self.maps["failed"] + self.maps["no space"]

    @property
    def share(self) -> float | None:
        """Percent removed, None where nothing was cleaned."""
        return 100 * self.removed / self.points if self.points else None


def last_nights(lines: Path) -> list[NightFigures]:
    """Return the figures of the last nights that put something down, the latest last."""
    nights: dict[str, NightFigures] = {}
    for line in _lines_of(lines):
        with suppress(KeyError, TypeError):  # a line of something else
            of_night = nights.setdefault(line["night"], NightFigures(line["night"]))
            of_night.maps[line["outcome"]] += 1
            if line["outcome"] == "cleaned":
                of_night.points += line.get("points") or 0
                of_night.removed += line.get("removed") or 0
    return [nights[night] for night in sorted(nights)][-_MOST_NIGHTS:]


def thumbnail(page: Path) -> str | None:
    """Return the picture that a report carries as its icon, as a data URI."""
    try:
        with page.open(encoding="utf-8") as stream:
            found = _ICON.search(stream.read(_HEAD))
    except (OSError, ValueError):
        return None
    return found[1] if found else None


class Minutes:
    """Writes `nightly.jsonl` line by line, and `nightly.json` anew with every line."""

    def __init__(self, output: Path, clock: Clock) -> None:
        self._output, self._clock = output, clock
        self._night = time_text(clock.now())
        self._lines: dict[str, MapLine] = {}
        self._problems: list[str] = []
        self._write(self._summary())

    def problems(self, messages: list[str]) -> None:
        """Put down what could not be looked at, once each."""
        for message in map(printable, messages):
            if message not in self._problems:
                self._problems.append(message)
                logger.error(message)

    def say(self, path: Path, outcome: MapOutcome, folder: MapFolder, **more: Any) -> None:
        """Put down what became of a map; more of it as `MapLine` has it."""
        line = self._line(path, outcome, folder, **more)
        self._lines[str(path)] = line
        append_line(self._output, line)
        self._write(self._summary())
        level = logging.WARNING if outcome in FAILURES else logging.INFO
        why = f" ({printable(line.reason)})" if line.reason else ""
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
        why: dict[str, Any] = {}
        if outcome is MapOutcome.SET_ASIDE and failure is not None:
            why = {"reason": failure.reason, "attempts": failure.attempts}
        self.say(path, outcome, folder, **why)

    def cleaned_earlier(self, path: Path, run: Path) -> None:
        """Put down a result that a night finished which was killed before it could say so."""
        if not was_cleaned(self._output, self._relative(run)):
            self.say(path, MapOutcome.CLEANED, MapFolder(run.parent))
        else:
            logger.info("%s: cleaned %s", printable(path), time_text(begun(run)))

    def close(self, ending: Ending | None) -> NightSummary:
        """Write the summary of a night that has ended, and return it."""
        summary = self._summary(
            finished=time_text(self._clock.now()),
            ended=ending or "done",
            exit_code=self._exit_code(ending),
        )
        self._write(summary)
        logger.log(logging.WARNING if summary.exit_code else logging.INFO, summary.to_text())
        return summary

    def _write(self, summary: NightSummary) -> None:
        with only_showing(SUMMARY_FILE, logger.warning):
            summary.write(self._output)

    def _exit_code(self, ending: Ending | None) -> int:
        """Return what cron and systemd are told."""
        if self._problems or any(line.outcome in FAILURES for line in self._lines.values()):
            return EXIT_SOME_FAILED
        return EXIT_SIGNALLED if ending == "signal" else EXIT_WELL

    def _summary(self, **more: Any) -> NightSummary:
        """Return what is known by now; more of a night that has ended, as `NightSummary` has it."""
        lines = sorted(self._lines.values(), key=lambda line: line.map)
        counts = Counter(line.outcome for line in lines)
        return NightSummary(
            version=version("dynahull-pipeline"),
            night=self._night,
            counts={outcome.value: counts[outcome] for outcome in MapOutcome if counts[outcome]},
            problems=self._problems,
            maps=lines,
            **more,
        )

    def _line(self, path: Path, outcome: MapOutcome, folder: MapFolder, **more: Any) -> MapLine:
        latest = folder.latest()
        report = run_report(latest) if latest else {}
        return MapLine(
            night=self._night,
            time=time_text(self._clock.now()),
            map=str(path),
            outcome=outcome,
            run=self._relative(latest) if latest else None,
            report=self._relative(report_page(latest)) if latest else None,
            points=report.get("points"),
            removed=report.get("counts", {}).get("dynamic"),
            warnings=[printable(each) for each in report.get("warnings", [])],
            **more,
        )

    def _relative(self, path: Path) -> str:
        return path.relative_to(self._output).as_posix()
