"""Work on ranges of an array, by several threads; compiled and NumPy code holds no lock.

Whatever takes `threads` gives the same result for any number of them.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

_Result = TypeVar("_Result")

_PIECES_PER_THREAD = 4
"""More pieces than threads: some are harder than others."""


def range_bounds(count: int, threads: int, smallest: int) -> list[int]:
    """Cut `count` items into ranges of nearly equal length; return where they begin, and their end.

    There is one range for one thread, and several a thread for more, of `smallest` items at least
    if there are as many: fewer are not worth a thread's start.
    """
    pieces = 1 if threads == 1 else min(_PIECES_PER_THREAD * threads, count // smallest)
    return [count * piece // max(pieces, 1) for piece in range(max(pieces, 1) + 1)]


def group_bounds(starts: NDArray[np.int64], threads: int, smallest: int) -> list[int]:
    """Cut groups of items into ranges of groups that hold nearly the same number of items.

    See `range_bounds`: `smallest` is a number of items. A group's items begin at `starts`,
    (groups + 1,), whose last is the end.
    """
    wanted = range_bounds(int(starts[-1]), threads, smallest)[1:-1]
    inner = np.searchsorted(starts[:-1], wanted) if wanted else ()
    return [0, *(int(bound) for bound in inner), len(starts) - 1]


def over_ranges(
    work: Callable[[int, int], _Result], bounds: list[int], threads: int
) -> list[_Result]:
    """Call `work(first, end)` for each range, by several threads; the results in their order."""
    ranges = list(pairwise(bounds))
    if threads == 1 or len(ranges) == 1:
        return [work(first, end) for first, end in ranges]
    with ThreadPoolExecutor(min(threads, len(ranges))) as executor:
        return list(executor.map(lambda piece: work(*piece), ranges))


def over_items(
    work: Callable[[int, int], _Result], count: int, threads: int, smallest: int
) -> list[_Result]:
    """Call `work(first, end)` for ranges of `count` items: see `range_bounds`, `over_ranges`."""
    return over_ranges(work, range_bounds(count, threads, smallest), threads)
