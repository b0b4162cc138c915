"""Temporary files of a process in one folder of its own, which never outlives the next run.

Only its user can look into the folder. The process holds a lock on it that the system frees however
it ends: what a killed one left is known by that, and removed by whoever comes next.
"""

import fcntl
import os
import shutil
import tempfile
from contextlib import suppress
from functools import lru_cache
from multiprocessing.util import Finalize
from pathlib import Path

_LONGEST = 107 - len("/pymp-12345678/listener-12345678")
"""Bytes of a folder in which an address of multiprocessing is not too long for the system."""

_SHORTER = Path("/tmp")


def temporary_folder() -> Path:
    """Return the folder for this process's temporary files, which goes when the process ends."""
    return _folder_of(os.getpid(), Path(tempfile.gettempdir()))


def socket_folder() -> Path:
    """Return that folder, or one like it with a shorter name, where sockets need one."""
    folder = temporary_folder()
    if len(os.fsencode(folder)) > _LONGEST:
        with suppress(OSError):
            return _folder_of(os.getpid(), _SHORTER)
    return folder


@lru_cache(maxsize=2)
def _folder_of(process: int, place: Path) -> Path:
    del process  # one that is forked has its own
    remove_leftovers(place)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_prefix(), dir=place))
        try:
            handle = os.open(folder, os.O_RDONLY)
        except FileNotFoundError:  # taken for a leftover before it was locked
            continue
        with suppress(OSError):  # a file system without locks: nobody will take it for a leftover
            fcntl.flock(handle, fcntl.LOCK_EX)
        if os.fstat(handle).st_nlink and folder.is_dir():
            break
        os.close(handle)
    # After multiprocessing has removed what it has in there, for which it has -100.
    Finalize(None, shutil.rmtree, (folder, True), exitpriority=-200)
    return folder


def remove_leftovers(place: Path) -> None:
    """Remove what killed processes of this user left in a folder for temporary files."""
    with suppress(OSError), os.scandir(place) as entries:
        names = [entry.name for entry in entries if entry.name.startswith(_prefix())]
        for name in names:
            _remove_if_left(place / name)


def _remove_if_left(folder: Path) -> None:
    """Remove a folder that is this user's, and whose process has ended."""
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except OSError:
        return
    try:
        if os.fstat(handle).st_uid != os.getuid():
            return
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        shutil.rmtree(folder, ignore_errors=True)
    except OSError:  # its process is at work, or nothing can be known of it
        return
    finally:
        os.close(handle)


def _prefix() -> str:
    return f"dynahull-{os.getuid()}-"
