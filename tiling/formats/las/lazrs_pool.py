"""What bounds the threads of lazrs, and the memory that they need.

lazrs hands chunks to a pool of threads that the whole process shares, which is as large as the
machine, whatever else runs on it. Each chunk of one call goes to one thread: so that no more are
busy than a caller may use, it never hands over more chunks at once, unless it may use all.
"""

import os
from functools import cache

LARGEST_PARALLEL_CHUNK = 1 << 26
"""Bytes of points in a chunk; longer ones are not held in memory, one for each thread."""


_CHUNKS_A_THREAD = 8
"""Where a caller may use the whole pool: some chunks take longer than others, and the threads wait
for each other at the end of a call only."""


def chunks_at_a_time(threads: int, chunk_bytes: int) -> int:
    """Return how many chunks of that many bytes of points lazrs is given in one call."""
    if threads < (os.cpu_count() or 1):
        return threads
    return max(threads, min(_CHUNKS_A_THREAD * threads, LARGEST_PARALLEL_CHUNK // chunk_bytes))


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
