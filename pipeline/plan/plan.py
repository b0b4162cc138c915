"""The plan of a run: its tiles, and what they will take, before any of it is done."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.evidence.range_images import HELD_BYTES
from dynahull.ground.reach import points_around
from pipeline.configuration.quantities import in_time, in_units
from pipeline.configuration.run import Configuration
from pipeline.errors import PlanError
from pipeline.outputs.map_sample import MOST_POINTS
from pipeline.plan.resources import (
    BASE_BYTES,
    EVIDENCE_BYTES,
    TILE_BYTES,
    check_space,
    more_memory,
    output_size,
    tile_budget,
    worker_memory_limit,
)
from pipeline.showing import drawing_library
from tiling.collection import MapCollection
from tiling.kept_points import bytes_kept
from tiling.layout import Layout, quadtree
from tiling.output_file import atomic_file
from tiling.survey import Occupancy, Survey, count_within

_PIECE_BYTES = 32
"""A point of a tile, core or halo, until all chunks are gathered."""

_CHUNK_BYTES = {"parquet": 24, "las": 40, "laz": 40}
"""The same in chunks, at most."""

_COLUMN_BYTES, _DENSITY_BYTES, _LABEL_BYTES, _ROWS_BYTES = 8, 12, 2, 17
"""A point of the map in what tasks keep of it once the pieces are gone, at most: columns; cluster
and density; labels; the files of scores by row, where they are written."""

_FREE_BYTES, _FREE_BYTES_OF_LAZ = 33, 20
"""A ground-free point until the densities are found, at most; coordinates of LAZ compress."""

_SPREAD_BYTES, _EVIDENCE_BYTES, _SCORE_BYTES = 32, 18, 5
"""A point where evidence is weighed, at most: spread and sums over voxels; what the first look
leaves; score and reason. All is compressed; these are the most of the maps measured."""

_SCAN_BYTES = 20
"""More, where scans are known, at most: their numbers, returns, marks, and further terms."""

_FITTED_BYTES, _SHOWN_BYTES = 32, 24
"""A point that clusters are fitted on; one that the report shows."""

_MICROSECONDS_A_POINT = 8.0
"""Of the core; on one worker of a machine of 2023."""

_MICROSECONDS_A_HALO_POINT = 3.0

_MICROSECONDS_A_TILE = 50_000.0
"""Of all stages together, whatever the tile holds."""

_SPARSE_SHARE = 0.25
"""Share of the points, in the sparsest columns, that the halo is not made for."""

_WIDEST_REACH = 2.0
"""Metres of halo, at most: points that need more are finished from other tiles."""

_STEP = 1 / 16
"""Metres: the halo is a multiple of it, as of the smallest cells that the ground step looks at."""

_HALO_SHARE = 0.15
"""Points of halos, at most, to points of cores: what more would cost is read from other tiles."""


@dataclass(frozen=True, slots=True)
class Plan:
    """How a map is cut, and what that takes."""

    point_count: int
    """Points of the map."""
    layout: Layout
    max_points: int
    """That the core of a tile may have."""
    halo: float
    """Metres."""
    held: NDArray[np.int64]
    """(T,): points in core and halo of each tile, to the nearest lattice column."""
    workers: int
    worker_memory: int
    """Bytes that a worker takes at most, projected."""
    disk: int
    """Bytes of temporary files at most, projected; the outputs not counted."""
    output_size: int
    """Bytes of the outputs, about."""
    seconds: float
    """Time of the run, projected roughly."""

    def figures(self) -> dict[str, Any]:
        """Return what `plan --json` prints: points, metres, bytes and seconds."""
        counts = self.layout.counts
        return {
            "points": self.point_count,
            "tiles": len(counts),
            "largest_tile_points": int(counts.max(initial=0)),
            "halo_metres": self.halo,
            "points_read": int(self.held.sum()),
            "workers": self.workers,
            "worker_memory_bytes": self.worker_memory,
            "temporary_bytes": self.disk,
            "output_bytes": self.output_size,
            "seconds": round(self.seconds, 1),
        }

    def to_text(self) -> str:
        """Return the lines that `plan` prints."""
        counts = self.layout.counts
        core = int(counts.sum())
        share = self.held.sum() / core - 1 if core else 0.0
        sizes = (
            f"{counts.min():,} to {counts.max():,} points, median {int(np.median(counts)):,}"
            if len(counts)
            else "no points"
        )
        return "\n".join(
            [
                f"points:            {self.point_count:,}",
                f"tiles:             {len(counts):,} ({sizes})",
                f"halo:              {self.halo:.2f} m, {100 * share:.0f} % more points to read",
                f"workers:           {self.workers}",
                f"memory a worker:   {in_units(self.worker_memory)}, at most",
                f"temporary files:   {in_units(self.disk)}, at most",
                f"outputs:           about {in_units(self.output_size)}",
                f"time:              about {in_time(self.seconds)}",
            ]
        )


def make_plan(
    collection: MapCollection,
    survey: Survey,
    configuration: Configuration,
    workers: int,
    *,
    scans_known: bool = False,
) -> Plan:
    """Plan how a map is cut, by the survey of all of it, for so many workers to share the work.

    Parameters
    ----------
    scans_known : bool
        Whether the evidence asks the range images of scans.

    Raises
    ------
    PlanError
        When a lattice column alone holds more points than a worker has memory for.
    """
    occupancy, wanted = survey.occupancy, configuration.tiling.halo
    needed = points_around(configuration.ground, configuration.needs_heights, occupancy.cell)
    max_points = tile_budget(collection, configuration, workers)
    layout = quadtree(occupancy, max_points)
    if wanted == "auto":
        wanted = halo_width(layout, occupancy, configuration.neighbours.k)
    halo = max(wanted, needed)
    held = points_held(layout, occupancy, halo)
    core, all_held = int(layout.counts.sum()), int(held.sum())
    weighs = configuration.removal.weighs_evidence
    each = TILE_BYTES + (EVIDENCE_BYTES if weighs else 0)
    images = HELD_BYTES if scans_known else 0
    disk = _disk_of(collection, configuration, core, all_held, len(held), scans_known)
    seconds = core * _MICROSECONDS_A_POINT + (all_held - core) * _MICROSECONDS_A_HALO_POINT
    seconds += len(held) * _MICROSECONDS_A_TILE
    return Plan(
        point_count=survey.point_count,
        layout=layout,
        max_points=max_points,
        halo=halo,
        held=held,
        workers=workers,
        worker_memory=BASE_BYTES + images + each * int(held.max(initial=0)),
        disk=disk,
        output_size=output_size(collection, configuration),
        seconds=seconds / 1e6 / workers,
    )


def _disk_of(
    collection: MapCollection,
    configuration: Configuration,
    core: int,
    all_held: int,
    tiles: int,
    scans_known: bool,
) -> int:
    """Return the bytes that temporary files take at most, in the stage that most lie there."""
    decoded = bytes_kept(collection)
    clustering = configuration.clustering
    samples = tiles if clustering.scope == "tile" else 1
    fitted = min(core, samples * clustering.sample) * _FITTED_BYTES
    weighs = configuration.removal.weighs_evidence
    spread, evidence, score = (
        each if weighs else 0 for each in (_SPREAD_BYTES, _EVIDENCE_BYTES, _SCORE_BYTES)
    )
    rows = _ROWS_BYTES if configuration.output.needs_scores else 0
    shown = min(core, MOST_POINTS) * _SHOWN_BYTES if configuration.output.report == "html" else 0
    free = _FREE_BYTES_OF_LAZ if decoded else _FREE_BYTES
    most = max(
        all_held * _PIECE_BYTES,
        core * (_COLUMN_BYTES + free) + fitted,
        core * (free + spread + _DENSITY_BYTES) + (fitted if clustering.scope == "tile" else 0),
        core * (spread + evidence + _DENSITY_BYTES),
        core * (evidence + _DENSITY_BYTES + _LABEL_BYTES + score + rows) + shown,
    )
    if scans_known:
        most += core * _SCAN_BYTES
    return decoded + all_held * _CHUNK_BYTES[configuration.tiling.format] + most


def halo_width(layout: Layout, occupancy: Occupancy, k: int) -> float:
    """Return how wide halos are, metres: as most neighbours need, if that costs few more points."""
    core = int(layout.counts.sum())
    steps = int(np.ceil(neighbour_reach(occupancy, k) / _STEP))
    while steps:
        held = points_held(layout, occupancy, steps * _STEP)
        if held.sum() <= (1 + _HALO_SHARE) * core:
            break
        steps -= 1
    return steps * _STEP


def neighbour_reach(occupancy: Occupancy, k: int) -> float:
    """Estimate how far the k-th neighbour of most points is, metres.

    A column's points are taken to be spread evenly over its ground plan.
    """
    if not len(occupancy.counts):
        return 0.0
    counts = np.sort(occupancy.counts)
    below = np.cumsum(counts)
    at = int(np.searchsorted(below, _SPARSE_SHARE * below[-1]))
    a_square_metre = counts[at] / occupancy.cell**2
    return float(min(np.sqrt(k / (np.pi * a_square_metre)), _WIDEST_REACH))


def points_held(layout: Layout, occupancy: Occupancy, halo: float) -> NDArray[np.int64]:
    """Count the points of each tile, (T,), about: core and halo; a column's lie evenly in it."""
    columns, share = divmod(halo, occupancy.cell)
    inner, outer = (
        count_within(occupancy, layout.low - margin, layout.high + margin)
        for margin in (columns * occupancy.cell, (columns + 1) * occupancy.cell)
    )
    return inner + ((outer - inner) * (share / occupancy.cell)).astype(np.int64)


def check_plan(plan: Plan, configuration: Configuration, folder: Path) -> None:
    """Refuse a plan that cannot be carried out in a folder, which need not be there yet.

    Raises
    ------
    PlanError
        In one line: what it takes, what there is, and what to change.
    """
    memory = worker_memory_limit(configuration, plan.workers)
    if plan.worker_memory > memory:
        largest = int(plan.held.max())
        raise PlanError(
            f"a worker would take {in_units(plan.worker_memory)} for the largest tile "
            f"({largest:,} points with its halo) and has {in_units(memory)}: "
            f"choose a smaller tiling.max_points or tiling.halo, or {more_memory(configuration)}"
        )
    check_space(folder, plan.disk, plan.output_size, configuration.output.keep_free)


def draw_plan(plan: Plan, survey: Survey, path: Path) -> None:
    """Draw the tiles over the map's occupancy, seen from above, into a PNG.

    Raises
    ------
    MissingPackageError
        When Matplotlib, of the extra `plot`, is not installed.
    """
    mpl = drawing_library()
    figure = mpl.figure.Figure(figsize=(9, 9), layout="constrained")
    axes = figure.add_subplot()
    occupancy = survey.occupancy
    corners = occupancy.columns * occupancy.cell
    if len(corners):
        image, extent = _occupancy_image(occupancy)
        axes.imshow(image, extent=extent, origin="lower", cmap="Greys", interpolation="nearest")

    def outline(low: NDArray[np.float64], high: NDArray[np.float64], **style: str) -> None:
        axes.add_patch(mpl.patches.Rectangle(low, *(high - low), fill=False, **style))

    for tile in plan.layout:
        outline(tile.low, tile.high, edgecolor="tab:blue")
    if len(plan.layout):
        largest = plan.layout[int(np.argmax(plan.layout.counts))]
        low, high = largest.low - plan.halo, largest.high + plan.halo
        outline(low, high, edgecolor="tab:red", linestyle="--")
        axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.set_title(
        f"{plan.point_count:,} points, {len(plan.layout):,} tiles (blue); "
        f"halo {plan.halo:.2f} m around the largest (red)"
    )
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")


def _occupancy_image(occupancy: Occupancy) -> tuple[NDArray[np.float64], Sequence[float]]:
    """Return logarithms of counts as a raster of at most some thousand pixels a side."""
    low, high = occupancy.columns.min(axis=0), occupancy.columns.max(axis=0) + 1
    step = max(1, int(np.ceil((high - low).max() / 1_000)))
    at = (occupancy.columns - low) // step
    width, height = (-(-(high - low) // step)).tolist()
    image = np.zeros((height, width))
    np.add.at(image, (at[:, 1], at[:, 0]), occupancy.counts)
    low_x, low_y = (low * occupancy.cell).tolist()
    side = step * occupancy.cell
    return np.log1p(image), (low_x, low_x + width * side, low_y, low_y + height * side)
