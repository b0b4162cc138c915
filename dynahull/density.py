"""Step 4: the density of every point, k / v over its nearest neighbours in its cluster.

The compiled kernels do it by default; `reference_densities` is the published procedure, plain,
and the oracle they are tested against.
"""

import numpy as np
from numpy.typing import NDArray

from dynahull.hull import hull_volume
from dynahull.neighbours import nearest_neighbours
from dynahull.parameters import MethodParameters
from dynahull.progress import Observer, SilentObserver

SMALLEST_CLUSTER = 4
"""Points of the smallest cluster that is scored: fewer have no hull."""

_REFERENCE_BATCH = 50_000


def cluster_densities(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    parameters: MethodParameters,
    threads: int = 1,
    observer: Observer | None = None,
) -> NDArray[np.float64]:
    """Compute the density of every point of one cluster.

    Parameters
    ----------
    points : (n, 3) float64 array
        The points of the cluster, finite.
    rows : (n,) int64 array
        Their row numbers, distinct.
    parameters : MethodParameters
        `neighbours.k` and `density.device` are used.
    threads : int
        Threads of the compiled kernels.
    observer : Observer, optional
        Told of the points done.

    Returns
    -------
    (n,) float64 array
        Points per cubic metre; infinite where the hull has no volume; NaN for all where the
        cluster has fewer than four points.
    """
    observer = observer or SilentObserver()
    if len(points) < SMALLEST_CLUSTER:
        observer.advance(len(points))
        return np.full(len(points), np.nan)
    if parameters.density.device == "reference":
        return reference_densities(points, rows, parameters.neighbours.k, observer)
    from dynahull.kernels import hull_densities  # noqa: PLC0415 (compiles on first use)

    return hull_densities(
        points, rows, parameters.neighbours.k, threads=threads, on_progress=observer.advance
    ).density


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
