"""The tasks that take the ground off one tile.

A tile reduces its columns once to what the ground step looks at from afar, and decides about its
own points by that of all tiles around: see `dynahull.ground`.
"""

from itertools import chain
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.clustering import sample_rows
from dynahull.ground.lattice import number_columns
from dynahull.ground.methods import ground_mask, ground_summary, height_above_floors, height_summary
from dynahull.ground.reach import decided_around, ground_radius, height_radius
from dynahull.ground.slope import GroundSummary
from dynahull.labels import Label
from dynahull.summary import Summary
from pipeline.tiles.borders import Region
from pipeline.tiles.free_points import save_free_points
from pipeline.tiles.nearest import FreePoints
from pipeline.work.files import open_rows
from pipeline.work.folder import TaskReport
from pipeline.work.job import SAMPLE, Job
from tiling.chunks import Chunk, read_chunk, read_rows

SAMPLE_NAMES = ("xyz", "rows")
LABELS = "labels"
_LEVELS, _OUTLINES, _FLOORS = "levels", "outlines", "floors"


def summarise_tile(job: Job, tile: int) -> TaskReport:
    """Summarise the columns of a tile: what the ground around is found by."""
    chunk = read_chunk(job.store, tile)
    levels, outlines = ground_summary(chunk.xyz, chunk.core, job.configuration.ground)
    kept = levels.to_arrays(_LEVELS) | outlines.to_arrays(_OUTLINES)
    job.work.save("columns", tile, **kept)
    return TaskReport(int(job.store.layout.counts[tile]))


def find_ground(job: Job, tile: int, sides: int = 1) -> TaskReport:
    """Label the ground of a tile's region, and summarise what heights above it are told by.

    Where the memory does not suffice for the tile, its columns are done in `sides` x `sides` parts,
    one after the other. The report counts the points of the core that are ground.
    """
    chunk = read_chunk(job.store, tile)
    ground = _ground_of(job, tile, chunk, sides)
    labels = np.full(len(chunk), Label.INVALID, np.uint8)
    known = region_of(job, tile).holds(chunk.xyz)
    labels[known] = np.where(ground[known], Label.GROUND, Label.STATIC)
    arrays: dict[str, NDArray[Any]] = {LABELS: labels}
    if job.configuration.needs_heights:
        of_ground = chunk.select(labels == Label.GROUND)
        floors = height_summary(of_ground.xyz, of_ground.core, job.configuration.ground)
        arrays |= floors.to_arrays(_FLOORS)
    if job.labelling == "ground":
        _save_scored(job, tile, _own(chunk, labels))
    job.work.save("ground", tile, **arrays)
    count = int(job.store.layout.counts[tile])
    return TaskReport(count, (int(np.count_nonzero(ground & chunk.core)),))


def find_high(job: Job, tile: int) -> TaskReport:
    """Label what is higher above the ground than is scored, in a tile's region."""
    chunk = read_chunk(job.store, tile)
    (labels,) = job.work.load("ground", tile, LABELS)
    free = np.flatnonzero(labels == Label.STATIC)
    limit = job.configuration.max_height
    height = heights_of(job, tile, chunk.xyz[free])
    labels[free[height > (np.inf if limit is None else limit)]] = Label.ABOVE
    _save_scored(job, tile, _own(chunk, labels))
    job.work.save("height", tile, **{LABELS: labels})
    return TaskReport(int(job.store.layout.counts[tile]))


def _ground_of(job: Job, tile: int, chunk: Chunk, sides: int) -> NDArray[np.bool_]:
    """Tell which points of a chunk are ground, as far as they decide it."""
    parameters = job.configuration.ground
    classes = None
    if job.needs_classes:
        classes = open_rows(job.rows_path("class"), np.uint8)[chunk.rows]
    if parameters.method != "slope":
        return ground_mask(chunk.xyz, parameters, classes)
    radius = ground_radius(parameters)
    assert radius is not None  # what looks at the map as a whole is not cut
    around = GroundSummary(*_around(job, "columns", tile, radius, _LEVELS, _OUTLINES))
    if sides == 1:
        return ground_mask(chunk.xyz, parameters, around=around)
    ground = np.zeros(len(chunk), np.bool_)
    numbers, _ = number_columns(chunk.xyz, parameters.slope.expert.cell)
    for part in range(sides**2):
        own = np.flatnonzero(numbers % sides**2 == part)
        ground[own] = ground_mask(chunk.xyz.take(own, axis=0), parameters, around=around)
    return ground


def heights_of(job: Job, tile: int, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return heights above the ground of points of a tile's region, metres."""
    ground = job.configuration.ground
    (floors,) = _around(job, "ground", tile, height_radius(ground), _FLOORS)
    return height_above_floors(xyz, floors, ground)


def _around(job: Job, stage: str, tile: int, radius: float, *names: str) -> list[Summary]:
    """Return what tiles say of the cells within a radius of a tile's region."""
    layout, cell = job.store.layout, job.configuration.ground.slope.expert.cell
    low = layout.low[tile] - (job.store.halo + radius)
    high = layout.high[tile] + (job.store.halo + radius)
    parts = [
        [
            each.within(low / cell - 1, high / cell + 1)
            for each in summaries(job, stage, near, *names)
        ]
        for near in layout.near(low, high).tolist()
    ]
    return [Summary.joined(of_name) for of_name in zip(*parts, strict=True)]


def summaries(job: Job, stage: str, tile: int, *names: str) -> list[Summary]:
    """Return what a task kept by `Summary.to_arrays`, by their names."""
    arrays = job.work.load(stage, tile, *chain.from_iterable(map(Summary.names, names)))
    return [Summary(*pair) for pair in zip(arrays[::2], arrays[1::2], strict=True)]


def _save_scored(job: Job, tile: int, points: FreePoints) -> None:
    """Keep the points of a core that are scored, and those that clusters are fitted on."""
    parameters = job.configuration.clustering
    in_core = int(job.store.layout.counts[tile])
    total = in_core if parameters.scope == "tile" else job.finite_count
    chosen = sample_rows(points.rows, total, parameters)
    save_free_points(job, tile, points)
    job.work.make(SAMPLE)
    job.work.save(SAMPLE, tile, xyz=points.xyz[chosen], rows=points.rows[chosen])


def region_of(job: Job, tile: int) -> Region:
    """Return where a tile knows all ground-free points: its core, and what its halo decides.

    It has no end where the map has none beyond.
    """
    layout = job.store.layout
    margin = decided_around(job.configuration.ground, job.store.halo, layout.cell)
    low, high = layout.low[tile] - margin, layout.high[tile] + margin
    return Region(
        np.where(low <= layout.low.min(axis=0), -np.inf, low),
        np.where(high >= layout.high.max(axis=0), np.inf, high),
    )


def labelled_points(job: Job, tile: int) -> tuple[Chunk, NDArray[np.uint8]]:
    """Return the points of a tile, core and halo, and what is known of them before the scoring.

    What is labelled static is scored; what is labelled invalid is not known here.
    """
    (labels,) = job.work.load(job.labelling, tile, LABELS)
    return read_chunk(job.store, tile), labels


def own_points(job: Job, tile: int) -> FreePoints:
    """Return the ground-free points of a tile's core."""
    return _own(*labelled_points(job, tile))


def own_rows(job: Job, tile: int) -> NDArray[np.int64]:
    """Return the row numbers of `own_points`."""
    (labels,) = job.work.load(job.labelling, tile, LABELS)
    rows, core = read_rows(job.store, tile)
    return np.asarray(rows[core & (labels == Label.STATIC)])


def _own(chunk: Chunk, labels: NDArray[np.uint8]) -> FreePoints:
    own = np.flatnonzero(chunk.core & (labels == Label.STATIC))
    return FreePoints(chunk.xyz.take(own, axis=0), chunk.rows.take(own))
