"""What maps there are, whether they are what they were, and which are to be cleaned, in which turn.

A map is not read to find out that it is as it was: sizes, times and inode numbers of its files are
compared with those when it was hashed. Only the time of the last change of the inode cannot be set
by programs, so that a file replaced by one of the same size and date is seen as well.
"""

import glob
import hashlib
import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from pipeline.configuration.run import Configuration
from pipeline.nightly.journal import Fingerprint, MapRecord
from pipeline.nightly.minutes import MapOutcome
from pipeline.nightly.results import MapFolder, result_key, tasks_done
from pipeline.nightly.settings import NightlyInput, NightlySettings
from pipeline.showing import is_text
from tiling.collection import content_hash, find_map_files
from tiling.errors import NoMapError, SeveralMapsError, TilingError
from tiling.key_frames import pose_files

_COARSEST_TIME = 2.0
"""Seconds between two changes of a file that its dates tell apart on any file system (FAT)."""

_DAY = 86400.0


@dataclass(frozen=True, slots=True)
class FoundMap:
    """A map that is there."""

    path: Path
    """The file, or the folder; absolute."""
    files: tuple[Path, ...]
    """What the map consists of, in the order in which a run reads them."""
    configuration: Configuration
    """How it is cleaned."""
    root: Path
    """The folder of the input, out of which no link is followed."""
    poses: tuple[Path, ...] = ()
    """What the poses of its files are read from, where they are scans."""

    def states(self) -> Fingerprint:
        """Return the states of all files it is read from; one that is gone is an `OSError`."""
        every = ((path.name, path.stat()) for path in (*self.files, *self.poses))
        return tuple(
            (name, state.st_size, state.st_mtime_ns, state.st_ctime_ns, state.st_ino)
            for name, state in every
        )


class Problem(NamedTuple):
    """What should be there and could not be looked at, and why, in one line."""

    root: Path
    message: str


def find_maps(
    settings: NightlySettings, configurations: Sequence[Configuration]
) -> tuple[list[FoundMap], list[Problem]]:
    """Find all maps of all inputs, each of which has one configuration, by name within an input.

    What lies in the output folder is none, nor is one whose files all belong to maps found before.
    """
    maps: list[FoundMap] = []
    problems = []
    taken: set[Path] = set()
    output = settings.output.resolve()
    for given, configuration in zip(settings.inputs, configurations, strict=True):
        for each in _look_into(given):
            if isinstance(each, Problem):
                problems.append(each)
                continue
            path, files = each
            own = {file.resolve() for file in files}
            if own <= taken or path.resolve().is_relative_to(output):
                continue
            if not is_text(path):
                problems.append(Problem(given.root, f"{path}: its name is not UTF-8"))
                continue
            if not lie_within(given.root, files):
                message = f"{path}: a link out of {given.root}, which is not followed"
                problems.append(Problem(given.root, message))
                continue
            told = configuration.input.poses
            poses = pose_files(files, None if told is None else Path(told))
            maps.append(FoundMap(path, files, configuration, given.root, poses))
            taken |= own
    return maps, problems


def _look_into(given: NightlyInput) -> Iterator[tuple[Path, tuple[Path, ...]] | Problem]:
    """Yield the maps of an input with their files, and what of it could not be looked at."""
    try:
        given.root.stat()
        yield from _closed_folders(given.maps)
        if given.each == "file":
            for path in _map_files(given.maps, as_one=False):
                yield path, (path,)
            return
        folders = _folders(given.maps)
    except OSError as error:
        yield _problem(error, given.root)
        return
    for folder in folders:
        try:
            files = _map_files(str(folder), as_one=True)
        except OSError as error:
            yield _problem(error, folder)
            continue
        except TilingError as error:
            yield Problem(folder, str(error))
            continue
        if files:
            yield folder, files


def _problem(error: OSError, place: Path) -> Problem:
    if isinstance(error, FileNotFoundError):
        return Problem(place, f"{place}: no such file or folder")
    return Problem(place, f"{error.filename or place}: {error.strerror or error}")


def _closed_folders(pattern: str) -> Iterator[Problem]:
    """Yield the folders that a pattern leads into and that cannot be read.

    What they hold would else count as gone: to a pattern such folders are empty.
    """
    if Path(pattern).exists():
        return
    parents = list(Path(pattern).parents)
    wild = sum(glob.has_magic(str(each)) for each in parents)
    # And the longest one without a wildcard. A slash at the end means folders only.
    for start in parents[: wild + 1]:
        for folder in map(Path, glob.glob(f"{start}/", recursive=True)):  # noqa: PTH207
            try:
                with os.scandir(folder):
                    os.stat(f"{folder}/.")  # noqa: PTH116 (a Path drops the dot)
            except OSError as error:
                yield _problem(error, folder)


def _folders(maps: str) -> list[Path]:
    place = Path(maps)
    # Path.glob takes no absolute patterns.
    found = list(place.iterdir()) if place.exists() else map(Path, glob.glob(maps, recursive=True))  # noqa: PTH207
    return sorted(each for each in found if each.is_dir() and not each.name.startswith("."))


def _map_files(maps: str, as_one: bool) -> tuple[Path, ...]:
    try:
        return find_map_files([maps], as_one)
    except SeveralMapsError:
        raise
    except NoMapError as error:
        if isinstance(error.__cause__, OSError):
            raise error.__cause__ from None
        return ()


def lie_within(root: Path, files: Iterable[Path]) -> bool:
    """Tell whether files lie in the folder of an input, wherever it is, and are not linked into it.

    Who may put a link there may not be one who may read what it leads to.
    """
    root = root.resolve()
    return all(file.resolve().is_relative_to(root) for file in files)


def last_change(states: Fingerprint, now: float) -> float:
    """Return when a map was last written to, seconds since 1970.

    Of its files the last one; of a file the later of its two dates, since a copy that keeps dates
    sets the first one back. A date more than a day ahead, by a clock that was wrong, is none; a
    file without any other is old.
    """
    dates = [(state[2] / 1e9, state[3] / 1e9) for state in states]
    return max(max((d for d in of_file if d <= now + _DAY), default=0.0) for of_file in dates)


@dataclass(slots=True)
class Candidate:
    """A map that is there, and what is known of it."""

    found: FoundMap
    states: Fingerprint
    """Its files, when it was looked at."""
    record: MapRecord
    folder: MapFolder
    content: str | None = field(init=False)
    """SHA-256 of its bytes, None where they must be read to know it."""

    def __post_init__(self) -> None:
        """Trust the record where the files are what they were."""
        record = self.record
        self.content = record.content if record.fingerprint == self.states else None

    def is_as_seen(self) -> bool:
        """Tell whether its files still are what they were when it was looked at."""
        try:
            return self.found.states() == self.states
        except OSError:
            return False

    @property
    def key(self) -> str:
        """What a result, or a failure, is of: content and configuration, or files not read yet."""
        if self.content is None:
            return "unread-" + hashlib.sha256(repr(self.states).encode()).hexdigest()[:16]
        found, poses = self.found, self.record.poses
        return result_key(self.content, found.files, found.configuration, poses)


def learn_content(
    candidate: Candidate, now: Callable[[], float], advance: Callable[[int], None]
) -> bool:
    """Hash a map and remember its content; return whether it did not change meanwhile.

    A file that cannot be read, or is gone, is an `OSError`. `advance` is told of the bytes hashed;
    what it raises ends the hashing.
    """
    found, record = candidate.found, candidate.record
    begun, before = now(), found.states()
    content = content_hash(found.files, advance)
    poses = content_hash(found.poses, advance) if found.poses else ""
    if found.states() != before:
        return False
    candidate.content = record.content = content
    record.poses = poses
    # A change right after this one might leave the same dates: look again the next time.
    recent = begun - last_change(before, begun) < _COARSEST_TIME
    record.fingerprint = () if recent else before
    return True


def verdict(candidate: Candidate, settings: NightlySettings, now: float) -> MapOutcome | None:
    """Return why a map is not to be cleaned now, None if it is."""
    if now - last_change(candidate.states, now) < settings.settle:
        return MapOutcome.WAITING
    if candidate.folder.result(candidate.key) is not None:
        return MapOutcome.UNCHANGED
    if failures(candidate) >= settings.attempts:
        return MapOutcome.SET_ASIDE
    return None


def failures(candidate: Candidate) -> int:
    """Count the nights that a map failed as it is, by this version of the product."""
    failure, now = candidate.record.failure, (candidate.key, version("dynahull-pipeline"))
    return failure.attempts if failure and (failure.key, failure.version) == now else 0


def in_turn(candidates: Iterable[Candidate]) -> list[Candidate]:
    """Put maps in the order in which they are cleaned.

    First what was stopped half done, then what was never tried, the longest known first, and last
    what failed or came no step further: so that nothing keeps the others from being done.
    """

    def turn(candidate: Candidate) -> tuple[int, int, float, str]:
        record, failed = candidate.record, failures(candidate)
        begun = candidate.folder.of_key(candidate.key)
        goes_on = begun is not None and tasks_done(begun) > 0
        rank = 2 if failed or record.stalled else 0 if goes_on else 1
        return rank, failed, record.first_seen, str(candidate.found.path)

    return sorted(candidates, key=turn)
