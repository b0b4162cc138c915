"""What was written, with checksums of it, so that it can be told later whether it is still that.

`noting` lists what this thread writes by way of `tiling.output_file`: whole files as they appear,
and ranges of files that several processes fill in.
"""

import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from io import FileIO
from pathlib import Path
from typing import Any

_BLOCK = 1 << 20


@dataclass(frozen=True, slots=True)
class Written:
    """Bytes that were written."""

    path: Path
    start: int | None
    """First byte; None where they are the whole file."""
    size: int
    """How many; zero from a byte on means that the file ends there."""
    checksum: int
    """CRC-32: as fast as memory is read, and no chance change of a few bits has the same."""

    def is_intact(self) -> bool:
        """Tell whether the file is there, and holds these bytes."""
        try:
            with self.path.open("rb", buffering=0) as file:
                file.seek(self.start or 0)
                size = self.size if self.start is not None else None
                return _sum_up(file, size or None) == (self.size, self.checksum)
        except OSError:
            return False


_noted: ContextVar[list[Written] | None] = ContextVar("_noted", default=None)


@contextmanager
def noting() -> Iterator[list[Written]]:
    """List what this thread writes within the block."""
    written: list[Written] = []
    token = _noted.set(written)
    try:
        yield written
    finally:
        _noted.reset(token)


def note_file(path: Path, content: Path | None = None) -> None:
    """Note a whole file, if notes are taken; `content` is where its bytes are now."""
    noted = _noted.get()
    if noted is not None:
        with (content or path).open("rb", buffering=0) as file:
            noted.append(Written(path, None, *_sum_up(file, None)))


def note_end(path: Path) -> None:
    """Note where a file ends that is filled in by ranges, if notes are taken."""
    noted = _noted.get()
    if noted is not None:
        noted.append(Written(path, path.stat().st_size, 0, 0))


class NotedFile(FileIO):
    """A file of which each range is noted that is written, if notes are taken."""

    def write(self, data: Any) -> int:
        """Write bytes, and note where."""
        noted = _noted.get()
        if noted is None:
            return super().write(data)
        start = self.tell()
        count = super().write(data)
        if not count:
            return count
        added = memoryview(data).cast("B")[:count]
        path, last = Path(str(self.name)), noted[-1] if noted else None
        follows = last and last.start is not None and last.start + last.size == start
        if last and follows and last.path == path:
            checksum = zlib.crc32(added, last.checksum)
            noted[-1] = Written(path, last.start, last.size + count, checksum)
            return count
        noted.append(Written(path, start, count, zlib.crc32(added)))
        return count


def _sum_up(file: FileIO, size: int | None) -> tuple[int, int]:
    """Return how many bytes are left in a file, at most `size`, and their checksum."""
    block = memoryview(bytearray(_BLOCK))
    done = checksum = 0
    while size is None or done < size:
        count = file.readinto(block[: _BLOCK if size is None else min(_BLOCK, size - done)])
        if not count:
            break
        checksum = zlib.crc32(block[:count], checksum)
        done += count
    return done, checksum
