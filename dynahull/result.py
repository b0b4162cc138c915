"""What the method returns: labels, densities, clusters, and what Eq. 1 made of them."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.checking import cloud_points
from dynahull.errors import InvalidPointsError
from dynahull.labels import Label

NO_CLUSTER = -1
"""The cluster of points that were not clustered."""


@dataclass(frozen=True, slots=True)
class ClusterSummary:
    """What Eq. 1 made of one cluster.

    Attributes
    ----------
    index : int
        The cluster, as in `CleaningResult.cluster`.
    centroid : tuple of float
        x, y, z in the coordinates of the map.
    count : int
        N_i, points in the cluster.
    percentage : float
        R_i, the share to remove, in percent.
    threshold : float or None
        Density of the densest point removed (`rank`), or the threshold reached (`stepped`).
    removed : int
        Points removed.
    """

    index: int
    centroid: tuple[float, float, float]
    count: int
    percentage: float
    threshold: float | None
    removed: int


@dataclass(frozen=True, slots=True)
class CleaningResult:
    """The labels of a map, and what they were decided from.

    Attributes
    ----------
    labels : (N,) uint8 array
        A `Label` for every point.
    density : (N,) float64 array
        Points per cubic metre; infinite where the hull has no volume, NaN where not scored.
    cluster : (N,) int32 array
        Index of the cluster, -1 where not clustered.
    score : (N,) float32 array
        Probability of having moved, by the evidence; NaN where not scored, or not weighed.
    reason : (N,) uint8 array
        Which of `dynahull.evidence.reasons.REASONS` speaks most for a ghost; 255 where none does.
    protected : (N,) bool array
        Which points were not to be removed.
    clusters : tuple of ClusterSummary
        One for each cluster, in the order of their indices.
    """

    labels: NDArray[np.uint8]
    density: NDArray[np.float64]
    cluster: NDArray[np.int32]
    score: NDArray[np.float32]
    reason: NDArray[np.uint8]
    protected: NDArray[np.bool_]
    clusters: tuple[ClusterSummary, ...]

    @property
    def kept(self) -> NDArray[np.bool_]:
        """The points that stay in the map: all but the dynamic ones, as an (N,) mask."""
        return np.asarray(self.labels != Label.DYNAMIC)

    @property
    def indices(self) -> NDArray[np.int64]:
        """The rows that stay, ascending: for Open3D's `select_by_index`."""
        return np.flatnonzero(self.kept)

    def cleaned(self, given: Any) -> Any:
        """Return what was cleaned without its ghosts, with all that it holds beside coordinates.

        Parameters
        ----------
        given : as given to `clean`
            A cloud of Open3D, data of laspy, a table, a tensor or an array; a list gives an array.

        Raises
        ------
        InvalidPointsError
            When it has another number of points.
        """
        found = len(given.points if hasattr(given, "points") else cloud_points(given))
        if found != len(self.labels):
            raise InvalidPointsError(
                f"given: expected the {len(self.labels)} points that were cleaned, found {found}"
            )
        if hasattr(given, "select_by_index"):
            return given.select_by_index(self.indices.tolist())
        if hasattr(type(given), "xyz") and hasattr(given, "points"):
            return type(given)(given.header, given.points[self.kept])
        return (np.asarray(given) if isinstance(given, list | tuple) else given)[self.kept]

    @property
    def removal_percentages(self) -> NDArray[np.float64]:
        """R_i of every cluster, in percent."""
        return np.array([cluster.percentage for cluster in self.clusters])

    def counts(self) -> dict[str, int]:
        """Return the number of points of each label, by its name."""
        numbers = np.bincount(self.labels, minlength=len(Label))
        return {label.title: int(numbers[label]) for label in Label}
