"""Whether a map is still the one that a run began with.

Its bytes are hashed once; after that, size, times and inode tell whether a file was touched. Size
and time of the last change can be put back by whoever rewrites a file; the time at which the inode
changed cannot. It moves when a file is linked or its permissions change, too: that is taken for a
change as well, and costs work, never a wrong result.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from os import stat_result
from pathlib import Path

from pipeline.errors import InputChangedError
from tiling.errors import MapFormatError

FileState = tuple[int, int, int, int]
"""Bytes, nanoseconds of the last change of content and of inode, inode."""

MapState = tuple[FileState, ...]
"""Of each file."""


def map_state(paths: Sequence[Path]) -> MapState:
    """Return the state of a map's files.

    Raises
    ------
    MapFormatError
        When one is not there any more, or cannot be looked at.
    """
    states = []
    for path in paths:
        try:
            status = path.stat()
        except OSError as error:
            raise _unreadable(path, error) from error
        states.append(_state_of(status))
    return tuple(states)


def check_map(paths: Sequence[Path], state: MapState) -> None:
    """Check that a map's files are as they were.

    Raises
    ------
    InputChangedError
        When they are not.
    MapFormatError
        When one is not there any more.
    """
    for path, now, before in zip(paths, map_state(paths), state, strict=True):
        if now != before:
            raise InputChangedError(f"{path}: the map changed while it was being cleaned")


def _state_of(status: stat_result) -> FileState:
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino


@contextmanager
def unchanged(paths: Sequence[Path]) -> Iterator[MapState]:
    """Hold a map to the state it has now; blame it for what goes wrong when it changed.

    Raises
    ------
    InputChangedError
        When a file is another one in the end, or when something goes wrong meanwhile.
    MapFormatError
        When a file is gone, or cannot be read any more.
    """
    state = map_state(paths)
    try:
        yield state
    except Exception as error:
        check_map(paths, state)
        if isinstance(error, OSError) and error.filename is not None:
            for path in paths:
                if Path(error.filename).absolute() == path.absolute():
                    raise _unreadable(path, error) from error
        raise
    check_map(paths, state)


def _unreadable(path: Path, error: OSError) -> MapFormatError:
    reason = error.strerror or type(error).__name__
    return MapFormatError(path, "a map that can be read", reason[:1].lower() + reason[1:])
