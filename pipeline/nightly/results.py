"""Where results lie: a folder for each map, in it one for each run, and `latest`.

A run's folder is named after its beginning and its key, a hash of content and configuration: what
was stopped goes on there, and what is finished is known again, whatever became of the journal.
"""

import hashlib
import json
import logging
import os
import re
import shutil
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache
from pathlib import Path
from typing import Any

from pipeline.configuration.run import Configuration
from pipeline.nightly.settings import Retention
from pipeline.outputs.folder_lock import folder_is_locked
from pipeline.replacing import REPORT_FILE, RUN_FILE, STAGING
from pipeline.work.folder import WORK_FOLDER, remove_work, stages_begun

logger = logging.getLogger("dynahull")

LATEST = "latest"
"""A symbolic link to the last good result."""

_NEXT = ".latest-next"
_REMOVED = ".removed-"

_KEY_LENGTH = 16
_TIME = "%Y-%m-%dT%H-%M-%SZ"
_DAY = 86400.0
_RUN_NAME = re.compile(r"(\d{4}-\d\d-\d\dT\d\d-\d\d-\d\dZ)-([0-9a-f]{16})")


def map_name(path: Path) -> str:
    """Return the name of a map's folder: its own, and a hash of where it lies.

    So maps of the same name do not meet, and the name depends on nothing else.
    """
    own = re.sub(r"[^\w.-]", "_", path.stem)[:80]
    return f"{own}-{hashlib.sha256(os.fsencode(path)).hexdigest()[:8]}"


_UNDECISIVE: Any = {
    "tiling": True,
    "execution": True,
    "cluster": True,
    "output": {"keep_work", "keep_free", "report"},
}
"""Keys on which no result depends."""


def result_key(
    content: str, files: Sequence[Path], configuration: Configuration, poses: str = ""
) -> str:
    """Return the hash of what decides a result: content, poses, configuration, names of several.

    Not the version, so that a new one does not mean that all is cleaned again.
    """
    decisive = configuration.model_dump(mode="json", exclude=_UNDECISIVE)
    names = [path.name for path in files] if len(files) > 1 else []
    text = json.dumps([content, names, decisive, *([poses] if poses else [])], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:_KEY_LENGTH]


@dataclass(frozen=True, slots=True)
class MapFolder:
    """The folder of one map's results."""

    path: Path
    """It need not be there yet."""

    def runs(self) -> list[Path]:
        """Return the folders of all runs, the oldest first."""
        if not self.path.is_dir() or self.path.is_symlink():
            return []
        return sorted(
            each
            for each in self.path.iterdir()
            if _RUN_NAME.fullmatch(each.name) and each.is_dir() and not each.is_symlink()
        )

    def finished(self) -> list[Path]:
        """Return the folders of the runs that are whole, the oldest first."""
        return [run for run in self.runs() if is_finished(run)]

    def of_key(self, key: str) -> Path | None:
        """Return the folder of a run with this key: one that is whole, or else the last."""
        found = (run for run in self.runs() if run.name.endswith(f"-{key}"))
        return max(found, key=lambda run: (is_finished(run), run.name), default=None)

    def result(self, key: str) -> Path | None:
        """Return the folder of a whole run with this key."""
        run = self.of_key(key)
        return run if run and is_finished(run) else None

    def new(self, key: str, now: float) -> Path:
        """Return a folder for a run that begins now; it is not made."""
        return self.path / f"{datetime.fromtimestamp(now, UTC).strftime(_TIME)}-{key}"

    def latest(self) -> Path | None:
        """Return the last good result: where `latest` points, or else the newest that is whole."""
        link = self.path / LATEST
        if link.is_symlink() and is_finished(link):
            return self.path / link.readlink().name
        finished = self.finished()
        return finished[-1] if finished else None

    def point_latest(self, run: Path) -> None:
        """Let `latest` point to a run; at no moment is there none.

        On a file system without links there is none: the newest run that is whole is the latest.
        """
        link = self.path / LATEST
        if link.is_symlink() and str(link.readlink()) == run.name:
            return
        following = self.path / _NEXT
        try:
            following.unlink(missing_ok=True)
            following.symlink_to(run.name, target_is_directory=True)
            following.replace(link)
        except OSError as error:
            _warn_of_no_links(f"{link}: cannot be pointed to a result: {error.strerror or error}")
            with suppress(OSError):
                following.unlink(missing_ok=True)

    def remove(self, run: Path) -> bool:
        """Remove a run that nobody works on; one that is half removed is never taken for a run."""
        if folder_is_locked(run):
            return False
        hidden = run.with_name(_REMOVED + run.name)
        shutil.rmtree(hidden, ignore_errors=True)
        run.rename(hidden)
        shutil.rmtree(hidden, ignore_errors=True)
        return True

    def remove_leftovers(self) -> None:
        """Remove what a process left that was killed while it removed or pointed."""
        if self.path.is_dir() and not self.path.is_symlink():
            (self.path / _NEXT).unlink(missing_ok=True)
            for hidden in self.path.glob(f"{_REMOVED}*"):
                shutil.rmtree(hidden, ignore_errors=True)


@cache
def _warn_of_no_links(reason: str) -> None:
    logger.warning("%s; the newest folder with a %s is the latest", reason, RUN_FILE)


def is_finished(run: Path) -> bool:
    """Tell whether a run's folder is whole."""
    return (run / RUN_FILE).is_file()


def begun(run: Path) -> float:
    """Return when a run began, by its name; seconds since 1970."""
    match = _RUN_NAME.fullmatch(run.name)
    assert match is not None  # as `MapFolder.runs` finds them
    return datetime.strptime(match[1], _TIME).replace(tzinfo=UTC).timestamp()


def tasks_done(run: Path) -> int:
    """Count the tasks of a run of several tiles that need not be done again."""
    work = run / WORK_FOLDER
    return sum(done for _, done, _ in stages_begun(work)) if work.is_dir() else 0


def remove_finished_work(run: Path) -> None:
    """Remove what a whole run had no time to, when it was killed; its work is kept if asked for."""
    shutil.rmtree(run / STAGING, ignore_errors=True)
    if not run_report(run).get("configuration", {}).get("output", {}).get("keep_work"):
        remove_work(run / WORK_FOLDER)


def run_report(run: Path) -> dict[str, Any]:
    """Return what `run.json` of a finished run says, nothing where it cannot be read."""
    try:
        report = json.loads((run / RUN_FILE).read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return report if isinstance(report, dict) else {}


def report_page(run: Path) -> Path:
    """Return what to look at: the report of a finished run, or else its `run.json`."""
    page = run / REPORT_FILE
    return page if page.is_file() else run / RUN_FILE


def remove_old_runs(
    folder: MapFolder, keep: Retention, now: float, wanted: str | None, *, work_may_go_on: bool
) -> None:
    """Remove runs of a map that are neither among the last nor young, the last good one never.

    Parameters
    ----------
    wanted : str or None
        Key of what the map is now, unless it was set aside; its run stays, finished or not.
    work_may_go_on : bool
        Whether unfinished work of another key stays for `keep.days` as well: the map is gone,
        perhaps because its disk is, and may come back.
    """
    stay = {folder.latest(), *folder.finished()[-keep.runs :]}
    for run in folder.runs():
        is_young = keep.days is not None and now - begun(run) <= keep.days * _DAY
        if run in stay or (wanted is not None and run.name.endswith(wanted)):
            continue
        if is_young and (is_finished(run) or work_may_go_on):
            continue
        if folder.remove(run):
            logger.info("removed %s", run)
