"""Files that appear whole or not at all, and files that several processes fill in."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedWriter
from pathlib import Path
from typing import BinaryIO, cast
from uuid import uuid4

from tiling.ledger import NotedFile, note_file

TEMPORARY = ".part"
"""Suffix of a file that is being written; one that is left over belongs to a killed process."""


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give the name of a temporary file, which takes the name `path` when all went well.

    What was written is flushed to the disk before. Several processes may write the same file at
    the same time: the last one to finish stays.

    Parameters
    ----------
    path : Path
        In a folder that exists. An earlier file of this name is replaced.

    Yields
    ------
    Path
        A name beside it, for a file that the caller writes and closes.
    """
    temporary = path.with_name(f".{path.name}.{uuid4().hex[:12]}{TEMPORARY}")
    try:
        yield temporary
        _flush(temporary)
        note_file(path, temporary)
        temporary.replace(path)
        _flush(path.parent)
    finally:
        temporary.unlink(missing_ok=True)


def _flush(path: Path) -> None:
    """Wait until a file, or the names in a folder, are on the disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_only(path: Path) -> BinaryIO:
    """Open a file that is there to write bytes anywhere in it, beside other processes.

    Not to be read from: NFS then sends the very bytes that were written. Of a file that may be
    read as well it reads, and later writes back, whole pages, and so undoes what other machines
    wrote there.
    """
    return cast(BinaryIO, BufferedWriter(NotedFile(path, "wb", opener=_as_it_is)))


def _as_it_is(path: str, flags: int) -> int:
    return os.open(path, flags & ~(os.O_CREAT | os.O_TRUNC))


def new_file(path: Path) -> BinaryIO:
    """Make an empty file to write to, in the place of an earlier one."""
    return cast(BinaryIO, BufferedWriter(NotedFile(path, "wb")))


def make_sized(path: Path, size: int) -> None:
    """Make a file of some size, or give an earlier one that size; what is missing is zero."""
    with path.open("ab") as file:
        file.truncate(size)
