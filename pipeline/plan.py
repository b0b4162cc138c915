"""The plan of a run: its tiles, and what they will take, before any of it is done."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynahull.ground import ground_radius, height_radius
from pipeline.configuration import Configuration, is_elsewhere
from pipeline.errors import DiskSpaceError, PlanError
from pipeline.machine import available_memory
from tiling.formats.collection import MapCollection
from tiling.layout import Layout, quadtree
from tiling.occupancy import Occupancy, count_within
from tiling.survey import Survey

_BASE_BYTES = 350 << 20
"""Of a process with all libraries loaded; see docs/scaling.md for this and the next figures."""

_BYTES_A_POINT = 260
"""Of the largest tile, core and halo, in the stage that takes most."""

_BYTES_A_POINT_IN_MEMORY = 120
"""Of a map of one tile, with labels, on two threads."""

_BYTES_A_POINT_UNDER_CLOTH = 330
"""Of the same where the ground is found by `csf`."""

_BYTES_ON_DISK = 100
"""A point of a tile, core or halo, in pieces, chunks and ground-free points together."""

_SCORES_ON_DISK = 40
"""A point of the map: densities, labels, and what else is kept of each row."""

_LABELLED_BYTES = 10
"""A point of a labelled map, beyond those of the input: label, density, class."""

_TABLE_BYTES = 10
"""A point in `labels.parquet`: nearly all of it the density, which does not compress."""

_PAGE_BYTES = 6 << 20
"""Of the report."""

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
    halo: float
    held: NDArray[np.int64]
    workers: int
    worker_memory: int
    disk: int
    output_size: int
    seconds: float

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


def is_one_tile(collection: MapCollection, configuration: Configuration) -> bool:
    """Tell whether a map is a single tile, which is cleaned in memory.

    It is where it has no more points than a tile may have, and where the ground step must look
    at the map as a whole.
    """
    whole = ground_radius(configuration.ground) is None
    return whole or collection.point_count <= configuration.tiling.max_points


def decision_radius(configuration: Configuration) -> float:
    """Return the metres within which all points lie that decide if a point is ground or above.

    Infinite where there is no such distance.
    """
    radius = ground_radius(configuration.ground)
    if radius is None:
        return np.inf
    if configuration.max_height is not None:
        radius += height_radius(configuration.ground)
    return radius


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
    radius = 0.0 if ground_radius(configuration.ground) is None else decision_radius(configuration)
    halo = configuration.tiling.halo
    if halo == "auto":
        halo = radius + neighbour_reach(survey.occupancy, configuration.neighbours.k)
    around = max(halo, radius)
    layout = quadtree(survey.occupancy, configuration.tiling.max_points, around)
    held = points_held(layout, survey.occupancy, halo)
    gathered = held if around == halo else points_held(layout, survey.occupancy, around)
    core, all_held = int(layout.counts.sum()), int(held.sum())
    seconds = core * _MICROSECONDS_A_POINT + (all_held - core) * _MICROSECONDS_A_HALO_POINT
    return Plan(
        point_count=survey.point_count,
        layout=layout,
        halo=halo,
        held=held,
        workers=workers,
        worker_memory=_BASE_BYTES + _BYTES_A_POINT * int(gathered.max(initial=0)),
        disk=all_held * _BYTES_ON_DISK + survey.point_count * _SCORES_ON_DISK,
        output_size=output_size(collection, configuration),
        seconds=seconds / 1e6 / workers,
    )


def output_size(collection: MapCollection, configuration: Configuration) -> int:
    """Return the bytes of the outputs of a run, about: the map again, and more."""
    output = configuration.output
    each = 0
    if output.mode == "label":
        each += _LABELLED_BYTES
    if output.labels:
        each += _TABLE_BYTES
    page = _PAGE_BYTES if output.report == "html" else 0
    again = sum(path.stat().st_size for path in collection.paths)
    return again + each * collection.point_count + page


def neighbour_reach(occupancy: Occupancy, k: int) -> float:
    """Estimate how far the k-th neighbour of most points is, metres: the halo need not be wider.

    A column's points are taken to be spread evenly over its ground plan.
    """
    if not len(occupancy.counts):
        return _SMALLEST_REACH
    order = np.argsort(occupancy.counts)
    below = np.cumsum(occupancy.counts[order])
    at = int(np.searchsorted(below, _SPARSE_SHARE * below[-1]))
    a_square_metre = occupancy.counts[order[at]] / occupancy.cell**2
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


def check_space(folder: Path, temporary: int, results: int, keep_free: int) -> None:
    """Refuse what would take more disk than there is.

    Parameters
    ----------
    folder : Path
        Where it would be written; it need not be there yet.
    temporary, results : int
        Bytes.
    keep_free : int
        Bytes that are left to others.

    Raises
    ------
    DiskSpaceError
    """
    place = next(each for each in (folder.absolute(), *folder.absolute().parents) if each.exists())
    free = shutil.disk_usage(place).free
    if temporary + results + keep_free > free:
        kept = f", of which {in_units(keep_free)} are to stay so" if keep_free else ""
        raise DiskSpaceError(
            f"{place}: the run would write {in_units(temporary)} of temporary files and "
            f"{in_units(results)} of results, and {in_units(free)} are free{kept}"
        )


def check_one_tile(collection: MapCollection, configuration: Configuration) -> None:
    """Refuse a map that is cleaned in memory and takes more than there is.

    Raises
    ------
    PlanError
        In one line: what it takes, what there is, and what to change.
    """
    wanted, free = _one_tile_memory(collection, configuration)
    if wanted > free:
        whole = ground_radius(configuration.ground) is None
        method = f"a ground.method other than {configuration.ground.method}"
        remedy = method if whole else "a smaller tiling.max_points"
        raise PlanError(
            f"{collection.name}: as one tile, the {collection.point_count:,} points would take "
            f"{in_units(wanted)}, and there are {in_units(free)}: choose {remedy}, so that the map "
            "is cut"
        )


def memory_left(collection: MapCollection, configuration: Configuration) -> int:
    """Return the bytes that are free beside what a map takes that is cleaned in memory."""
    wanted, free = _one_tile_memory(collection, configuration)
    return max(free - wanted, 0)


def _one_tile_memory(collection: MapCollection, configuration: Configuration) -> tuple[int, int]:
    """Return the bytes that a map of one tile takes, and those that there are."""
    cloth = configuration.ground.method == "csf"
    each = _BYTES_A_POINT_UNDER_CLOTH if cloth else _BYTES_A_POINT_IN_MEMORY
    memory = configuration.execution.memory
    free = available_memory() if memory == "auto" else memory
    return _BASE_BYTES + each * collection.point_count, free


def worker_memory_limit(configuration: Configuration, workers: int) -> int:
    """Return the bytes that each worker may take: as configured, or its share of what is free."""
    if is_elsewhere(configuration) and configuration.execution.scheduler is None:
        return configuration.cluster.memory
    memory = configuration.execution.memory
    return available_memory() // workers if memory == "auto" else memory


def in_units(size: float) -> str:
    """Return a number of bytes as people read it."""
    units = ["bytes", "KiB", "MiB", "GiB", "TiB"]
    while size >= 1024 and len(units) > 1:
        size /= 1024
        del units[0]
    return f"{size:.0f} {units[0]}" if units[0] == "bytes" else f"{size:.1f} {units[0]}"


def in_time(seconds: float) -> str:
    """Return a duration as people read it."""
    if seconds < 120:
        return f"{seconds:.0f} s"
    if seconds < 7200:
        return f"{seconds / 60:.0f} min"
    return f"{seconds / 3600:.1f} h"
