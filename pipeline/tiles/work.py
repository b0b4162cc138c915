"""The work folder of a run: what each task left, and the markers that say it is complete.

A task writes its files under temporary names, flushes and renames them, and writes its marker last.
A marker names the key of the run, a hash of input and configuration: work of another run is never
taken for this one's. So a run killed at any moment goes on with the tasks that have no marker.
"""

import json
import shutil
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from pipeline.tiles.array_file import map_array, read_arrays, write_arrays
from tiling.atomic import atomic_file

WORK_FOLDER = ".dynahull-work"
"""Within the output folder."""

_ARRAYS = ".arrays"
"""Suffix of what a task keeps."""

REMOVED_FOLDER = f"{WORK_FOLDER}-removed"
"""Its name while it is being removed."""


@dataclass(frozen=True, slots=True)
class TaskReport:
    """What a finished task has to say: a few numbers, since points travel through files.

    Attributes
    ----------
    points : int
        Points that the task was about.
    counts : tuple of int
        What the stage counts.
    seconds : float
        Time the task took.
    """

    points: int
    counts: tuple[int, ...] = ()
    seconds: float = 0.0


@dataclass(frozen=True, slots=True)
class WorkFolder:
    """Where the tasks of one run leave their files.

    Attributes
    ----------
    root : Path
        The folder.
    key : str
        Hash of the input and of the configuration, as far as it decides results.
    """

    root: Path
    key: str

    @property
    def state_path(self) -> Path:
        """The file that tells other terminals how far the run is."""
        return self.root / "state.json"

    def path(self, stage: str, task: int, suffix: str) -> Path:
        """Return the file of a task, in a folder of its stage."""
        return self.root / stage / f"{task:06d}{suffix}"

    def make(self, stage: str) -> None:
        """Make the folder of a stage."""
        (self.root / stage).mkdir(parents=True, exist_ok=True)

    def report(self, stage: str, task: int) -> TaskReport | None:
        """Return what a finished task reported, None if it is not finished."""
        try:
            marker = json.loads(self.path(stage, task, ".done").read_text(encoding="utf-8"))
            if marker["key"] != self.key:
                return None
            report = marker["report"]
            return TaskReport(report["points"], tuple(report["counts"]), report["seconds"])
        except (FileNotFoundError, ValueError, KeyError, TypeError):
            return None

    def finish(self, stage: str, task: int, report: TaskReport) -> None:
        """Mark a task as finished; its files are complete."""
        marker = {"key": self.key, "report": asdict(report)}
        self.write_json(self.path(stage, task, ".done"), marker)

    def save(self, stage: str, task: int, **arrays: NDArray[Any]) -> None:
        """Keep the arrays of a task."""
        with atomic_file(self.path(stage, task, _ARRAYS)) as temporary:
            write_arrays(temporary, arrays)

    def load(self, stage: str, task: int, *names: str) -> list[NDArray[Any]]:
        """Return arrays of a finished task."""
        return read_arrays(self.path(stage, task, _ARRAYS), *names)

    def map(self, stage: str, task: int, name: str) -> NDArray[Any]:
        """Return an array of a finished task, of which only what is looked at is read."""
        return map_array(self.path(stage, task, _ARRAYS), name)

    def write_json(self, path: Path, value: Any) -> None:
        """Write a file that appears whole or not at all."""
        with atomic_file(path) as temporary:
            temporary.write_text(json.dumps(value), encoding="utf-8")


def remove_work(work: Path) -> None:
    """Remove a work folder; one that is half removed is never taken for work again."""
    removed = work.with_name(REMOVED_FOLDER)
    shutil.rmtree(removed, ignore_errors=True)
    if work.exists():
        work.rename(removed)
        shutil.rmtree(removed, ignore_errors=True)


def stages_begun(root: Path) -> Iterator[tuple[str, int, int]]:
    """Yield, for each stage of a work folder, its name and its tasks done and failed."""
    for folder in sorted(path for path in root.iterdir() if path.is_dir()):
        names = [path.suffix for path in folder.iterdir() if not path.name.startswith(".")]
        if ".done" in names or ".failed" in names:
            yield folder.name, names.count(".done"), names.count(".failed")
