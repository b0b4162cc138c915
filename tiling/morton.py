"""The Z curve through a square lattice (Morton 1966): near in order is near in place.

The order is that of the bits of x and y taken in turn, from the highest, those of x first. Every
node of a quadtree over the lattice is one run of it.
"""

import numpy as np
from numpy.typing import NDArray

from tiling.compiled import helper

_HALF = 31
"""Bits of each coordinate in one key; two keys take coordinates to 2^62."""

_SPREADS = (
    (16, 0x0000FFFF0000FFFF),
    (8, 0x00FF00FF00FF00FF),
    (4, 0x0F0F0F0F0F0F0F0F),
    (2, 0x3333333333333333),
    (1, 0x5555555555555555),
)


def morton_order(columns: NDArray[np.int64]) -> NDArray[np.intp]:
    """Return the order of columns along the Z curve.

    Parameters
    ----------
    columns : (n, 2) int64 array
        From 0 to 2^62.

    Returns
    -------
    (n,) array of indices
    """
    low = _interleaved(columns & (1 << _HALF) - 1)
    if columns.max(initial=0) >> _HALF == 0:
        return np.argsort(low, kind="stable")
    return np.lexsort((low, _interleaved(columns >> _HALF)))


def _interleaved(columns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the bits of x and y, below 2^31, in turn."""
    return _spread(columns[:, 0]) << 1 | _spread(columns[:, 1])


def _spread(bits: NDArray[np.int64]) -> NDArray[np.int64]:
    """Put a zero above each bit (Anderson, Bit Twiddling Hacks: interleave by magic numbers)."""
    for shift, mask in _SPREADS:
        bits = (bits | bits << shift) & mask
    return bits


@helper
def morton_before(x: np.int64, y: np.int64, other_x: np.int64, other_y: np.int64) -> bool:
    """Tell whether a column comes before another: the highest bit that differs decides.

    Of two differences, the one with the higher highest bit is found without looking for that bit
    (Chan 2002, Closest-point problems simplified on the RAM).
    """
    difference_x, difference_y = x ^ other_x, y ^ other_y
    if difference_x < difference_y and difference_x < difference_x ^ difference_y:
        return bool(y < other_y)
    return bool(x < other_x)
