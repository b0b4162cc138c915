"""Doubles as integers of the same order, for the reductions that compilers put into vectors."""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import njit, types
from numba.extending import intrinsic


@intrinsic
def bits_of(context: Any, value: Any) -> Any:
    """Return the 64 bits of a double as a signed integer."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(64))

    return types.int64(types.float64), generate


@njit(nogil=True)
def ordered_bits(value: float) -> int:
    """Return an integer that has the order of the doubles: the smaller the double, the smaller."""
    bits = bits_of(value)
    return bits ^ ((bits >> np.int64(63)) & np.int64(0x7FFFFFFFFFFFFFFF))
