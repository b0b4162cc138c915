"""The points of a map as the figures need them: finite, in batches, and in a k-d tree.

Finite means here what `valid` means to the method: no coordinate is NaN or beyond 1e150.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from dynahull.algorithm import valid_points
from dynahull.progress import Observer
from pipeline.errors import EvaluationError
from pipeline.evaluation.labels import Labels
from pipeline.machine import available_cores
from tiling.formats.collection import MapCollection

BATCH = 500_000
"""Points that are looked up at a time."""

_LEAST_BOUND = 1e-150
"""Metres; its square is not zero."""


class Cloud:
    """The finite points of a map, or of some of its rows; read from the files at every pass.

    Parameters
    ----------
    collection : MapCollection
    chosen : (N,) bool array, optional
        The rows of the map that belong to the cloud; otherwise all.

    Attributes
    ----------
    name : str
        What to call it in messages.
    row_count : int
        N, rows of the whole map, finite or not, chosen or not.
    """

    def __init__(self, collection: MapCollection, chosen: NDArray[np.bool_] | None = None) -> None:
        self.name = collection.name
        self.row_count = collection.point_count
        self._collection = collection
        self._chosen = chosen

    def choose(self, chosen: NDArray[np.bool_]) -> "Cloud":
        """Return the cloud of some rows of the same map."""
        return Cloud(self._collection, chosen)

    def batches(self) -> Iterator[tuple[NDArray[np.intp], NDArray[np.float64]]]:
        """Yield row numbers, (n,), and coordinates, (n, 3), in the map's order and units."""
        for _, batch in self._collection.batches(BATCH):
            wanted = valid_points(batch.xyz)
            if self._chosen is not None:
                wanted &= self._chosen[batch.first_row : batch.first_row + len(batch.xyz)]
            yield batch.first_row + np.flatnonzero(wanted), batch.xyz[wanted]

    def points(self) -> NDArray[np.float64]:
        """Read all points into one array, (n, 3).

        Raises
        ------
        EvaluationError
            When there is not a single one.
        """
        return self.labelled_points(np.zeros(self.row_count, dtype=np.int8))[0]

    def labelled_points(self, labels: Labels) -> tuple[NDArray[np.float64], Labels]:
        """Read all points into one array, and take their labels out of those of all rows.

        Parameters
        ----------
        labels : (N,) int8 array

        Returns
        -------
        points : (n, 3) float64 array
        labels : (n,) int8 array

        Raises
        ------
        EvaluationError
            When there is not a single point.
        """
        points, taken = np.empty((self.row_count, 3)), np.empty(self.row_count, dtype=np.int8)
        count = 0
        for rows, xyz in self.batches():
            points[count : count + len(rows)], taken[count : count + len(rows)] = xyz, labels[rows]
            count += len(rows)
        if count == 0:
            among = "" if self._chosen is None else " among those that are to be compared"
            raise EvaluationError(f"{self.name}: expected finite points, found none{among}")
        # In place: what was reserved for rows that hold no such point is given back.
        points.resize((count, 3), refcheck=False)
        taken.resize(count, refcheck=False)
        return points, taken


class NearestPoint:
    """Finds the nearest point of a cloud: SciPy's k-d tree, exact, in float64.

    Parameters
    ----------
    points : (n, 3) float64 array
        At least one; not copied.
    """

    def __init__(self, points: NDArray[np.float64]) -> None:
        self._tree: Any = cKDTree(points, balanced_tree=False)
        self._threads = available_cores("auto")

    def distances(
        self, queries: NDArray[np.float64], at_most: float = np.inf
    ) -> NDArray[np.float64]:
        """Return the distance from each query to its nearest point.

        Parameters
        ----------
        queries : (m, 3) float64 array
        at_most : float
            Where nothing is as near as this, the distance returned is infinite.

        Returns
        -------
        (m,) float64 array
        """
        return self.find(queries, at_most)[0]

    def find(
        self, queries: NDArray[np.float64], at_most: float = np.inf
    ) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
        """Return the distances as `distances` does, and the index of each nearest point."""
        # SciPy finds what is nearer than the bound, and squares it; here the bound itself counts.
        bound = max(at_most, _LEAST_BOUND) * (1 + 1e-12)
        distances, indices = self._tree.query(
            queries, distance_upper_bound=bound, workers=self._threads
        )
        return np.where(distances <= at_most, distances, np.inf), indices


def look_up(
    cloud: Cloud,
    nearest: NearestPoint,
    observer: Observer,
    stage: str,
    at_most: float = np.inf,
) -> Iterator[tuple[NDArray[np.intp], NDArray[np.float64], NDArray[np.intp]]]:
    """Look up every point of a cloud, batch by batch, in the tree of another.

    Yields
    ------
    rows : (n,) int array
    distances : (n,) float64 array
        As `NearestPoint.find` gives them, with the indices.
    indices : (n,) int array
    """
    observer.stage(stage, cloud.row_count)
    done = 0
    for rows, xyz in cloud.batches():
        yield (rows, *nearest.find(xyz, at_most))
        if len(rows):
            observer.advance(int(rows[-1]) + 1 - done)
            done = int(rows[-1]) + 1
    observer.advance(cloud.row_count - done)
