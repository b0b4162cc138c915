"""One run at a time in a folder, by a lock that the system frees however the process ends.

The folder itself is locked where that can be done. On NFS it cannot, and a file in it is locked,
which keeps out runs on other machines as well; it is there only while the lock is held.
"""

import errno
import fcntl
import logging
import os
import socket
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import cache
from pathlib import Path

from pipeline.errors import NightLockedError

LOCK_FILE = ".dynahull-lock"

logger = logging.getLogger("dynahull")

NO_LOCK = (errno.EBADF, errno.EINVAL, errno.EISDIR, errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP)
"""What file systems answer that have no locks on folders, or none at all."""


def take_lock(folder: Path) -> int | None:
    """Take the lock of a folder, None if another run holds it.

    Returns
    -------
    int or None
        What `give_lock` gives back.
    """
    handle = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        if isinstance(error, BlockingIOError):
            return None
        if error.errno not in NO_LOCK:
            raise
        return _take_lock_of_file(folder)
    return handle


def give_lock(folder: Path, handle: int) -> None:
    """Give a lock back."""
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
            if error.errno not in NO_LOCK:
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


LOCK_FILE = "lock"


@contextmanager
def night_lock(folder: Path) -> Iterator[None]:
    """Hold the lock, which the system frees however the process ends.

    The lock is the kernel's and not the file: a file that a dead process left locks nothing, and
    what is written in it, for people, decides nothing, so that a number of a process that was
    given out again does no harm. The file stays, since removing it would let two hold it.

    Parameters
    ----------
    folder : Path
        Where the lock file lies.

    Raises
    ------
    NightLockedError
        When another process holds it.
    """
    path = folder / LOCK_FILE
    handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            holder = os.pread(handle, 200, 0).decode(errors="replace").strip() or "another process"
            raise NightLockedError(f"{path}: another night holds the lock ({holder})") from None
        except OSError as error:
            if error.errno not in NO_LOCK:
                raise
            warn_of_no_locks(folder)
        begun = datetime.now(UTC).isoformat(timespec="seconds")
        os.ftruncate(handle, 0)
        os.pwrite(
            handle, f"process {os.getpid()} on {socket.gethostname()} since {begun}\n".encode(), 0
        )
        yield
    finally:
        os.close(handle)
