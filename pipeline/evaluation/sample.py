"""A sample of a tiled cloud: points at random places in the order of its rows, whatever the tiles.

Which places is drawn as from an array of the points. Where they are is found by counting: how many
points are in each run of a few hundred rows, and then what is in the runs that are hit.
"""

import numpy as np
from numpy.typing import NDArray

from pipeline.evaluation.tiled_cloud import TiledCloud

_RUN_BITS = 8
"""Of a row number; so a sampled point brings at most 256 others into memory."""


def draw_sample(cloud: TiledCloud, size: int, seed: int, stream: int) -> NDArray[np.float64]:
    """Draw points at random, uniformly, without replacement.

    Parameters
    ----------
    cloud : TiledCloud
    size : int
        Points wanted; all are returned where there are not more.
    seed, stream : int
        Samples of one seed and several streams are independent of each other.

    Returns
    -------
    (min(n, size), 3) array
        In the order of their rows.
    """
    count = len(cloud)
    if size == 0:
        return np.empty((0, 3))
    if count <= size:
        return _points_at(cloud, np.arange(count))
    random = np.random.default_rng([seed, stream])
    return _points_at(cloud, np.sort(random.choice(count, size, replace=False, shuffle=False)))


def _points_at(cloud: TiledCloud, places: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the points at ascending places in the order of the rows."""
    counts = np.zeros(0, np.int64)
    for tile in cloud.tiles():
        found = np.bincount(cloud.rows(tile) >> _RUN_BITS, minlength=len(counts))
        found[: len(counts)] += counts
        counts = found
    ends = np.cumsum(counts)
    hit = np.zeros(len(counts), np.bool_)
    hit[np.searchsorted(ends, places, side="right")] = True
    rows, xyz = [], []
    for tile in cloud.tiles():
        of_tile = cloud.rows(tile)
        chosen = hit[of_tile >> _RUN_BITS]
        rows.append(of_tile[chosen])
        xyz.append(cloud.xyz(tile)[chosen])
    order = np.argsort(np.concatenate(rows))
    # Runs are here as a whole, so the places of their points follow from where they begin.
    held = counts * hit
    begins = np.repeat(ends - counts - (np.cumsum(held) - held), held)
    points: NDArray[np.float64] = np.concatenate(xyz)[order]
    return points[np.searchsorted(begins + np.arange(len(order)), places)]
