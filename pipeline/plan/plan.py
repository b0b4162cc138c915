"""The plan of a run: its tiles, and what they will take, before any of it is done."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.ground.reach import decision_radius, ground_radius
from pipeline.configuration.quantities import in_time, in_units
from pipeline.configuration.run import Configuration
from pipeline.errors import PlanError
from pipeline.plan.resources import (
    BASE_BYTES,
    EVIDENCE_BYTES,
    TILE_BYTES,
    check_space,
    output_size,
    tile_budget,
    worker_memory_limit,
)
from tiling.collection import MapCollection
from tiling.kept_points import bytes_kept
from tiling.layout import Layout, quadtree
from tiling.occupancy import Occupancy, count_within
from tiling.survey import Survey

_BYTES_ON_DISK = 100
"""A point of a tile, core or halo, in pieces, chunks and ground-free points together."""

_SCORES_ON_DISK = 48
"""A point of the map: densities, labels, and what else is kept of each row."""

_EVIDENCE_ON_DISK = 300
"""A point of the map where evidence is weighed, at most: spread, terms that are kept, voxels."""

_MICROSECONDS_A_POINT = 8.0
"""Of the core; on one worker of a machine of 2023."""

_MICROSECONDS_A_HALO_POINT = 3.0

_WIDEST_REACH = 2.0
"""Metres of halo for neighbours, at most: points that need more are finished from other tiles."""

_SPARSE_SHARE = 0.1
"""Share of the points, in the sparsest columns, that the halo is not made for."""

_SMALLEST_REACH = 0.25
"""Metres of halo for neighbours, at least."""


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
    # A ground step that looks at the map as a whole does not look at tiles at all.
    radius = (
        0.0
        if ground_radius(configuration.ground) is None
        else decision_radius(configuration.ground, configuration.needs_heights)
    )
    halo = configuration.tiling.halo
    if halo == "auto":
        halo = radius + neighbour_reach(survey.occupancy, configuration.neighbours.k)
    around = max(halo, radius)
    max_points = tile_budget(collection, configuration, workers)
    layout = quadtree(survey.occupancy, max_points, around)
    held = points_held(layout, survey.occupancy, halo)
    gathered = held if around == halo else points_held(layout, survey.occupancy, around)
    core, all_held = int(layout.counts.sum()), int(held.sum())
    weighs = configuration.removal.weighs_evidence
    each = TILE_BYTES + (EVIDENCE_BYTES if weighs else 0)
    kept = _SCORES_ON_DISK + (_EVIDENCE_ON_DISK if weighs else 0)
    seconds = core * _MICROSECONDS_A_POINT + (all_held - core) * _MICROSECONDS_A_HALO_POINT
    return Plan(
        point_count=survey.point_count,
        layout=layout,
        max_points=max_points,
        halo=halo,
        held=held,
        workers=workers,
        worker_memory=BASE_BYTES + each * int(gathered.max(initial=0)),
        disk=all_held * _BYTES_ON_DISK + survey.point_count * kept + bytes_kept(collection),
        output_size=output_size(collection, configuration),
        seconds=seconds / 1e6 / workers,
    )


def neighbour_reach(occupancy: Occupancy, k: int) -> float:
    """Estimate how far the k-th neighbour of most points is, metres: the halo need not be wider.

    A column's points are taken to be spread evenly over its ground plan.
    """
    if not len(occupancy.counts):
        return _SMALLEST_REACH
    counts = np.sort(occupancy.counts)
    below = np.cumsum(counts)
    at = int(np.searchsorted(below, _SPARSE_SHARE * below[-1]))
    a_square_metre = counts[at] / occupancy.cell**2
    reach = float(np.sqrt(k / (np.pi * a_square_metre)))
    return float(np.clip(np.ceil(reach * 20) / 20, _SMALLEST_REACH, _WIDEST_REACH))


def points_held(layout: Layout, occupancy: Occupancy, halo: float) -> NDArray[np.int64]:
    """Count the points in core and halo of each tile, columns whose middle is there counting whole.

    Returns
    -------
    (T,) int64 array
    """
    return count_within(occupancy, layout.low - halo, layout.high + halo)


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
            "choose a smaller tiling.max_points or tiling.halo, or fewer execution.workers"
        )
    check_space(folder, plan.disk, plan.output_size, configuration.output.keep_free)
