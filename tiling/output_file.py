"""The one place where outputs are opened to be written: new files, and only where they may lie.

A run never opens what is there already, nor writes through a link. What replaces a file is written
beside it and renamed, so that it appears whole or not at all.
"""

import errno
import logging
import os
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from functools import cache
from io import BufferedWriter
from pathlib import Path
from typing import BinaryIO, cast
from uuid import uuid4

from tiling.ledger import NotedFile, note_file

logger = logging.getLogger("dynahull")

_CANNOT = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS, errno.ENOTTY, errno.EBADF)
"""What file systems answer that cannot wait for a file, or for a folder: some of FUSE, SMB, FAT."""

_folder: ContextVar[Path | None] = ContextVar("output folder", default=None)


@contextmanager
def writing_only_into(folder: Path) -> Iterator[None]:
    """Refuse, in this block, to open a file for writing that lies outside a folder.

    Places are compared as the system resolves them, links and `..` included. What is refused is a
    `PermissionError`.
    """
    token = _folder.set(folder.resolve())
    try:
        yield
    finally:
        _folder.reset(token)


def check_place(path: Path) -> None:
    """Check that a file lies where this block may write, see `writing_only_into`."""
    folder = _folder.get()
    if folder is not None and not path.parent.resolve().is_relative_to(folder):
        raise PermissionError(errno.EPERM, f"lies outside the output folder, {folder}", str(path))


def create_file(path: Path) -> BinaryIO:
    """Open a new file to be written, and read again.

    Outside a block of `writing_only_into`, an earlier file or link of this name makes way for it;
    inside, a `FileExistsError` says that there is one.
    """
    _make_way(path)
    return path.open("x+b")


def create_shared(path: Path) -> BinaryIO:
    """Open a new file, as `create_file` does, that several processes will fill in.

    It is to write what is known of it already.
    """
    _make_way(path)
    return cast(BinaryIO, BufferedWriter(NotedFile(path, "xb")))


def _make_way(path: Path) -> None:
    check_place(path)
    if _folder.get() is None:
        path.unlink(missing_ok=True)


def write_only(path: Path) -> BinaryIO:
    """Open a file that is there to write bytes anywhere in it, beside other processes.

    Not to be read from: NFS then sends the very bytes that were written. Of a file that may be
    read as well it reads, and later writes back, whole pages, and so undoes what other machines
    wrote there.
    """
    check_place(path)
    return cast(BinaryIO, BufferedWriter(NotedFile(path, "wb", opener=_as_it_is)))


def _as_it_is(path: str, flags: int) -> int:
    return os.open(path, flags & ~(os.O_CREAT | os.O_TRUNC) | os.O_NOFOLLOW)


def make_sized(path: Path, size: int) -> None:
    """Make a file of some size, or give an earlier one that size; what is missing is zero."""
    check_place(path)
    handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW, 0o666)
    with os.fdopen(handle, "ab") as file:
        file.truncate(size)


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


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a name beside `path` for a temporary file, which takes its place when all went well.

    What was written, and closed, is flushed to the disk before. Several processes may write the
    same file at the same time: the last one to finish stays.
    """
    check_place(path)
    # Not longer than most names: there are names that leave no room for more. One that is left over
    # belongs to a killed process.
    temporary = path.with_name(f".{uuid4().hex}.part")
    try:
        yield temporary
        sync_path(temporary)
        note_file(path, temporary)
        temporary.replace(path)
        sync_path(path.parent)
    finally:
        temporary.unlink(missing_ok=True)
