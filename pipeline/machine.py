"""What the machine offers, and what a run took of it."""

import os
import resource
import sys
from typing import Literal


def available_cores(wanted: int | Literal["auto"]) -> int:
    """Return the number of workers: as asked for, or one for each core this process may use."""
    return len(os.sched_getaffinity(0)) if wanted == "auto" else wanted


def peak_memory() -> int:
    """Return the most memory this process has held so far, in bytes."""
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak if sys.platform == "darwin" else peak * 1024
