"""Step 4: the density of every point, k / v over its nearest neighbours in its cluster.

The compiled kernels do it by default; `reference_densities` is the published procedure, plain,
and the oracle they are tested against.
"""

import numpy as np
from numpy.typing import NDArray

from dynahull.observer import Observer, SilentObserver
from dynahull.parameters import MethodParameters
from dynahull.reference import neighbourhoods, reference_densities

SMALLEST_CLUSTER = 4
"""Points of the smallest cluster that is scored: fewer have no hull."""

SPREAD_COLUMNS = 5
"""Numbers that say how a neighbourhood is spread: see `reference_spreads`."""


def cluster_densities(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    parameters: MethodParameters,
    threads: int = 1,
    observer: Observer | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float32]]:
    """Compute the density of every point of one cluster, and what else is asked of neighbourhoods.

    Parameters
    ----------
    points : (n, 3) float64 array
        The points of the cluster, finite.
    rows : (n,) int64 array
        Their row numbers, distinct.
    parameters : MethodParameters
        `neighbours.k`, `density.device` and `removal.decision` are used.
    threads : int
        Threads of the compiled kernels.
    observer : Observer, optional
        Told of the points done.

    Returns
    -------
    density : (n,) float64 array
        Points per cubic metre; infinite where the hull has no volume; NaN for all where the
        cluster has fewer than four points.
    spread : (n, SPREAD_COLUMNS) float32 array
        How the neighbours are spread; (n, 0) where the decision does not ask.
    """
    observer = observer or SilentObserver()
    k, spread = parameters.neighbours.k, parameters.removal.weighs_evidence
    if len(points) < SMALLEST_CLUSTER:
        observer.advance(len(points))
        nothing = np.full((len(points), SPREAD_COLUMNS if spread else 0), np.nan, np.float32)
        return np.full(len(points), np.nan), nothing
    if parameters.density.device == "reference":
        density = reference_densities(points, rows, k, observer)
        return density, reference_spreads(points, rows, k if spread else 0)
    from dynahull.kernels import hull_densities  # noqa: PLC0415 (compiles on first use)

    found = hull_densities(
        points, rows, k, threads=threads, on_progress=observer.advance, spread=spread
    )
    return found.density, found.spread


def reference_spreads(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    k: int,
    centres: NDArray[np.float64] | None = None,
) -> NDArray[np.float32]:
    """Measure how neighbourhoods are spread, plainly; parameters as for `reference_densities`.

    Returns
    -------
    (m, SPREAD_COLUMNS) float32 array
        Thickness, width and length (metres), |z| of the normal, and the distance from the centre to
        the mean of its neighbours; (m, 0) where k is 0.
    """
    centres = points if centres is None else centres
    if k == 0:
        return np.empty((len(centres), 0), np.float32)
    spread = np.empty((len(centres), SPREAD_COLUMNS), np.float32)
    for slot, around in enumerate(neighbourhoods(points, rows, k, centres)):
        places = np.unique(around, axis=0)
        mean = places.mean(axis=0)
        values, axes = np.linalg.eigh((places - mean).T @ (places - mean) / len(places))
        spread[slot, :3] = np.sqrt(np.maximum(values, 0.0))
        spread[slot, 3:] = abs(axes[2, 0]), np.linalg.norm(mean)
    return spread
