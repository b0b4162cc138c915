"""What the machine offers, and what a run took of it.

A process is in a control group of a tree, and every group above sets limits as well. A container
sees a part of such a tree, and may be told a place outside of it.
"""

import ctypes
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Literal

from pipeline.errors import ConfigurationError

_MAXRSS_UNIT = 1 if sys.platform == "darwin" else 1024
"""Bytes."""


def available_cores(wanted: int | Literal["auto"]) -> int:
    """Return the number of workers: as asked for, or one for each core this process may use.

    Raises
    ------
    ConfigurationError
        When Dask, which tells, cannot read its own settings.
    """
    if wanted != "auto":
        return wanted
    try:
        from dask.system import cpu_count  # noqa: PLC0415 (it may fail)
    except ValueError as error:
        raise ConfigurationError(f"Dask's own configuration: {error}") from error
    return int(cpu_count())


def peak_memory() -> int:
    """Return the most memory this process has held so far, in bytes.

    Linux hands `ru_maxrss` on to a program that a process starts: a small program started by a
    large one seems large. Its status file tells of this program alone.
    """
    for line in _lines(Path("/proc/self/status")):
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _MAXRSS_UNIT


def peak_of_workers() -> int:
    """Return the most memory that one process started by this one held, of those that ended."""
    return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * _MAXRSS_UNIT


def give_memory_back() -> None:
    """Give memory that is free in this process back to the system, where it can be told to.

    Otherwise it stays with the process, and what the next task needs elsewhere comes on top.
    """
    if "pyarrow" in sys.modules:
        import pyarrow as pa  # noqa: PLC0415 (only where it is in use)

        pa.default_memory_pool().release_unused()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def available_memory(root: Path = Path("/")) -> int:
    """Return the bytes that processes may still take: of the machine, or of a control group.

    `proc` and `sys` are looked for within `root`.
    """
    free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for line in _lines(root / "proc/meminfo"):
        if line.startswith("MemAvailable:"):
            free = int(line.split()[1]) * 1024
    left = memory_left(root)
    return free if left is None else min(free, left)


def memory_left(root: Path = Path("/")) -> int | None:
    """Return the bytes that the control groups of this process leave it; None without a limit."""
    left = []
    for folder, is_second in _groups(root):
        statistics = _statistics(folder / "memory.stat")
        if is_second:
            limits = [_number(folder / name) for name in ("memory.max", "memory.high")]
            used, cache, shared = _number(folder / "memory.current"), "file", "shmem"
        else:
            limits = [_number(folder / "memory.limit_in_bytes")]
            # Of all groups above, those included that a container does not see.
            limits.append(statistics.get("hierarchical_memory_limit"))
            used = _number(folder / "memory.usage_in_bytes")
            cache, shared = "total_cache", "total_shmem"
        # The page cache counts as used, and gives way, unless it is memory that is shared.
        gives_way = statistics.get(cache, 0) - statistics.get(shared, 0)
        held = max((used or 0) - max(gives_way, 0), 0)
        left += [limit - held for limit in limits if limit is not None]
    return max(min(left), 0) if left else None


def _groups(root: Path) -> Iterator[tuple[Path, bool]]:
    """Yield the groups of this process that limit memory, and all those above that it sees.

    With each comes whether its files are those of the second version. The trees are where they
    are on nearly every system.
    """
    tree = root / "sys/fs/cgroup"
    for line in _lines(root / "proc/self/cgroup"):
        _, _, told = line.partition(":")
        controllers, _, place = told.partition(":")
        is_second = not controllers
        if place and (is_second or "memory" in controllers.split(",")):
            group = Path(place.lstrip("/"))
            if ".." in group.parts:  # outside of what a container is shown
                group = Path()
            for each in (group, *group.parents):
                folder = tree / ("" if is_second else "memory") / each
                if folder.is_dir():
                    yield folder, is_second


def _statistics(path: Path) -> dict[str, int]:
    pairs = (line.partition(" ")[::2] for line in _lines(path))
    return {name: number for name, text in pairs if (number := _as_number(text)) is not None}


def _number(path: Path) -> int | None:
    return _as_number("".join(_lines(path)))


def _as_number(text: str) -> int | None:
    """Return a limit; None for `max`, -1 and what cannot be read, which are none."""
    return int(text) if text.strip().isdigit() else None


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="utf-8", errors="surrogateescape").splitlines()
    except OSError:
        return []
