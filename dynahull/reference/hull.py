"""Step 4, plain version: the volume of the convex hull of a neighbourhood, by Quickhull.

This is the oracle of `dynahull.kernels`: SciPy's Qhull (Barber, Dobkin and Huhdanpaa 1996).
"""

import numpy as np
from numpy.typing import NDArray

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
