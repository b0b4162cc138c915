"""The output folder of a run: all of it appears at once, or none of it does.

Files are written into a hidden folder beside their places, flushed to the disk, and renamed when
all are complete. `run.json` goes first and comes back last: a folder that has one is whole.
"""

import fcntl
import json
import os
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from pipeline.errors import OutputError
from tiling.formats import MapReader

RUN_FILE = "run.json"
CONFIGURATION_FILE = "config.yaml"
LABELS_FILE = "labels.parquet"
_STAGING = ".dynahull-partial"
_RESULT_FOLDERS = ("static", "dynamic")
_LABELS = Path(LABELS_FILE)


@dataclass(frozen=True, slots=True)
class OutputNames:
    """Names of the results, relative to the output folder; one of each for every input file.

    Attributes
    ----------
    static, dynamic : tuple of Path
        In the order of the input files.
    """

    static: tuple[Path, ...]
    dynamic: tuple[Path, ...]

    @classmethod
    def of(cls, readers: Sequence[MapReader]) -> "OutputNames":
        """Choose names: `static.<ext>` for one file, `static/<its own name>` for several."""
        if len(readers) == 1:
            suffix = readers[0].description.suffix
            return cls((Path(f"static{suffix}"),), (Path(f"dynamic{suffix}"),))
        own = _own_names([reader.description.path for reader in readers])
        names = [
            name.with_name(_stem(name) + reader.description.suffix)
            for name, reader in zip(own, readers, strict=True)
        ]
        return cls(
            tuple(Path("static") / name for name in names),
            tuple(Path("dynamic") / name for name in names),
        )


def default_folder(paths: Sequence[Path]) -> Path:
    """Return `<map>_dynahull`, named after the only file, or after the folder of several."""
    first = paths[0].resolve()
    name = _stem(first) if len(paths) == 1 else first.parent.name
    return Path(f"{name}_dynahull")


@contextmanager
def output_folder(folder: Path, inputs: Sequence[Path]) -> Iterator[Path]:
    """Claim an output folder, and publish what was written when the block ends without an error.

    Parameters
    ----------
    folder : Path
        Made if it is not there; earlier results in it are replaced.
    inputs : sequence of Path
        The map files, none of which may lie where results go.

    Yields
    ------
    Path
        An empty folder to write into, by the names the files will have in `folder`.

    Raises
    ------
    OutputError
        When the folder cannot be made or written, holds an input, or another run works in it.
    """
    _refuse_inputs_among_results(folder, inputs)
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with _locked(folder):
            staging = folder / _STAGING
            shutil.rmtree(staging, ignore_errors=True)
            staging.mkdir()
            try:
                yield staging
                _publish(staging, folder)
            finally:
                shutil.rmtree(staging, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{error.filename or folder}: {error.strerror or error}") from error
    finally:
        for path in missing:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def _refuse_inputs_among_results(folder: Path, inputs: Sequence[Path]) -> None:
    """Refuse, before any work, an output folder in which a result would replace an input."""
    place = folder.resolve()
    for path in inputs:
        resolved = path.resolve()
        if not resolved.is_relative_to(place):
            continue
        name = resolved.relative_to(place)
        if name.parts[0] in _RESULT_FOLDERS or name.stem in _RESULT_FOLDERS or name == _LABELS:
            raise OutputError(f"{path}: this input lies where results go; choose another -o")


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """Hold the folder's lock, which the system frees however the process ends."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise OutputError(f"{folder}: another run is writing into this folder") from None
        yield
    finally:
        os.close(handle)


def _publish(staging: Path, folder: Path) -> None:
    """Rename all files into place, `run.json` last."""
    files = [path.relative_to(staging) for path in sorted(staging.rglob("*")) if path.is_file()]
    files.sort(key=lambda name: name == Path(RUN_FILE))
    for name in files:
        _flush(staging / name)
    _remove_earlier_results(folder)
    (folder / RUN_FILE).unlink(missing_ok=True)
    _flush(folder)
    for name in files:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (staging / name).replace(folder / name)
    for name in {(folder / name).parent for name in files}:
        _flush(name)


def _remove_earlier_results(folder: Path) -> None:
    """Remove what the last complete run left here, by its own account."""
    try:
        outputs = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))["outputs"]
        names = [Path(name) for name in outputs if ".." not in Path(name).parts]
    except (OSError, ValueError, KeyError, TypeError):
        return
    names = [name for name in names if not name.is_absolute()]
    for name in names:
        if (folder / name).is_file():
            (folder / name).unlink()
    for parent in {name.parent for name in names} - {Path()}:
        if (folder / parent).is_dir() and not any((folder / parent).iterdir()):
            (folder / parent).rmdir()


def _flush(path: Path) -> None:
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _own_names(paths: Sequence[Path]) -> list[Path]:
    """Return the files' own names, with as many of their folders as make them different."""
    resolved = [path.resolve() for path in paths]
    if len({path.name for path in resolved}) == len(resolved):
        return [Path(path.name) for path in resolved]
    common = Path(os.path.commonpath([path.parent for path in resolved]))
    return [path.relative_to(common) for path in resolved]


def _stem(path: Path) -> str:
    """Return the name without its suffix, `.copc.laz` counting as one."""
    return path.stem.removesuffix(".copc") if path.suffix.lower() == ".laz" else path.stem
