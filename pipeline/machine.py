"""What the machine offers, and what a run took of it."""

import os
import resource
import sys
from pathlib import Path
from typing import Literal


def available_cores(wanted: int | Literal["auto"]) -> int:
    """Return the number of workers: as asked for, or one for each core this process may use."""
    return len(os.sched_getaffinity(0)) if wanted == "auto" else wanted


def peak_memory() -> int:
    """Return the most memory this process has held so far, in bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024


def available_memory() -> int:
    """Return the bytes that processes may still take: of the machine, or of the control group."""
    free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for line in _lines(Path("/proc/meminfo")):
        if line.startswith("MemAvailable:"):
            free = int(line.split()[1]) * 1024
    limit, used = (
        _lines(Path("/sys/fs/cgroup") / name) for name in ("memory.max", "memory.current")
    )
    if limit and used and limit[0].isdigit():
        # The page cache counts as used there, and gives way.
        cache = [line for line in _lines(Path("/sys/fs/cgroup/memory.stat")) if "file " in line]
        held = int(used[0]) - (int(cache[0].split()[1]) if cache else 0)
        free = min(free, int(limit[0]) - held)
    return max(free, 0)


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii").splitlines()
    except OSError:
        return []
