"""What is kept of the scores of a tile: by row, and the densities of each cluster in order."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.selection import ScoredPoints
from pipeline.tiles.ground import OWN_ROWS
from pipeline.tiles.job import Job

_BY_ROW = ("cluster", "density")
_ORDERED, _STARTS = "ordered", "starts"

_MOST_MAPPED = 30_000
"""Files looked into at a time, of the 65,530 that Linux allows; more are opened again and again."""


def save_scores(
    job: Job,
    tile: int,
    scored: ScoredPoints,
    centroids: NDArray[np.float64],
    more: Mapping[str, NDArray[Any]],
) -> None:
    """Keep the scores of a tile, the centroids of its clusters, and what else is to be kept."""
    members = (scored.cluster == cluster for cluster in range(len(centroids)))
    ordered = [np.sort(scored.density[of_cluster]) for of_cluster in members]
    kept: dict[str, NDArray[Any]] = {name: getattr(scored, name) for name in _BY_ROW}
    kept[_ORDERED] = np.concatenate([np.empty(0), *ordered])
    kept[_STARTS] = np.cumsum([0, *map(len, ordered)])
    job.work.save("density", tile, centroids=centroids, **kept, **more)


def scored_points(job: Job, tile: int) -> ScoredPoints:
    """Return the scores of a tile."""
    scores = job.work.load("density", tile, *_BY_ROW)
    return ScoredPoints(*scores, *job.work.load("ground", tile, OWN_ROWS))


class KeptScores:
    """The scores of a tile as `pipeline.selection.find_cuts` looks them up."""

    def __init__(self, job: Job, tile: int) -> None:
        self._job = job
        self._tile = tile
        self._mapped: tuple[NDArray[np.float64], NDArray[np.int64]] | None = None

    def ordered(self, cluster: int) -> NDArray[np.float64]:
        """Return the densities of its points in a cluster, ascending: infinite and NaN last."""
        ordered, starts = self._mapped or self._open()
        return ordered[starts[cluster] : starts[cluster + 1]]

    def rows_at(self, cluster: int, density: float) -> NDArray[np.int64]:
        """Return the row numbers of its points in a cluster that have just this density."""
        scored = scored_points(self._job, self._tile)
        tied = (scored.cluster == cluster) & (scored.density == density)
        return np.asarray(scored.rows[tied])

    def _open(self) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        ordered = self._job.work.map("density", self._tile, _ORDERED)
        (starts,) = self._job.work.load("density", self._tile, _STARTS)
        if self._tile < _MOST_MAPPED:
            self._mapped = ordered, starts
        return ordered, starts
