"""The number of a rank among more than memory holds: histograms of their bits, refined.

A float64 that is not negative orders like its bits, so each pass finds sixteen more bits of the
number: it counts the next sixteen of those that begin with the bits known so far.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

_STEP = 16


def order_statistic(batches: Iterable[NDArray[np.float64]], rank: int) -> float:
    """Return the number of a rank, from zero.

    Parameters
    ----------
    batches : iterable of (n,) float64 arrays
        Numbers that are not negative; gone through several times.
    rank : int
        Less than their count.
    """
    prefix, below = 0, 0
    for shift in range(64 - _STEP, -1, -_STEP):
        counts = np.zeros(1 << _STEP, np.int64)
        for batch in batches:
            bits = _bits(batch)
            if shift + _STEP < 64:
                bits = bits[bits >> np.uint64(shift + _STEP) == np.uint64(prefix)]
            digits = (bits >> np.uint64(shift)) & np.uint64((1 << _STEP) - 1)
            counts += np.bincount(digits.astype(np.intp), minlength=len(counts))
        totals = below + np.cumsum(counts)
        digit = int(np.searchsorted(totals, rank, side="right"))
        below = int(totals[digit] - counts[digit])
        prefix = prefix << _STEP | digit
    return float(np.array(prefix, np.uint64).view(np.float64))


def _bits(numbers: NDArray[np.float64]) -> NDArray[np.uint64]:
    # Of the two zeros, the negative one has the largest bits.
    return (numbers + 0.0).view(np.uint64)
