"""Step 3, plain version: the k nearest points of the same cluster, exactly and in a defined order.

This is the oracle of `dynahull.kernels`: short, slow, on SciPy's k-d tree.
"""

import numpy as np
from numpy.typing import NDArray


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
