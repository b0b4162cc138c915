"""The plan of a run: its tiles, and what they will take, before any of it is done."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.ground.reach import points_around
from pipeline.configuration.quantities import in_time, in_units
from pipeline.configuration.run import Configuration
from pipeline.errors import PlanError
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
from tiling.collection import MapCollection
from tiling.kept_points import bytes_kept
from tiling.layout import Layout, quadtree
from tiling.occupancy import Occupancy, count_within
from tiling.survey import Survey

_PIECE_BYTES = 32
"""A point of a tile, core or halo, until all chunks are gathered."""

_CHUNK_BYTES = {"parquet": 24, "las": 40, "laz": 40}
"""The same in chunks, at most."""

_COLUMN_BYTES, _LABEL_BYTES = 26, 18
"""A point of the map in what tasks keep of it once the pieces are gone, at most: columns; later,
when these are gone too, densities and labels."""

_SCORE_BYTES = 40
"""More, where scores are written."""

_EVIDENCE_BYTES = 245
"""More, where evidence is weighed, at most: spread, terms that are kept, voxels."""

_SAMPLE_BYTES, _SAMPLED = 80, 300_000
"""A point, of so many, that clusters are fitted on or that the report shows."""

_MICROSECONDS_A_POINT = 8.0
"""Of the core; on one worker of a machine of 2023."""

_MICROSECONDS_A_HALO_POINT = 3.0

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
    """How a map is cut, and what that takes.

    Attributes
    ----------
    point_count : int
        Points of the map.
    layout : Layout
    max_points : int
        That the core of a tile may have.
    halo : float
        Metres.
    held : (T,) int64 array
        Points in core and halo of each tile, to the nearest lattice column.
    workers : int
    worker_memory : int
        Bytes that a worker takes at most, projected.
    disk : int
        Bytes of temporary files at most, projected; the outputs not counted.
    output_size : int
        Bytes of the outputs, about.
    seconds : float
        Time of the run, projected roughly.
    """

    point_count: int
    layout: Layout
    max_points: int
    halo: float
    held: NDArray[np.int64]
    workers: int
    worker_memory: int
    disk: int
    output_size: int
    seconds: float

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
    collection: MapCollection, survey: Survey, configuration: Configuration, workers: int
) -> Plan:
    """Plan how a map is cut.

    Parameters
    ----------
    collection : MapCollection
    survey : Survey
        Of the whole map.
    configuration : Configuration
    workers : int
        That will share the work.

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
    later = _LABEL_BYTES + (_EVIDENCE_BYTES if weighs else 0)
    later += _SCORE_BYTES if configuration.output.needs_scores else 0
    chunks = all_held * _CHUNK_BYTES[configuration.tiling.format]
    later = core * later + min(core, _SAMPLED) * _SAMPLE_BYTES
    most = max(all_held * _PIECE_BYTES, core * _COLUMN_BYTES, later)
    disk = chunks + most + bytes_kept(collection)
    seconds = core * _MICROSECONDS_A_POINT + (all_held - core) * _MICROSECONDS_A_HALO_POINT
    return Plan(
        point_count=survey.point_count,
        layout=layout,
        max_points=max_points,
        halo=halo,
        held=held,
        workers=workers,
        worker_memory=BASE_BYTES + each * int(held.max(initial=0)),
        disk=disk,
        output_size=output_size(collection, configuration),
        seconds=seconds / 1e6 / workers,
    )


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
    """Count the points in core and halo of each tile, about; those of a column lie evenly in it.

    Returns
    -------
    (T,) int64 array
    """
    columns, share = divmod(halo, occupancy.cell)
    inner, outer = (
        count_within(occupancy, layout.low - margin, layout.high + margin)
        for margin in (columns * occupancy.cell, (columns + 1) * occupancy.cell)
    )
    return inner + ((outer - inner) * (share / occupancy.cell)).astype(np.int64)


def check_plan(plan: Plan, configuration: Configuration, folder: Path) -> None:
    """Refuse a plan that cannot be carried out here.

    Parameters
    ----------
    plan : Plan
    configuration : Configuration
    folder : Path
        Where results and temporary files will lie; it need not be there yet.

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
