"""One run or night at a time in a folder: a lock that the system frees however a process ends.

The folder itself is locked where that can be done. On NFS it cannot, and a file in it is locked,
which keeps out runs on other machines as well; it is there only while the lock is held.
"""

import errno
import fcntl
import logging
import os
import stat
import time
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path

from pipeline.errors import OutputError, PipelineError

LOCK_FILE = ".dynahull-lock"

logger = logging.getLogger("dynahull")

_NO_LOCK = (errno.EBADF, errno.EINVAL, errno.EISDIR, errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP)
"""What file systems answer that have no locks on folders, or none at all."""


def folder_is_locked(folder: Path) -> bool:
    """Tell whether a run is writing into a folder, on this machine or, over NFS, on any."""
    handle = _take_lock(folder)
    if handle is None:
        return True
    _give_lock(folder, handle)
    return False


@contextmanager
def locked_folder(
    folder: Path, who: str = "run", error: type[PipelineError] = OutputError
) -> Iterator[None]:
    """Hold the folder's lock; `who` says what holds it. Another one that does is an error."""
    handle = _take_lock(folder)
    # Whoever asks whether the folder is locked holds the lock for a moment.
    for _ in range(2):
        if handle is None:
            time.sleep(0.1)
            handle = _take_lock(folder)
    if handle is None:
        raise error(f"{folder}: another {who} is writing into this folder")
    try:
        yield
    finally:
        _give_lock(folder, handle)


def _take_lock(folder: Path) -> int | None:
    """Take the lock of a folder, None if another run holds it; `_give_lock` gives it back."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        if isinstance(error, BlockingIOError):
            return None
        if error.errno not in _NO_LOCK:
            raise
        return _take_lock_of_file(folder)
    return handle


def _give_lock(folder: Path, handle: int) -> None:
    if not stat.S_ISDIR(os.fstat(handle).st_mode):
        (folder / LOCK_FILE).unlink(missing_ok=True)
    os.close(handle)


@cache
def warn_of_no_locks(folder: Path) -> None:
    """Warn, once, that nothing keeps two runs apart in a folder."""
    logger.warning("%s: its file system has no locks; take care that one run works in it", folder)


def _take_lock_of_file(folder: Path) -> int | None:
    path = folder / LOCK_FILE
    while True:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            if isinstance(error, BlockingIOError):
                os.close(handle)
                return None
            if error.errno not in _NO_LOCK:
                os.close(handle)
                raise
            warn_of_no_locks(folder)
            return handle
        # Who held it before may have removed the file after it was opened here.
        try:
            if os.path.samestat(os.fstat(handle), path.stat()):
                return handle
        except FileNotFoundError:
            pass
        os.close(handle)
