"""Files that appear whole or not at all."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from uuid import uuid4

from tiling.ledger import note_file
from tiling.output_file import check_place, sync_path

TEMPORARY = ".part"
"""Suffix of a file that is being written; one that is left over belongs to a killed process."""


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a name beside `path` for a temporary file, which takes its place when all went well.

    What was written, and closed, is flushed to the disk before. Several processes may write the
    same file at the same time: the last one to finish stays.
    """
    check_place(path)
    # Not longer than most names: there are names that leave no room for more.
    temporary = path.with_name(f".{uuid4().hex}{TEMPORARY}")
    try:
        yield temporary
        sync_path(temporary)
        note_file(path, temporary)
        temporary.replace(path)
        sync_path(path.parent)
    finally:
        temporary.unlink(missing_ok=True)
