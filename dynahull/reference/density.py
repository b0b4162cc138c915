"""The density of each point, plainly: a k-d tree and Qhull."""

import numpy as np
from numpy.typing import NDArray

from dynahull.progress import Observer
from dynahull.reference.hull import hull_volume
from dynahull.reference.neighbours import nearest_neighbours

_REFERENCE_BATCH = 50_000


def reference_densities(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    k: int,
    observer: Observer | None = None,
    centres: NDArray[np.float64] | None = None,
) -> NDArray[np.float64]:
    """Compute k / v as published: a k-d tree query and a Quickhull for every point.

    Parameters
    ----------
    points : (n, 3) float64 array
        The points of the cluster, finite.
    rows : (n,) int64 array
        Their row numbers, distinct.
    k : int
        Neighbours; all points of the cluster where there are fewer.
    observer : Observer, optional
        Told of the points done.
    centres : (m, 3) float64 array, optional
        Where to measure; at the points themselves by default.

    Returns
    -------
    (m,) float64 array
        Points per cubic metre; infinite where the hull has no volume.
    """
    centres = points if centres is None else centres
    density = np.empty(len(centres))
    for start in range(0, len(centres), _REFERENCE_BATCH):
        batch = centres[start : start + _REFERENCE_BATCH]
        neighbourhoods = nearest_neighbours(points, rows, k, batch)
        for slot, (centre, neighbours) in enumerate(zip(batch, neighbourhoods, strict=True), start):
            volume = hull_volume(points[neighbours] - centre)
            density[slot] = len(neighbours) / volume if volume > 0 else np.inf
        if observer:
            observer.advance(len(batch))
    return density
