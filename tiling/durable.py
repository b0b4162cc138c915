"""Waiting until what was written is on the disk, on file systems that can tell."""

import errno
import logging
import os
from functools import cache
from pathlib import Path

logger = logging.getLogger("dynahull")

_CANNOT = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.ENOTTY, errno.EBADF)
"""What file systems answer that cannot wait for a file, or for a folder: some of FUSE, SMB, FAT."""


def sync(handle: int) -> None:
    """Wait until an open file, or a folder's names, are on the disk.

    Where the file system cannot tell, a warning is given once and the run goes on: only a power
    cut can undo then what was written last.
    """
    try:
        os.fsync(handle)
    except OSError as error:
        if error.errno not in _CANNOT:
            raise
        _warn_once()


def sync_path(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except PermissionError:
        if path.is_dir():  # one that may be written into, and not be listed
            return
        raise
    try:
        sync(handle)
    finally:
        os.close(handle)


@cache
def _warn_once() -> None:
    logger.warning(
        "the file system cannot say when files are on its disk (fsync); what was written right "
        "before a power cut may be lost"
    )
