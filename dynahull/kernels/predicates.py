"""Which side of a plane a point of the grid lies on, exactly.

Coordinates are multiples of 2^-50 and at most 1 + 2^-34. The determinant that decides comes out of
doubles within `UNCERTAIN` = 2^-45 of the truth: differences of coordinates are exact; a component
of the normal, at most 8, is off by at most 2^-50; its product with a coordinate by 2^-49.4; three
products, the offset and their sums by 2^-45.7 together. A value beyond that has the true sign. A
value within it needs integers: in steps of the grid a difference has 52 bits, and a determinant
159 bits, but this one is known to be at most 2^106, so 128 bits hold it however the steps
before it overflow.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from dynahull.kernels.decorators import compiled, inlined
from dynahull.kernels.frame import STEP, Neighbourhood
from dynahull.kernels.tree import Place

UNCERTAIN = 2.0**-45
"""Largest error of the determinant in doubles."""

ROUGHLY_UNCERTAIN = 2.0**-19
"""Largest error of the determinant in singles, in shares of the normal's largest component."""


@inlined
def place_of(points: Neighbourhood, i: np.uint64) -> Place:
    """Return the place of a point on the grid."""
    x, y, z = points.grid
    return x[i], y[i], z[i]


@inlined
def minus(p: Place, q: Place) -> Place:
    """Return p - q."""
    return p[0] - q[0], p[1] - q[1], p[2] - q[2]


@inlined
def dot(p: Place, q: Place) -> float:
    """Return the scalar product."""
    return p[0] * q[0] + p[1] * q[1] + p[2] * q[2]


@inlined
def cross(p: Place, q: Place) -> Place:
    """Return the vector product."""
    return p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]


@compiled
def is_above_all_others(
    points: Neighbourhood,
    count: int,
    a: np.uint64,
    b: np.uint64,
    c: np.uint64,
    normal: Place,
) -> bool:
    """Tell whether all other points lie strictly below the plane of three of them.

    Parameters
    ----------
    a, b, c : uint64
        The three, anticlockwise seen from above.
    normal : tuple of float
        Of the plane, (b - a) x (c - a) in doubles.
    """
    height = dot(normal, place_of(points, a))
    for i in range(np.uint64(count)):
        depth = height - dot(normal, place_of(points, i))
        if depth > UNCERTAIN or i in (a, b, c):
            continue
        if depth < -UNCERTAIN or exact_side(points, a, b, c, i) >= 0:
            return False
    return True


SLIVER = 2.0**-20
"""Component of a normal below which its rounding, 2^-50, would turn the plane noticeably."""

_SPLIT = 1.5 * 2.0**28  # adding and subtracting it rounds to multiples of 2^-24


@inlined
def accurate_minor(p: float, q: float, r: float, s: float) -> float:
    """Return p s - q r of differences of coordinates, to within 2^-73 (Dekker 1971).

    Halves of 26 bits have exact products, and exact differences of these.
    """
    p_high, q_high = (p + _SPLIT) - _SPLIT, (q + _SPLIT) - _SPLIT
    r_high, s_high = (r + _SPLIT) - _SPLIT, (s + _SPLIT) - _SPLIT
    p_low, q_low, r_low, s_low = p - p_high, q - q_high, r - r_high, s - s_high
    high = p_high * s_high - q_high * r_high
    middle = (p_high * s_low - q_high * r_low) + (p_low * s_high - q_low * r_high)
    low = p_low * s_low - q_low * r_low
    return high + (middle + low)


@intrinsic
def _determinant_sign(
    context: Any, bx: Any, by: Any, bz: Any, cx: Any, cy: Any, cz: Any, dx: Any, dy: Any, dz: Any
) -> Any:
    """Return the sign of the determinant of three integer vectors, modulo 2^128."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        wide = ir.IntType(128)
        b_x, b_y, b_z, c_x, c_y, c_z, d_x, d_y, d_z = (
            builder.sext(value, wide) for value in arguments
        )

        def minor(p: Any, q: Any, r: Any, s: Any) -> Any:
            return builder.sub(builder.mul(p, s), builder.mul(q, r))

        determinant = builder.add(
            builder.add(
                builder.mul(minor(b_y, b_z, c_y, c_z), d_x),
                builder.mul(minor(b_z, b_x, c_z, c_x), d_y),
            ),
            builder.mul(minor(b_x, b_y, c_x, c_y), d_z),
        )
        zero = wide(0)
        above = builder.zext(builder.icmp_signed(">", determinant, zero), ir.IntType(64))
        below = builder.zext(builder.icmp_signed("<", determinant, zero), ir.IntType(64))
        return builder.sub(above, below)

    return types.int64(*([types.int64] * 9)), generate


@compiled
def exact_side(
    points: Neighbourhood, a: np.uint64, b: np.uint64, c: np.uint64, i: np.uint64
) -> int:
    """Return 1 for a point above the plane of `a`, `b` and `c`, -1 for one below, 0 for one on it.

    Exact for points within `UNCERTAIN` of it in doubles, which is for the caller to know.
    """
    origin = place_of(points, a)
    bx, by, bz = _steps(minus(place_of(points, b), origin))
    cx, cy, cz = _steps(minus(place_of(points, c), origin))
    dx, dy, dz = _steps(minus(place_of(points, i), origin))
    return _determinant_sign(bx, by, bz, cx, cy, cz, dx, dy, dz)


@inlined
def _steps(difference: Place) -> tuple[np.int64, np.int64, np.int64]:
    x, y, z = difference
    return np.int64(x / STEP), np.int64(y / STEP), np.int64(z / STEP)
