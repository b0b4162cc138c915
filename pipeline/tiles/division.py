"""A tile worked on in parts, where its memory does not suffice for it as a whole.

Its points stay those of one tile, in its chunk and in all that is kept of it, so that nothing else
needs to know: one model a tile (`clustering.scope: tile`) is still that of the whole tile.
"""

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from pipeline.tiles.borders import Region

SIDES = (2, 4)
"""In how many parts each way a tile is done that was too large, and again if it still was."""


def divided(region: Region, xyz: NDArray[np.float64], sides: int) -> list[Region]:
    """Cut a region into boxes that hold about equally many points.

    Parameters
    ----------
    region : Region
    xyz : (n, 3) float64 array
        The points.
    sides : int
        Boxes each way, first by x and then by y.

    Returns
    -------
    list of Region
        sides x sides boxes, some perhaps empty; each place of the region is in just one.
    """
    if sides == 1:
        return [region]
    return [
        box
        for strip in _strips(region, xyz[region.holds(xyz), 0], 0, sides)
        for box in _strips(strip, xyz[strip.holds(xyz), 1], 1, sides)
    ]


def widened(box: Region, margin: float, limits: Region) -> Region:
    """Return a box with a margin around it, as far as it lies within limits."""
    return Region(
        np.maximum(box.low - margin, limits.low), np.minimum(box.high + margin, limits.high)
    )


def _strips(region: Region, places: NDArray[np.float64], axis: int, count: int) -> Iterator[Region]:
    """Cut a region across one axis, where its points are."""
    ranks = np.arange(1, count) * len(places) // count
    inner = np.partition(places, ranks)[ranks] if len(places) else places
    edges = [region.low[axis], *inner, region.high[axis]]
    for start, end in pairwise(edges):
        low, high = region.low.copy(), region.high.copy()
        low[axis], high[axis] = start, end
        yield Region(low, high)
