"""One night at a time on an output folder."""

import fcntl
import os
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

from pipeline.errors import NightLockedError
from pipeline.folder_lock import NO_LOCK, warn_of_no_locks

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
