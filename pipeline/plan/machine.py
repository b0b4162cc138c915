"""What the machine offers, and what a run took of it."""

import ctypes
import os
import resource
import sys
from contextlib import suppress
from pathlib import Path
from typing import Literal

from pipeline.control_groups import memory_left, processors


def available_cores(wanted: int | Literal["auto"], root: Path = Path("/")) -> int:
    """Return the number of workers: as asked for, or one for each core this process may use.

    A core counts as far as the quota of a control group goes.

    Parameters
    ----------
    wanted : int or "auto"
    root : Path
        Of the file system in which `proc` and `sys` are looked for.
    """
    if wanted != "auto":
        return wanted
    cores = len(os.sched_getaffinity(0))
    quota = processors(root)
    return cores if quota is None else min(cores, quota)


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


def available_memory(root: Path = Path("/")) -> int:
    """Return the bytes that processes may still take: of the machine, or of a control group.

    Parameters
    ----------
    root : Path
        Of the file system in which `proc` and `sys` are looked for.
    """
    free = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for line in _lines(root / "proc/meminfo"):
        if line.startswith("MemAvailable:"):
            free = int(line.split()[1]) * 1024
    left = memory_left(root)
    return free if left is None else min(free, left)


def _lines(path: Path) -> list[str]:
    try:
        return path.read_text(encoding="ascii").splitlines()
    except OSError:
        return []
