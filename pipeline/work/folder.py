"""The work folder of a run: what each task left, and the markers that say it is complete.

A task writes its files under temporary names, flushes and renames them, and writes its marker last.
A marker names the key of the run, a hash of input and configuration: work of another run is never
taken for this one's. So a run killed at any moment goes on with the tasks that have no marker. It
names all that the task wrote as well, each with a checksum: see `pipeline.work.opening`.
"""

import os
import shutil
import stat
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any

from numpy.typing import NDArray

from pipeline.work.files import map_array, read_arrays, read_if_whole, write_arrays, write_sealed
from tiling.ledger import Written
from tiling.output_file import atomic_file

WORK_FOLDER = ".dynahull-work"
"""Within the output folder."""

ARRAYS = ".arrays"
"""Suffix of what a task keeps."""

REMOVED_FOLDER = f"{WORK_FOLDER}-removed"
"""Its name while it is being removed."""


@dataclass(frozen=True, slots=True)
class TaskReport:
    """What a finished task has to say: a few numbers, since points travel through files."""

    points: int
    """Points that the task was about."""
    counts: tuple[int, ...] = ()
    """What the stage counts."""
    seconds: float = 0.0
    """Time the task took."""


@dataclass(frozen=True, slots=True)
class Marker:
    """What says that a task is finished."""

    report: TaskReport
    written: tuple[Written, ...]
    """All that the task wrote."""


@dataclass(frozen=True, slots=True)
class WorkFolder:
    """Where the tasks of one run leave their files."""

    root: Path
    """The folder."""
    key: str
    """Hash of the input and of the configuration, as far as it decides results."""

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

    def step_path(self, step: str) -> Path:
        """Return the marker of a step that is about the whole map, and is not shared out."""
        return self.root / f"{step}.done"

    def report(self, stage: str, task: int) -> TaskReport | None:
        """Return what a finished task reported, None if it is not finished."""
        marker = self.marker(self.path(stage, task, ".done"))
        return None if marker is None else marker.report

    def has_done(self, step: str) -> bool:
        """Tell whether a step that is about the whole map is done."""
        return self.marker(self.step_path(step)) is not None

    def marker(self, path: Path) -> Marker | None:
        """Return what a marker of this run says; None where there is none that is whole."""
        stored = read_if_whole(path)
        try:
            if stored is None or stored["key"] != self.key:
                return None
            report = stored["report"]
            return Marker(
                TaskReport(report["points"], tuple(report["counts"]), report["seconds"]),
                tuple(Written(self._within(name), *of_it) for name, *of_it in stored["written"]),
            )
        except (KeyError, TypeError, ValueError):
            return None

    def _within(self, name: str) -> Path:
        """Return a file of this folder; of no other, whatever a folder from elsewhere says."""
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise ValueError(f"expected a file of {self.root}, found {name}")
        return self.root / name

    def forget(self, stage: str, task: int) -> None:
        """Let a task be done again."""
        self.path(stage, task, ".done").unlink(missing_ok=True)

    def finish(
        self, stage: str, task: int, report: TaskReport, written: Iterable[Written] = ()
    ) -> None:
        """Mark a task as finished; what it wrote is complete."""
        self._mark(self.path(stage, task, ".done"), report, written)

    def finish_step(self, step: str, written: Iterable[Written]) -> None:
        """Mark a step as done that is about the whole map."""
        self._mark(self.step_path(step), TaskReport(0), written)

    def _mark(self, path: Path, report: TaskReport, written: Iterable[Written]) -> None:
        named = [
            (str(each.path.relative_to(self.root)), each.start, each.size, each.checksum)
            for each in written
        ]
        values = {"key": self.key, "report": asdict(report), "written": named}
        write_sealed(path, values)

    def save(
        self,
        stage: str,
        task: int,
        to_map: Mapping[str, NDArray[Any]] = MappingProxyType({}),
        /,
        **arrays: NDArray[Any],
    ) -> None:
        """Keep the arrays of a task, compressed but for those that `map` is to return."""
        with atomic_file(self.path(stage, task, ARRAYS)) as temporary:
            write_arrays(temporary, arrays, to_map)

    def load(self, stage: str, task: int, *names: str) -> list[NDArray[Any]]:
        """Return arrays of a finished task."""
        return read_arrays(self.path(stage, task, ARRAYS), *names)

    def map(self, stage: str, task: int, name: str) -> NDArray[Any]:
        """Return an array that was kept to map: only what is looked at is read."""
        return map_array(self.path(stage, task, ARRAYS), name)


def is_self_contained(work: Path) -> bool:
    """Tell whether a work folder holds folders and files of its own only.

    One that came from elsewhere may hold links in their places, through which tasks would write
    outside of it, and pipes that nothing comes out of.
    """
    waiting = [work]
    while waiting:
        folder = waiting.pop()
        if folder.is_symlink() or not folder.is_dir():
            return False
        with os.scandir(folder) as entries:
            for entry in entries:
                if entry.is_dir(follow_symlinks=False):
                    waiting.append(folder / entry.name)
                    continue
                status = entry.stat(follow_symlinks=False)
                if not stat.S_ISREG(status.st_mode) or status.st_nlink > 1:
                    return False
    return True


def remove_work(work: Path) -> None:
    """Remove a work folder; one that is half removed is never taken for work again."""
    removed = work.with_name(REMOVED_FOLDER)
    with suppress(OSError):
        remove(removed)
    if os.path.lexists(work):
        work.rename(removed)
        with suppress(OSError):
            remove(removed)


def remove(path: Path) -> None:
    """Remove a file, or a folder with all that is in it, if it is there."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


STAGES = ("survey", "cut", "chunk", "columns", "ground", "height", "density", "evidence",
          "label", "write")  # fmt: skip
"""Those whose work is shared out, in their order."""


def stages_begun(root: Path) -> Iterator[tuple[str, int, int]]:
    """Yield, for each stage of a work folder in order, its name and its tasks done and failed."""
    for folder in (root / stage for stage in STAGES):
        if not folder.is_dir():
            continue
        names = [path.suffix for path in folder.iterdir() if not path.name.startswith(".")]
        if ".done" in names or ".failed" in names:
            yield folder.name, names.count(".done"), names.count(".failed")
