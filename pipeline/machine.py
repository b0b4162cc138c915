"""What the machine offers, and what a run took of it."""

import ctypes
import os
import resource
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Literal


def available_cores(wanted: int | Literal["auto"]) -> int:
    """Return the number of workers: as asked for, or one for each core this process may use."""
    return len(os.sched_getaffinity(0)) if wanted == "auto" else wanted


def peak_memory() -> int:
    """Return the most memory this process has held so far, in bytes.

    Linux hands `ru_maxrss` on to a program that a process starts: a small program started by a
    large one seems large. Its status file tells of this program alone.
    """
    for line in _lines(Path("/proc/self/status")):
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) * 1024
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def give_memory_back() -> None:
    """Give memory that is free in this process back to the system, where it can be told to.

    Otherwise it stays with the process, and what the next task needs elsewhere comes on top.
    """
    if "pyarrow" in sys.modules:
        import pyarrow as pa  # noqa: PLC0415 (only where it is in use)

        pa.default_memory_pool().release_unused()
    with suppress(OSError, AttributeError):
        ctypes.CDLL(None).malloc_trim(0)


def available_memory() -> int:
    """Return the bytes that processes may still take: of the machine, or of the control group."""
    free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for line in _lines(Path("/proc/meminfo")):
        if line.startswith("MemAvailable:"):
            free = int(line.split()[1]) * 1024
    for limit, used, cache in _control_group():
        # The page cache counts as used there, and gives way.
        free = min(free, limit - max(used - cache, 0))
    return max(free, 0)


def _control_group() -> Iterator[tuple[int, int, int]]:
    """Yield limit, use, and page cache of the control group of this process, if it has a limit."""
    for line in _lines(Path("/proc/self/cgroup")):
        _, controllers, place = line.split(":", 2)
        if controllers == "":
            root, names = Path("/sys/fs/cgroup"), ("memory.max", "memory.current", "file")
        elif "memory" in controllers.split(","):
            root = Path("/sys/fs/cgroup/memory")
            names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_cache")
        else:
            continue
        folder = root / place.lstrip("/")
        limit, used = (_lines(folder / name) for name in names[:2])
        statistics = dict(each.split() for each in _lines(folder / "memory.stat"))
        if limit and used and limit[0].isdigit():
            yield int(limit[0]), int(used[0]), int(statistics.get(names[2], 0))


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii").splitlines()
    except OSError:
        return []
