"""What a run may replace in its output folder: what a run before it wrote there, and no more."""

import json
import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from pipeline.errors import OutputError

RUN_FILE = "run.json"
CONFIGURATION_FILE = "config.yaml"
LABELS_FILE = "labels.parquet"
REPORT_FILE = "report.html"
KINDS = ("static", "dynamic", "labelled", "thinned")
STAGING = ".dynahull-partial"
HIDDEN = (STAGING, ".dynahull-work", ".dynahull-work-removed", ".dynahull-cluster")
"""Folders within the output folder that are the product's own, and are removed with all in them."""

_PUBLISHED = "published.json"
"""Within the staging folder: what is being renamed into place, and what is removed for it."""


def no_result(folder: Path) -> str:
    """Say that a folder holds no result of a run, or one whose report cannot be read."""
    report = folder / RUN_FILE
    if report.is_file():
        return f"{report}: expected the report of a run, found a damaged file; run again"
    return f"{folder}: expected the output of a run, found no {RUN_FILE}"


def refuse_to_replace(folder: Path, results: Sequence[Path], inputs: Sequence[Path]) -> None:
    """Refuse to replace or remove an input, or a file that no run wrote, or to write elsewhere.

    Parameters
    ----------
    folder : Path
        The output folder; it need not be there.
    results : sequence of Path
        By their names in the folder.
    inputs : sequence of Path
        The map files. They are known by any name: links, and names that differ in case where the
        file system takes them for one.

    Raises
    ------
    OutputError
    """
    refuse_own_folders(folder, inputs)
    taken = {_identity(path) for path in inputs}
    half_published = _half_published(folder)
    own = {*earlier_results(folder), *half_published}
    for name in (*results, *sorted(own - set(results))):
        place = folder / name
        if not place.parent.resolve().is_relative_to(folder.resolve()):
            raise OutputError(f"{place.parent}: expected a folder, found a link out of {folder}")
        if os.path.lexists(place):
            if place.exists() and _identity(place) in taken:
                raise OutputError(
                    f"{place}: this input lies where a result goes; choose another -o"
                )
            if name not in own:
                raise OutputError(f"{place}: there is a file that no run wrote; choose another -o")


def refuse_own_folders(folder: Path, inputs: Iterable[Path]) -> None:
    """Refuse inputs within folders that a run empties, links in their place, a file as the folder.

    Raises
    ------
    OutputError
    """
    if folder.exists() and not folder.is_dir():
        raise OutputError(f"{folder}: expected a folder for the results, found a file")
    places = [folder / name for name in HIDDEN]
    for place in places:
        if place.is_symlink():
            raise OutputError(f"{place}: expected a folder of a run's own, found a link")
    emptied = {_identity(place) for place in places if place.exists()}
    parents = {path.resolve().parent: path for path in inputs} if emptied else {}
    for parent, path in parents.items():
        if any(_identity(each) in emptied for each in (parent, *parent.parents)):
            raise OutputError(f"{path}: this input lies where a run works; choose another -o")


def earlier_results(folder: Path) -> list[Path]:
    """Return the names of what the last complete run left here, by its own account."""
    try:
        report = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
        if not {"version", "input_hash", "outputs"} <= report.keys():
            return []
        names = [Path(name) for name in report["outputs"]]
    except (OSError, ValueError, AttributeError, TypeError):
        return []
    return [name for name in names if _is_result(name)]


def record_publishing(staging: Path, folder: Path, names: Iterable[Path]) -> Path:
    """Put down which files are about to be renamed into place, and which removed for them.

    If the run is killed meanwhile, the next one knows them by it.
    """
    states = {str(name): _state(staging / name) for name in names}
    earlier = [name for name in earlier_results(folder) if (folder / name).is_file()]
    states |= {f"earlier/{name}": _state(folder / name) for name in earlier}
    path = staging / _PUBLISHED
    path.write_text(json.dumps(states), encoding="utf-8")
    return path


def remove_half_published(folder: Path) -> None:
    """Remove what a run left that was killed while it published: parts of two sets of results."""
    for name in _half_published(folder):
        (folder / name).unlink(missing_ok=True)


def _half_published(folder: Path) -> set[Path]:
    """Return the names of files that a killed run published, and that nobody has changed since."""
    if os.path.lexists(folder / RUN_FILE):
        return set()  # the earlier results are whole, or the new ones
    try:
        states = json.loads((folder / STAGING / _PUBLISHED).read_text(encoding="utf-8"))
        named = [(Path(name.removeprefix("earlier/")), state) for name, state in states.items()]
        return {
            name
            for name, state in named
            if _is_result(name) and (folder / name).is_file() and _state(folder / name) == state
        }
    except (OSError, ValueError, AttributeError):
        return set()


def _is_result(name: Path) -> bool:
    """Tell whether a run writes files of this name: what else a list names is never removed."""
    if name.is_absolute() or ".." in name.parts or not name.parts:
        return False
    if len(name.parts) == 1:
        files = (RUN_FILE, CONFIGURATION_FILE, LABELS_FILE, REPORT_FILE)
        return str(name) in files or name.name.partition(".")[0] in KINDS
    return name.parts[0] in KINDS


def _identity(path: Path) -> tuple[int, int]:
    state = path.stat()
    return state.st_dev, state.st_ino


def _state(path: Path) -> list[Any]:
    """Return what a file keeps when it is renamed, and not when it is written."""
    state = path.lstat()
    return [state.st_size, state.st_mtime_ns, state.st_ino]
