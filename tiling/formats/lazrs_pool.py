"""What bounds the threads of lazrs, and the memory that they need.

lazrs hands chunks to a pool of threads that the whole process shares, which is as large as the
machine, whatever else runs on it. Each chunk of one call goes to one thread: so that no more are
busy than a caller may use, it never hands over more chunks at once.
"""

import os
from functools import cache

LARGEST_PARALLEL_CHUNK = 1 << 26
"""Bytes of points in a chunk; longer ones are not held in memory, one for each thread."""


def usable_threads(threads: int) -> int:
    """Return how many threads lazrs can be given: those wanted, or 1.

    A process forked from one that has used the pool has no threads in its copy of it, and would
    wait for them for ever.
    """
    return threads if threads > 1 and _owner_of_pool() == os.getpid() else 1


@cache
def _owner_of_pool() -> int:
    """Return the process that first used the pool; what is remembered outlives a fork."""
    return os.getpid()
