"""The feet of what stands on the ground: as low as the ground, and no part of it."""

import numpy as np

from dynahull.compilation import compiled
from dynahull.ground.lattice import (
    Booleans,
    Floats,
    Integers,
    build_lattice,
    sort_heights,
    starts_of,
)
from dynahull.ground.parameters import SlopeParameters

__all__ = ["are_feet"]

_PARTS = 4
"""The lattice of this step is so many times finer: about as fine as a wall is thick."""

_HEIGHT = 0.3
"""Metres; what stands on the ground is looked for so high above it."""


def are_feet(
    points: Floats, near: Booleans, surface: Floats, tolerances: Floats, p: SlopeParameters
) -> Booleans:
    """Tell which of the points near the ground belong to what stands there.

    A wall or a walker reaches down to the floor, and its lowest points lie as near to the floor's
    surface as the floor's own. Within a small cell it is decided by the majority: where more than
    `foot` times as many points follow above as there are near the surface, they are a foot.

    Parameters
    ----------
    points : (N, 3) float64 array
        Metres.
    near : (N,) bool array
        Points within their tolerance of the surface.
    surface, tolerances : (N,) float64 arrays
        Height of the surface at each point, and the tolerance there, metres.
    p : SlopeParameters
        `cell` and `foot` are used.
    """
    lattice = build_lattice(points, p.cell / _PARTS, 0.0)
    starts = starts_of(lattice.slots, lattice.slot_count)
    columns = sort_heights(points[:, 2], lattice.slots, starts)
    return _are_feet(lattice.slots, columns, starts, near, surface, tolerances, p.foot)


@compiled
def _are_feet(
    slots: Integers,
    columns: Floats,
    starts: Integers,
    near: Booleans,
    surface: Floats,
    tolerances: Floats,
    foot: float,
) -> Booleans:
    feet = np.zeros(len(slots), np.bool_)
    for point in range(len(slots)):
        if not near[point]:
            continue
        column = columns[starts[slots[point]] : starts[slots[point] + 1]]
        top = surface[point] + tolerances[point]
        first = np.searchsorted(column, surface[point] - tolerances[point])
        upper = np.searchsorted(column, top, side="right")
        above = np.searchsorted(column, top + _HEIGHT, side="right") - upper
        feet[point] = above > foot * (upper - first)
    return feet
