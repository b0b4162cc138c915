"""The task that takes the ground off one tile."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.algorithm import set_ground_aside
from dynahull.clustering import sample_rows
from dynahull.labels import Label
from dynahull.progress import SilentObserver
from pipeline.outputs.map_sample import is_sampled
from pipeline.tiles.borders import Region
from pipeline.tiles.division import divided
from pipeline.tiles.nearest import FreePoints
from pipeline.tiles.weighing import unscored_voxels
from pipeline.work.files import open_rows
from pipeline.work.folder import TaskReport
from pipeline.work.job import Job
from tiling.chunk_store import Chunk, joined
from tiling.chunks import assemble, has_chunk, read_chunk, read_cores
from tiling.layout import Layout
from tiling.ledger import note_file

LABEL_NAMES = ("core_rows", "core_labels")
OWN_ROWS = "own_rows"
OWN_NAMES = ("own_xyz", OWN_ROWS)
AROUND_NAMES = ("around_xyz", "around_rows")
SAMPLE_NAMES = ("sample_xyz", "sample_rows")
SHOWN_NAMES = ("shown_xyz", "shown_rows")


def find_ground(job: Job, tile: int, sides: int = 1) -> TaskReport:
    """Label the ground of a tile's core, and keep the ground-free points of its region.

    Its points are gathered into its chunk first, if that is not there yet.

    Kept as well are those of its points that the clusters are fitted on, and those that the report
    shows. Where the memory does not suffice for the tile, `sides` x `sides` parts of it are done
    one after the other. The report counts the ground-free points, and those of the ground.
    """
    chunk = _surroundings(job, tile)
    boxes = divided(region_of(job, tile), chunk.xyz, sides)
    parts = [_labelled(job, chunk, box, sides) for box in boxes]
    decided, labels, heights = parts[0]
    if len(parts) > 1:
        decided = joined([part for part, _, _ in parts])
        order = np.argsort(decided.rows)
        decided = decided.select(order)
        labels = np.concatenate([of_part for _, of_part, _ in parts])[order]
        heights = np.concatenate([of_part for _, _, of_part in parts])[order]
    free = labels == Label.STATIC
    core_rows = decided.rows[decided.core]
    own, around = decided.select(free & decided.core), decided.select(free & ~decided.core)
    core_count = len(core_rows)
    parameters = job.configuration.clustering
    total = core_count if parameters.scope == "tile" else job.finite_count
    sample = sample_rows(own.rows, total, parameters)
    arrays: dict[str, NDArray[Any]] = {
        "core_rows": core_rows,
        "core_labels": labels[decided.core],
        "own_xyz": own.xyz,
        "own_rows": own.rows,
        "around_xyz": around.xyz,
        "around_rows": around.rows,
        "sample_xyz": own.xyz[sample],
        "sample_rows": own.rows[sample],
    }
    if job.configuration.removal.weighs_evidence:
        arrays["own_height"] = heights[free & decided.core]
        arrays |= unscored_voxels(decided.xyz[~free & decided.core])
    if job.configuration.output.report == "html":
        shown = np.flatnonzero(decided.core)
        shown = shown[is_sampled(core_rows, job.collection.point_count)]
        arrays |= {"shown_xyz": decided.xyz[shown], "shown_rows": decided.rows[shown]}
    job.work.save("ground", tile, **arrays)
    ground = int(np.count_nonzero(arrays["core_labels"] == Label.GROUND))
    return TaskReport(core_count, (len(own), ground))


def _labelled(
    job: Job, chunk: Chunk, box: Region, sides: int
) -> tuple[Chunk, NDArray[np.uint8], NDArray[np.float64]]:
    """Return the points of a box, their labels and heights; `chunk` holds all that decide."""
    points = chunk
    if sides > 1:
        flat, radius = chunk.xyz[:, :2], job.decision_radius
        near = (flat >= box.low - radius) & (flat <= box.high + radius)
        points = chunk.select(np.flatnonzero(near.all(axis=1)))
    classes = None
    if job.needs_classes:
        classes = open_rows(job.rows_path("class"), np.uint8)[points.rows]
    every = np.ones(len(points), np.bool_)
    parameters = job.configuration.method()
    aside = set_ground_aside(points.xyz, every, parameters, classes, SilentObserver())
    labels = np.full(len(points), Label.STATIC, np.uint8)
    labels[aside.ground], labels[aside.above] = Label.GROUND, Label.ABOVE
    inside = box.holds(points.xyz)
    return points.select(inside), labels[inside], aside.height[inside]


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
    if has_chunk(store, tile):
        chunk = read_chunk(store, tile)
        note_file(store.chunk_path(tile))  # what this task leaves, as if it had made it
    else:
        chunk = assemble(store, tile)
    if store.halo >= job.decision_radius:
        return chunk
    # The halo is too narrow: the rest comes from the tiles around.
    layout = store.layout
    low = layout.low[tile] - job.decision_radius
    high = layout.high[tile] + job.decision_radius
    near = layout.near(low, high)
    around = read_cores(store, near[near != tile].tolist(), low, high)
    around.core[:] = False
    together = joined([chunk.select(chunk.core), around])
    return together.select(np.argsort(together.rows))


def own_points(job: Job, tile: int) -> FreePoints:
    """Return the ground-free points of a tile's core, of which only what is looked at is read."""
    return FreePoints(*(job.work.map("ground", tile, name) for name in OWN_NAMES))


class TilesAround:
    """The ground-free points of all other tiles, from their files; see `borders.OtherTiles`.

    Parameters
    ----------
    job : Job
    tile : int or None
        The tile whose others these are; None for all tiles.
    """

    def __init__(self, job: Job, tile: int | None) -> None:
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
            self._latest[tile] = own_points(self._job, tile)
        return self._latest[tile]


_TILES_HELD = 2
"""Further tiles held in memory at a time: clusters and batches of one tile ask for the same."""
