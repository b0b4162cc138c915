"""The ground-free points of each tile, for the tiles around, which read only what is near them."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pipeline.tiles.nearest import FreePoints
from pipeline.work.job import Job
from tiling.sorted_points import Near, read_near, write_sorted_points

_STAGE, _SUFFIX = "free", ".parquet"


def save_free_points(job: Job, tile: int, points: FreePoints) -> None:
    """Keep the ground-free points of a tile's core for the tiles around."""
    job.work.make(_STAGE)
    write_sorted_points(job.work.path(_STAGE, tile, _SUFFIX), points.xyz, points.rows)


class TilesAround:
    """The ground-free points of all tiles but one, from their files; see `borders.OtherTiles`."""

    def __init__(self, job: Job, tile: int | None) -> None:
        self._job = job
        self._layout = job.store.layout
        self._tile = tile

    def near(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Sequence[int]:
        """Return the other tiles whose core meets a box."""
        tiles: list[int] = self._layout.near(low, high).tolist()
        return [tile for tile in tiles if tile != self._tile]

    def box(self, tile: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the core of a tile."""
        return self._layout.low[tile], self._layout.high[tile]

    def free_points(self, tile: int, near: Near) -> FreePoints:
        """Return the ground-free points of a tile's core that are near, and some around them."""
        return FreePoints(*read_near(self._job.work.path(_STAGE, tile, _SUFFIX), near))
