"""The volume of a convex hull in exact arithmetic, plain: the judge of the fast kernel.

Every double is a fraction, so Python's integers decide without rounding which facets the hull has
and what it encloses. It takes a thousand times as long as the kernel.

As in the kernel, the points are shaken for the topology. With integers of any length the shake
can be so small that it changes no sign but those of coplanar points.
"""

import random
from fractions import Fraction
from math import lcm

import numpy as np
from numpy.typing import NDArray

_SHAKE_BITS = 40

_Place = tuple[int, int, int]
_Facet = tuple[int, int, int]


def exact_hull_volume(points: NDArray[np.float64]) -> float:
    """Measure the convex hull of some points; rounded once, at the end.

    Parameters
    ----------
    points : (n, 3) float64 array
        Finite coordinates.

    Returns
    -------
    float
        Cubic units of the coordinates; zero where all points are coplanar.
    """
    fractions = [tuple(map(Fraction, point)) for point in points.tolist()]
    scale = lcm(*(value.denominator for point in fractions for value in point))
    places: list[_Place] = [
        (int(x * scale), int(y * scale), int(z * scale)) for x, y, z in dict.fromkeys(fractions)
    ]
    if len(places) < 4:
        return 0.0
    # A determinant that is not zero is at least 1: a shake this small cannot change its sign.
    size = max(abs(value) for place in places for value in place).bit_length()
    spread = 2 * size + _SHAKE_BITS + 8
    for seed in range(100):
        generator = random.Random(seed)
        shaken: list[_Place] = [
            (
                (x << spread) + generator.getrandbits(_SHAKE_BITS),
                (y << spread) + generator.getrandbits(_SHAKE_BITS),
                (z << spread) + generator.getrandbits(_SHAKE_BITS),
            )
            for x, y, z in places
        ]
        facets = _insert_one_by_one(shaken)
        if facets is not None:
            inside = places[0]
            volume = sum(-_side(places[a], places[b], places[c], inside) for a, b, c in facets)
            return float(Fraction(volume, 6 * scale**3))
    raise AssertionError("a hundred random shakes have left four points coplanar")


def _insert_one_by_one(places: list[_Place]) -> set[_Facet] | None:
    """Return the facets of a hull, anticlockwise from outside; None where four are coplanar."""
    side = _side(places[0], places[1], places[2], places[3])
    if side == 0:
        return None
    a, b = (0, 1) if side < 0 else (1, 0)
    facets = {(a, b, 2), (b, a, 3), (a, 2, 3), (2, b, 3)}
    for i in range(4, len(places)):
        visible = set()
        for facet in facets:
            side = _side(places[facet[0]], places[facet[1]], places[facet[2]], places[i])
            if side == 0:
                return None
            if side > 0:
                visible.add(facet)
        edges = {edge for p, q, r in visible for edge in ((p, q), (q, r), (r, p))}
        facets -= visible
        facets |= {(p, q, i) for p, q in edges if (q, p) not in edges}
    return facets


def _side(a: _Place, b: _Place, c: _Place, d: _Place) -> int:
    """Return the determinant of (b - a, c - a, d - a): positive where d is above."""
    bx, by, bz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    cx, cy, cz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    dx, dy, dz = d[0] - a[0], d[1] - a[1], d[2] - a[2]
    return (by * cz - bz * cy) * dx + (bz * cx - bx * cz) * dy + (bx * cy - by * cx) * dz
