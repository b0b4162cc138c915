"""The task that takes the ground off one tile."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.algorithm import set_aside_labels, set_ground_aside, valid_points
from dynahull.clustering import sample_rows
from dynahull.labels import Label
from dynahull.progress import SilentObserver
from pipeline.borders import FreePoints, Region
from pipeline.tiles.job import Job
from pipeline.tiles.rows import open_rows
from pipeline.tiles.work import TaskReport
from tiling.chunk_store import Chunk
from tiling.chunks import read_chunk, read_cores
from tiling.layout import Layout

LABEL_NAMES = ("core_rows", "core_labels")
FREE_NAMES = ("xyz", "rows", "core")
SAMPLE_NAMES = ("sample_xyz", "sample_rows")


def find_ground(job: Job, tile: int) -> TaskReport:
    """Label the ground of a tile's core, and keep the ground-free points of its region.

    Kept as well are those of its points that the clusters are fitted on.
    """
    chunk = _surroundings(job, tile)
    classes = None
    if job.needs_classes:
        classes = open_rows(job.rows_path("class"), np.uint8)[chunk.rows]
    valid = valid_points(chunk.xyz)
    parameters = job.configuration.method()
    ground, above = set_ground_aside(chunk.xyz, valid, parameters, classes, SilentObserver())
    labels = set_aside_labels(valid, ground, above)
    inside = region_of(job, tile).holds(chunk.xyz)
    free = chunk.select(inside & (labels == Label.STATIC))
    core_rows = chunk.rows[chunk.core]
    own = free.select(free.core)
    core_count = len(core_rows)
    total = core_count if parameters.clustering.scope == "tile" else job.finite_count
    sample = sample_rows(own.rows, total, parameters.clustering)
    arrays: dict[str, NDArray[Any]] = {
        "core_rows": core_rows,
        "core_labels": labels[chunk.core],
        "xyz": free.xyz,
        "rows": free.rows,
        "core": free.core,
        "sample_xyz": own.xyz[sample],
        "sample_rows": own.rows[sample],
    }
    job.work.save("ground", tile, **arrays)
    return TaskReport(core_count, (len(own),))


def region_of(job: Job, tile: int) -> Region:
    """Return where a tile knows all ground-free points: its core, and what its halo decides.

    It has no end where the map has none beyond.
    """
    layout = job.store.layout
    margin = max(job.store.halo - job.decision_radius, 0.0)
    low, high = layout.low[tile] - margin, layout.high[tile] + margin
    return Region(
        np.where(low <= layout.low.min(axis=0), -np.inf, low),
        np.where(high >= layout.high.max(axis=0), np.inf, high),
    )


def _surroundings(job: Job, tile: int) -> Chunk:
    """Return all points that decide which points of a tile's region are free of the ground."""
    store = job.store
    chunk = read_chunk(store, tile)
    if store.halo >= job.decision_radius:
        return chunk
    # The halo is too narrow: the rest comes from the chunks around.
    layout = store.layout
    low = layout.low[tile] - job.decision_radius
    high = layout.high[tile] + job.decision_radius
    near = layout.near(low, high)
    around = read_cores(store, near[near != tile].tolist(), low, high)
    around.core[:] = False
    parts = (chunk.select(chunk.core), around)
    together = Chunk(
        np.concatenate([part.xyz for part in parts]),
        np.concatenate([part.rows for part in parts]),
        np.concatenate([part.core for part in parts]),
    )
    return together.select(np.argsort(together.rows))


class TilesAround:
    """The ground-free points of all other tiles, from their files; see `borders.OtherTiles`.

    Parameters
    ----------
    job : Job
    tile : int
        The tile whose others these are.
    """

    def __init__(self, job: Job, tile: int) -> None:
        self._job = job
        self._layout: Layout = job.store.layout
        self._tile = tile
        self._latest: dict[int, FreePoints] = {}

    def near(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Sequence[int]:
        """Return the other tiles whose core meets a box."""
        tiles: list[int] = self._layout.near(low, high).tolist()
        return [tile for tile in tiles if tile != self._tile]

    def box(self, tile: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the core of a tile."""
        return self._layout.low[tile], self._layout.high[tile]

    def free_points(self, tile: int) -> FreePoints:
        """Return the ground-free points of a tile's core."""
        if tile not in self._latest:
            if len(self._latest) >= _TILES_HELD:
                self._latest.pop(next(iter(self._latest)))
            xyz, rows, core = self._job.work.load("ground", tile, *FREE_NAMES)
            self._latest[tile] = FreePoints(xyz[core], rows[core])
        return self._latest[tile]


_TILES_HELD = 2
"""Further tiles held in memory at a time: clusters and batches of one tile ask for the same."""
