"""Step 2: clusters of the ground-free points (section III of the paper; MiniBatchKMeans).

The model is fitted on a sample that row numbers decide, and a point belongs to its nearest
centroid. Both are functions of the points and their row numbers alone, so that a map cut into
tiles gets the clusters that the whole map gets.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from dynahull.parameters import ClusteringParameters
from dynahull.threads import over_items

_ASSIGNMENT_BATCH = 16_384
"""Points; all that is computed for them stays in the processor's cache."""

_RANKING_BATCH = 65_536
_SMALLEST_RANGE = 50_000
"""Points."""

_FEWEST_SAMPLED = 1_000


@dataclass(frozen=True, slots=True)
class Clusters:
    """A fitted model."""

    centroids: NDArray[np.float64]
    """(count, 3): in the coordinates of the map; no rows where there was nothing to cluster."""

    def nearest(self, points: NDArray[np.float64], *, threads: int = 1) -> NDArray[np.int32]:
        """Return the index of each point's nearest centroid, (n,), the lower of two equally near.

        Parameters
        ----------
        points : (n, 3) float64 array
        """
        nearest = np.zeros(len(points), np.int32)

        def assign(first: int, end: int) -> None:
            _assign(points[first:end], self.centroids, nearest[first:end])

        over_items(assign, len(points), threads, _SMALLEST_RANGE)
        return nearest


def sample_rows(
    rows: NDArray[np.int64], total: int, parameters: ClusteringParameters
) -> NDArray[np.intp]:
    """Choose the points that the model is fitted on, by their row numbers.

    Every row number is given a pseudo-random rank (SplitMix64, Steele et al. 2014, a bijection).
    Those below `sample / total` of all ranks are taken, or the lowest thousand where those are
    more. Sampling the parts of a map and then what they gave is thus sampling the map.

    Parameters
    ----------
    rows : (n,) int64 array
        Distinct row numbers of ground-free points.
    total : int
        Points of the whole map that take part, ground included: neither invalid nor left out.
    parameters : ClusteringParameters
        `sample` and `seed` are used.

    Returns
    -------
    intp array
        Indices into `rows`, in the order of the row numbers.
    """
    limit = 2**64 * parameters.sample // max(total, 1)
    chosen = np.arange(len(rows))
    if limit < 2**64:
        chosen = ranked_below(limit, rows, parameters.seed)
    if len(chosen) < _FEWEST_SAMPLED < len(rows):
        rank = random_rank(rows, parameters.seed)
        chosen = np.argpartition(rank, _FEWEST_SAMPLED - 1)[:_FEWEST_SAMPLED]
    elif len(chosen) < _FEWEST_SAMPLED:
        chosen = np.arange(len(rows))
    return chosen[np.argsort(rows[chosen])]


def fit_clusters(sample: NDArray[np.float64], parameters: ClusteringParameters) -> Clusters:
    """Fit MiniBatchKMeans on a sample of ground-free points, (n, 3), in the order of their rows.

    There are as many clusters as asked for, or as distinct points in the sample if those are fewer.
    """
    count = _distinct_points(sample, parameters.count)
    if count == 0:
        return Clusters(np.empty((0, 3)))
    from sklearn.cluster import MiniBatchKMeans  # noqa: PLC0415 (a second of import time)

    # scikit-learn expands the squared distance, which loses the digits of far coordinates.
    origin = np.floor(sample.mean(axis=0))
    model = MiniBatchKMeans(count, random_state=parameters.seed, n_init=3, batch_size=4096)
    with threadpool_limits(1):
        model.fit(sample - origin)
    return Clusters(model.cluster_centers_ + origin)


def _distinct_points(points: NDArray[np.float64], most: int) -> int:
    """Count the distinct points, up to `most`; a few of the first are nearly always enough."""
    few = len(np.unique(points[: 4 * most], axis=0))
    return min(few if few >= most else len(np.unique(points, axis=0)), most)


def _assign(
    points: NDArray[np.float64], centroids: NDArray[np.float64], nearest: NDArray[np.int32]
) -> None:
    """Set the nearest centroid of each point.

    By differences, not the expanded square: exact to the last bit in any batch, and far from the
    origin as well.
    """
    for start in range(0, len(points), _ASSIGNMENT_BATCH):
        batch = points[start : start + _ASSIGNMENT_BATCH].T.copy()
        chosen = nearest[start : start + _ASSIGNMENT_BATCH]
        least = np.full(len(chosen), np.inf)
        dx, dy, dz = squares = np.empty_like(batch)
        for index, centre in enumerate(centroids):
            np.subtract(batch, centre[:, None], out=squares)
            np.multiply(squares, squares, out=squares)
            distance = np.add(np.add(dx, dy, out=dx), dz, out=dx)
            chosen[distance < least] = index
            np.minimum(distance, least, out=least)


def ranked_below(limit: int, rows: NDArray[np.int64], seed: int) -> NDArray[np.intp]:
    """Return which of the row numbers have a rank below a limit of at most 2**64, ascending."""
    bound = np.uint64(limit)
    chosen = [
        start + np.flatnonzero(random_rank(rows[start : start + _RANKING_BATCH], seed) < bound)
        for start in range(0, len(rows), _RANKING_BATCH)
    ]
    return np.concatenate(chosen) if chosen else np.zeros(0, np.intp)


def random_rank(rows: NDArray[np.int64], seed: int) -> NDArray[np.uint64]:
    """Return a pseudo-random number for each row number, (n,): no two rows have the same."""
    golden = np.uint64(0x9E3779B97F4A7C15)
    mixed = (rows.astype(np.uint64) + np.uint64(1)) * golden
    mixed ^= np.asarray(seed * int(golden) % 2**64, np.uint64)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return np.asarray(mixed ^ (mixed >> np.uint64(31)))
