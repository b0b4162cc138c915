"""How many scans saw each place: a ghost is seen in passing, what stands is seen again and again.

A scan marks one of 64 bits of each voxel that it saw, and so do 8 and 64 scans on end. Bits are
united: the marks of a map are those of its parts, in any order, to the last bit. How many bits are
set tells how many scans there were, up to some hundred (linear counting, Whang et al. 1990).
"""

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, inlined
from dynahull.evidence.voxels import Integers

Scans = npt.NDArray[np.int32]

SPANS = (1, 8, 64)
"""Scans on end that make one mark."""


@compiled
def marks_of(scan: Scans) -> Integers:
    """Return the bits that the scan of each point marks, (n, len(SPANS)); none for scan -1."""
    marks = np.zeros((len(scan), 3), np.int64)
    for i in range(len(scan)):
        if scan[i] < 0:
            continue
        for column in range(3):
            marks[i, column] = np.int64(1) << _mixed(np.uint64(scan[i] >> (3 * column)))
    return marks


@inlined
def _mixed(number: np.uint64) -> np.int64:
    """Return 6 bits of a number that is mixed (as SplitMix64 ends; Steele et al. 2014)."""
    number = (number + np.uint64(0x9E3779B97F4A7C15)) * np.uint64(0xBF58476D1CE4E5B9)
    number = (number ^ (number >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    number = (number ^ (number >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.int64(number >> np.uint64(58))


@compiled
def scan_counts(marks: Integers) -> npt.NDArray[np.float32]:
    """Return the logarithm to base 2 of how many scans marked each row; NaN where none did."""
    counts = np.full(marks.shape, np.nan, np.float32)
    for v in range(len(marks)):
        for column in range(marks.shape[1]):
            bits, left = 0, np.uint64(marks[v, column])
            while left:
                left &= left - np.uint64(1)
                bits += 1
            if bits > 0:
                empty = max(64.0 - bits, 0.5)
                counts[v, column] = np.log2(-64.0 * np.log(empty / 64.0))
    return counts
