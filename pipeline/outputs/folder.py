"""The output folder of a run: all of it appears at once, or none of it does.

Files are written into a hidden folder beside their places, flushed to the disk, and renamed when
all are complete. `run.json` goes first and comes back last: a folder that has one is whole.
"""

import os
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from pipeline.configuration.run import OutputParameters
from pipeline.errors import OutputError
from pipeline.outputs.folder_lock import locked_folder
from pipeline.replacing import (
    CONFIGURATION_FILE,
    LABELS_FILE,
    REPORT_FILE,
    RUN_FILE,
    STAGING,
    earlier_results,
    record_publishing,
    refuse_to_replace,
    remove_half_published,
)
from tiling.collection import is_partition
from tiling.formats import MAP_SUFFIXES, MapReader
from tiling.output_file import create_file, sync_path, writing_only_into

_ASIDE = "earlier"
"""Within it: results of an earlier run, until all of this one's are in their place."""


@dataclass(frozen=True, slots=True)
class OutputNames:
    """Names of the results, relative to the output folder; one of each for every input file."""

    static: tuple[Path, ...] = ()
    dynamic: tuple[Path, ...] = ()
    """In the order of the input files; none where the outputs are labelled."""
    labelled: tuple[Path, ...] = ()
    """In the order of the input files; none where the outputs are not labelled."""
    thinned: tuple[Path, ...] = ()
    """In the order of the input files; none where nobody asked for them."""

    @classmethod
    def of(
        cls,
        readers: Sequence[MapReader],
        mode: Literal["split", "label"] = "split",
        *,
        thinned: bool = False,
    ) -> "OutputNames":
        """Choose names: `static.<ext>` for one file, `static/<its own name>` for several."""
        kinds: tuple[str, ...] = ("static", "dynamic") if mode == "split" else ("labelled",)
        kinds += ("thinned",) if thinned else ()
        if len(readers) == 1:
            suffix = readers[0].description.suffix
            return cls(**{kind: (Path(f"{kind}{suffix}"),) for kind in kinds})
        paths = [reader.description.path for reader in readers]
        suffixes = [reader.description.suffix for reader in readers]
        names = _distinct_names(paths, suffixes)
        return cls(**{kind: tuple(Path(kind) / name for name in names) for kind in kinds})

    @classmethod
    def of_run(cls, readers: Sequence[MapReader], output: OutputParameters) -> "OutputNames":
        """Choose the names that a run asks for."""
        files = readers[:1] if output.merge else readers
        return cls.of(files, output.mode, thinned=output.voxel is not None)

    @property
    def by_kind(self) -> dict[str, tuple[Path, ...]]:
        """The names of the kinds of outputs that there are."""
        kinds = {"static": self.static, "dynamic": self.dynamic, "labelled": self.labelled}
        return {kind: names for kind, names in kinds.items() if names}

    @property
    def by_file(self) -> tuple[tuple[Path, ...], ...]:
        """The outputs of each input file."""
        return tuple(zip(*self.by_kind.values(), strict=True))

    def all_files(self, output: OutputParameters) -> tuple[Path, ...]:
        """Return every file of the run, `run.json` last."""
        more = [Path(LABELS_FILE)] if output.labels else []
        more += [Path(REPORT_FILE)] if output.report == "html" else []
        maps = [name for names in self.by_kind.values() for name in names]
        return (*maps, *self.thinned, *more, Path(CONFIGURATION_FILE), Path(RUN_FILE))


def default_folder(paths: Sequence[Path]) -> Path:
    """Return `<map>_dynahull`, named after the only file, or after the folder of several."""
    first, *others = [located(path) for path in paths]
    if not others:
        return Path(f"{_stem(first)}_dynahull")
    together = Path(os.path.commonpath([each.parent for each in (first, *others)]))
    while is_partition(together):
        together = together.parent
    together = together if together.name else first.parent
    is_table = together.suffix.lower() in MAP_SUFFIXES
    return Path(f"{_stem(together) if is_table else together.name}_dynahull")


@contextmanager
def output_folder(
    folder: Path, results: Sequence[Path], inputs: Sequence[Path] = ()
) -> Iterator[Path]:
    """Claim an output folder, and publish what was written when the block ends without an error.

    Parameters
    ----------
    folder : Path
        Made if it is not there; results of an earlier run in it are replaced.
    results : sequence of Path
        The files that will be written, by their names in the folder.
    inputs : sequence of Path
        The map files, none of which is ever replaced.

    Yields
    ------
    Path
        An empty folder to write into, by the names the files will have in `folder`.

    Raises
    ------
    OutputError
        When the folder cannot be made or written, when another run works in it, or when a file is
        in the place of a result that no earlier run wrote.
    """
    refuse_to_replace(folder, results, inputs)
    missing = [path for path in (folder, *folder.parents) if not path.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with locked_folder(folder), writing_only_into(folder):
            remove_half_published(folder)
            staging = folder / STAGING
            shutil.rmtree(staging, ignore_errors=True)
            staging.mkdir()
            try:
                _try_names(staging, results)
                yield staging
                refuse_to_replace(folder, results, inputs)
                _publish(staging, folder)
            finally:
                shutil.rmtree(staging, ignore_errors=True)
    except OSError as error:
        raise OutputError(f"{error.filename or folder}: {error.strerror or error}") from error
    finally:
        for path in missing:
            if path.is_dir() and not any(path.iterdir()):
                path.rmdir()


def _try_names(staging: Path, results: Sequence[Path]) -> None:
    """Find out, before any work, whether the file system has a place for each name.

    There are some that take two names for one, and some that do not take every name.
    """
    trial = staging / "names"
    trial.mkdir()
    for name in results:
        place = trial / name
        place.parent.mkdir(parents=True, exist_ok=True)
        try:
            create_file(place).close()
        except FileExistsError:
            raise OutputError(
                f"{staging.parent / name}: two files of the map would be written here; choose "
                "an -o on another file system"
            ) from None
        except OSError as error:
            reason = error.strerror or error
            raise OutputError(f"{staging.parent / name}: cannot be written: {reason}") from None
    shutil.rmtree(trial)


def _publish(staging: Path, folder: Path) -> None:
    """Rename all files into place, `run.json` last; none, where one cannot be renamed."""
    files = [path.relative_to(staging) for path in sorted(staging.rglob("*")) if path.is_file()]
    files.sort(key=lambda name: name == Path(RUN_FILE))
    for name in files:
        sync_path(staging / name)
    sync_path(record_publishing(staging, folder, files))
    sync_path(staging)
    earlier = [name for name in earlier_results(folder) if _is_within(folder, name)]
    earlier.sort(key=lambda name: name != Path(RUN_FILE))
    with _renaming_all() as rename:
        for name in earlier:
            rename(folder / name, staging / _ASIDE / name)
        (folder / RUN_FILE).unlink(missing_ok=True)
        sync_path(folder)
        for name in files:
            rename(staging / name, folder / name)
        for parent in {(folder / name).parent for name in files}:
            sync_path(parent)
    left = {parent for name in earlier for parent in name.parents} - {Path()}
    for parent in sorted(left, key=lambda each: len(each.parts), reverse=True):
        if not any((folder / parent).iterdir()):
            (folder / parent).rmdir()


@contextmanager
def _renaming_all() -> Iterator[Callable[[Path, Path], None]]:
    """Give what renames a file; where anything fails in the block, the last is taken back first."""
    done: list[tuple[Path, Path]] = []

    def rename(old: Path, new: Path) -> None:
        new.parent.mkdir(parents=True, exist_ok=True)
        old.replace(new)
        done.append((old, new))

    try:
        yield rename
    except BaseException:
        for old, new in reversed(done):
            with suppress(OSError):
                new.replace(old)
        raise


def _is_within(folder: Path, name: Path) -> bool:
    """Tell whether a result is there, and in no folder that a link leads to."""
    place = folder / name
    return place.is_file() and place.parent.resolve().is_relative_to(folder.resolve())


def located(path: Path) -> Path:
    """Return a file's own name in the folder that it lies in, without links and `..`."""
    return path.parent.resolve() / path.name


def in_partitions(path: Path) -> Path:
    """Return a file's name with the partitions (`key=value`) of a table that it lies in."""
    name = Path(path.name)
    for folder in path.parents:
        if not is_partition(folder):
            break
        name = folder.name / name
    return name


def _distinct_names(paths: Sequence[Path], suffixes: Sequence[str]) -> list[Path]:
    """Return names for files written like some others: their own, as far as they differ.

    Partitions stay before them, and where names are equal, the files' folders; where only the
    suffix of the output makes them so (`a.copc.laz` and `a.laz`), all keep their whole names.
    """
    absolute = [located(path) for path in paths]
    own = [in_partitions(path) for path in absolute]
    if len(set(own)) < len(own):
        common = Path(os.path.commonpath([path.parent for path in absolute]))
        own = [path.relative_to(common) for path in absolute]
    names = [
        name.with_name(_stem(name) + suffix) for name, suffix in zip(own, suffixes, strict=True)
    ]
    if len(set(names)) == len(names):
        return names
    return [
        name if name.suffix.lower() == suffix else name.with_name(name.name + suffix)
        for name, suffix in zip(own, suffixes, strict=True)
    ]


def _stem(path: Path) -> str:
    """Return the name without its suffix, `.copc.laz` and `.pcd.bin` counting as one."""
    inner = {".laz": ".copc", ".bin": ".pcd"}.get(path.suffix.lower(), path.suffix)
    return path.stem.removesuffix(inner)
