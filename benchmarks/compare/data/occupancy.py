"""Labels for a map that has none, made by a sensor that stands still: how often a place is seen.

What is there all the time is seen by most scans; what passes fills a place for a few scans in a
row. The labels favour nobody who looks for free space, and somewhat whoever looks for density.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.evaluation.truth import Truth

__all__ = ["labels_by_occupancy"]

PLACE = 0.1
"""Metres, edge of a cube."""

STATIC_SHARE = 0.5
"""Of all scans: places that at least so many see are static."""

FEWEST, MOST, LONGEST = 3, 20, 40
"""Scans that see a place where something passed, and from the first to the last of them. A place
that fewer see may be noise, one that is seen rarely but all the time a slanting surface; whatever
is neither static nor this is unknown."""


def labels_by_occupancy(
    xyz: NDArray[np.float64], scan: NDArray[np.int32], place: float = PLACE
) -> NDArray[np.int8]:
    """Label points by the scans that see their place.

    Parameters
    ----------
    xyz : (N, 3) float64 array
        Metres.
    scan : (N,) int32 array
        The scan that saw each point, from 0 to the number of scans less one.
    place : float
        Metres.

    Returns
    -------
    (N,) int8 array
        Of `Truth`.
    """
    cells = np.floor(xyz / place).astype(np.int64)
    cells -= cells.min(axis=0)
    _, place_of_point = np.unique(
        np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1)), return_inverse=True
    )
    scan_count = int(scan.max()) + 1
    places, scans = np.divmod(np.unique(place_of_point * scan_count + scan), scan_count)
    seen = np.bincount(places)
    begins = np.cumsum(seen) - seen  # pairs are sorted by place, then by scan
    lasting = scans[begins + seen - 1] - scans[begins] + 1
    labels = np.full(len(seen), Truth.UNKNOWN, dtype=np.int8)
    labels[seen >= STATIC_SHARE * scan_count] = Truth.STATIC
    labels[(seen >= FEWEST) & (seen <= MOST) & (lasting <= LONGEST)] = Truth.DYNAMIC
    return labels[place_of_point]
