"""Folders that code may be loaded from: nobody but this user can have put anything there."""

import os
import stat
import tempfile
from functools import lru_cache
from pathlib import Path
from warnings import warn

_MOST_LINKS = 40
"""Symbolic links that a name may lead through, as the system has it."""

_OTHERS_MAY_WRITE = stat.S_IWGRP | stat.S_IWOTH
_OTHERS_MAY_ENTER = stat.S_IRWXG | stat.S_IRWXO


def private_folder(name: str, configured: str = "") -> Path | None:
    """Return the first folder of a name that is this user's alone, made if it is not there.

    It is looked for in the configured folder, if there is one, the user's cache and that for
    temporary files; None where none can be written.
    """
    user = f"dynahull-{os.getuid()}"
    cache = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")  # noqa: PTH111
    parents = [Path(cache) / "dynahull", Path(tempfile.gettempdir()) / user]
    if configured:
        parents.insert(0, Path(configured) / "dynahull")
    for parent in parents:
        if not parent.is_absolute():  # in whatever folder happens to be the current one
            continue
        try:
            refused = _make_private(parent / name)
        except OSError:
            continue
        if refused is None:
            return parent / name
        if configured and parent.is_relative_to(configured):
            _tell(f"{refused}: others may put code there, or have; none is kept in {configured}")
    return None


@lru_cache
def _tell(message: str) -> None:
    """Warn, once."""
    warn(message, RuntimeWarning, stacklevel=2)


def _make_private(folder: Path) -> Path | None:
    """Make a folder that only this user can enter; return what stands against it, if anything.

    Raises
    ------
    OSError
        When it cannot be made, looked at or written.
    """
    missing = [each for each in (folder, *folder.parents) if not os.path.lexists(each)]
    above = missing[-1].parent if missing else folder.parent
    if (unsafe := _unsafe_step(above)) is not None:
        return unsafe
    for each in reversed(missing):
        each.mkdir(mode=0o700, exist_ok=True)
    if (unsafe := _unsafe_step(folder.parent)) is not None:
        return unsafe
    status = folder.lstat()
    if status.st_uid != os.getuid() or not stat.S_ISDIR(status.st_mode):
        return folder
    if status.st_mode & _OTHERS_MAY_ENTER:
        if any(folder.iterdir()):  # what is in it may be theirs
            return folder
        folder.chmod(0o700)
    with tempfile.TemporaryFile(dir=folder):
        return None


def _unsafe_step(path: Path) -> Path | None:
    """Return a step on the way of a name that others than this user and root decide, if any."""
    links = 0
    place, names = Path(path.anchor), list(reversed(path.parts[1:]))
    if not _is_safe(place.lstat()):
        return place
    while names:
        name = names.pop()
        place = place.parent if name == ".." else place / name
        status = place.lstat()
        if not _is_safe(status):
            return place
        if stat.S_ISLNK(status.st_mode):
            links += 1
            if links > _MOST_LINKS:
                return place
            target = place.readlink()
            names += reversed([part for part in target.parts if part != target.anchor])
            place = Path(target.anchor) if target.anchor else place.parent
    return None


def _is_safe(status: os.stat_result) -> bool:
    """Tell whether others can neither change what this is, nor rename what is in it."""
    if status.st_uid not in (0, os.getuid()):
        return False
    if stat.S_ISLNK(status.st_mode):
        return True
    return bool(status.st_mode & stat.S_ISVTX) or not status.st_mode & _OTHERS_MAY_WRITE
