"""Steps 3 and 4 plainly, with a k-d tree and Qhull: what the fast code is compared with."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from dynahull.observer import Observer

FLATNESS = 1e-10
"""Width or thickness, as a share of the length, up to which a neighbourhood has no volume.

Coplanar points rarely stay coplanar once rotated and rounded to doubles. A rule in proportion to
the neighbourhood gives them the same answer in every position, and Qhull's own measure of
roundoff, which depends on where the points lie, never decides.
"""

_CORNERS_OF_A_VOLUME = 4


def hull_volume(neighbours: NDArray[np.float64]) -> float:
    """Measure the convex hull of some points.

    Parameters
    ----------
    neighbours : (k, 3) float64 array
        In metres, the nearest to the query point first.

    Returns
    -------
    float
        Cubic metres; zero where the points are coplanar, collinear or identical by `FLATNESS`.
    """
    from scipy.spatial import ConvexHull  # noqa: PLC0415 (a fifth of a second, and rarely used)

    if len(neighbours) < _CORNERS_OF_A_VOLUME:
        return 0.0
    centred = neighbours - neighbours[0]
    frame, extent = _frame(centred)
    if extent[0] == 0 or extent[1:].min() <= FLATNESS * extent[0]:
        return 0.0
    # In its own frame even a sliver fills a cube, so Qhull never fails on it; volume scales along.
    return float(ConvexHull(centred @ frame.T / extent, qhull_options="Qt").volume * extent.prod())


def _frame(centred: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the axes of length, width and thickness as rows, and the three extents.

    Length is towards the farthest point, width towards the point farthest from that line, and
    thickness across the plane of both. Axes beyond a zero extent are zero.
    """
    axes, extent = np.zeros((3, 3)), np.zeros(3)
    rest = centred
    for axis in range(2):
        distance = np.linalg.norm(rest, axis=1)
        farthest = int(np.argmax(distance))
        extent[axis] = distance[farthest]
        if extent[axis] == 0:
            return axes, extent
        axes[axis] = rest[farthest] / extent[axis]
        rest = rest - np.outer(rest @ axes[axis], axes[axis])
    axes[2] = np.cross(axes[0], axes[1])
    extent[2] = np.abs(centred @ axes[2]).max()
    return axes, extent


def nearest_neighbours(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    k: int,
    centres: NDArray[np.float64] | None = None,
) -> NDArray[np.intp]:
    """Find the k nearest points of each centre; of each point, itself included, by default.

    Parameters
    ----------
    points : (n, 3) float64 array
        The points of one cluster.
    rows : (n,) int64 array
        Their row numbers, which break ties of distance: the smaller is the nearer.
    k : int
        Neighbours wanted; all points where there are fewer.
    centres : (m, 3) float64 array, optional
        Where to look around; the points themselves by default.

    Returns
    -------
    (m, min(k, n)) intp array
        Indices into `points`, ordered by (squared distance, row number). The squared distance is
        (dx dx + dy dy) + dz dz in float64, from differences of the coordinates as given.
    """
    from scipy.spatial import KDTree  # noqa: PLC0415 (a fifth of a second, and rarely used)

    k = min(k, len(points))
    if centres is None:
        centres = points
    neighbours = np.empty((len(centres), k), np.intp)
    if not k:
        return neighbours
    tree = KDTree(points)
    for slot, centre in enumerate(centres):
        distance = np.asarray(tree.query(centre, k=[k])[0])
        # All ties at the k-th distance, and a hair more: SciPy may round its radius otherwise.
        around = np.asarray(tree.query_ball_point(centre, distance[0] * (1 + 1e-9)), np.intp)
        difference = points[around] - centre
        squared = (difference[:, 0] ** 2 + difference[:, 1] ** 2) + difference[:, 2] ** 2
        neighbours[slot] = around[np.lexsort((rows[around], squared))[:k]]
    return neighbours


_AT_A_TIME = 50_000
"""Centres."""


def neighbourhoods(
    points: NDArray[np.float64],
    rows: NDArray[np.int64],
    k: int,
    centres: NDArray[np.float64],
    observer: Observer | None = None,
) -> Iterator[NDArray[np.float64]]:
    """Yield the nearest points of each centre as seen from it; parameters as for the densities."""
    for start in range(0, len(centres), _AT_A_TIME):
        batch = centres[start : start + _AT_A_TIME]
        nearest = nearest_neighbours(points, rows, k, batch)
        for centre, neighbours in zip(batch, nearest, strict=True):
            yield points[neighbours] - centre
        if observer:
            observer.advance(len(batch))


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
    for slot, around in enumerate(neighbourhoods(points, rows, k, centres, observer)):
        volume = hull_volume(around)
        density[slot] = len(around) / volume if volume > 0 else np.inf
    return density
