"""What a run asks of the machine, memory and disk, and whether it is there."""

import shutil
from pathlib import Path

from dynahull.evidence.range_images import HELD_BYTES
from dynahull.ground.reach import ground_radius
from dynahull.observer import Observer
from pipeline.configuration.quantities import in_units
from pipeline.configuration.run import Configuration, is_elsewhere
from pipeline.errors import DiskSpaceError, PlanError
from pipeline.plan.machine import available_cores, available_memory
from tiling.collection import MapCollection

BASE_BYTES = 350 << 20
"""Of a process with all libraries loaded; see docs/scaling.md for this and the next figures."""

_BYTES_A_POINT_IN_MEMORY = 120
"""Of a map of one tile, with labels, on two threads."""

_BYTES_A_POINT_UNDER_CLOTH = 330
"""Of the same where the ground is found by `csf`."""

EVIDENCE_BYTES = 550
"""A point where evidence is weighed, beyond the others: sums over voxels, of which there are no
more than points, and the terms of a batch."""

_LABELLED_BYTES = 10
"""A point of a labelled map, beyond those of the input: label, density, class."""

_SCORE_BYTES = 4
"""A point in either, where evidence is weighed."""

_TABLE_BYTES = 10
"""A point in `labels.parquet`: nearly all of it the density, which does not compress."""

_PAGE_BYTES = 6 << 20
"""Of the report."""


TILE_BYTES = 260
"""A point of the largest tile, core and halo, in the stage that takes most."""

_HELD = 2
"""Points of core and halo, at most, for each of the core, unless `tiling.halo` is wide."""

_USUAL_TILE, _LARGEST_TILE, _SMALLEST_TILE = 1_000_000, 2_000_000, 20_000
_TILES_A_WORKER = 3
"""So that all workers have work to the end."""

_MANY_TILES = 1_000

_LARGEST_ONE_TILE = 50_000_000
"""Points: only tiles are shared out to all cores in every step."""


def is_one_tile(
    collection: MapCollection, configuration: Configuration, *, begun: bool = False
) -> bool:
    """Tell whether a map is a single tile, which is cleaned in memory.

    It is where it has no more points than a tile may have, and where the ground step must look
    at the map as a whole. With `tiling.max_points: auto`, a map whose tiles were `begun` stays cut.
    """
    most = configuration.tiling.max_points
    if ground_radius(configuration.ground) is None:
        return True
    if most != "auto":
        return collection.point_count <= most
    if begun:
        return False
    if is_elsewhere(configuration) or collection.point_count > _LARGEST_ONE_TILE:
        return collection.point_count <= _USUAL_TILE
    wanted, free = one_tile_memory(collection, configuration)
    return wanted <= free / 2


def warn_of_tiling(
    collection: MapCollection, configuration: Configuration, one_tile: bool, observer: Observer
) -> None:
    """Say that workers elsewhere have nothing to do, or what many small tiles cost."""
    most, execution = configuration.tiling.max_points, configuration.execution
    if one_tile and is_elsewhere(configuration):
        observer.warn(
            f"the map is a single tile and is cleaned in this process, without the workers of "
            f"{execution.scheduler or execution.cluster}"
        )
    elif most != "auto" and most < _SMALLEST_TILE and collection.point_count > _MANY_TILES * most:
        observer.warn(
            f"tiling.max_points={most} makes thousands of tiles, each of which takes a twentieth "
            f"of a second and several files: from {_SMALLEST_TILE:,} on the run is faster"
        )


def tile_budget(collection: MapCollection, configuration: Configuration, workers: int) -> int:
    """Return how many points a tile may have, its halo not counted.

    With `tiling.max_points: auto` as many as give each worker some tiles, but tiles are not made
    smaller than usual for that, nor larger than the memory of a worker allows.
    """
    most = configuration.tiling.max_points
    if most != "auto":
        return most
    shared_out = collection.point_count // (_TILES_A_WORKER * workers)
    each = TILE_BYTES + (EVIDENCE_BYTES if configuration.removal.weighs_evidence else 0)
    memory = worker_memory_limit(configuration, workers)
    fitting = int(memory / 2 - BASE_BYTES) // (each * _HELD)
    return max(_SMALLEST_TILE, min(fitting, _LARGEST_TILE, max(_USUAL_TILE, shared_out)))


_VOXEL_BYTES = 48
"""A point, of temporary files, while the map is thinned."""


def output_size(collection: MapCollection, configuration: Configuration) -> int:
    """Return the bytes of the outputs of a run, about: the map again, and more."""
    output = configuration.output
    score = _SCORE_BYTES if configuration.removal.weighs_evidence else 0
    each = 0
    if output.mode == "label":
        each += _LABELLED_BYTES + score
    if output.labels:
        each += _TABLE_BYTES + score
    page = _PAGE_BYTES if output.report == "html" else 0
    again = sum(path.stat().st_size for path in collection.paths)
    if output.voxel is not None:
        again *= 2
        each += _VOXEL_BYTES
        if output.voxel_fields == "mean":
            each += max(reader.bytes_per_point for reader in collection.readers)
    return again + each * collection.point_count + page


def check_space(folder: Path, temporary: int, results: int, keep_free: int) -> None:
    """Refuse temporary files and results, of so many bytes, for which a disk has no room.

    The folder need not be there yet; `keep_free` bytes are left to others.

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
    wanted, free = one_tile_memory(collection, configuration)
    if wanted > free:
        whole = ground_radius(configuration.ground) is None
        method = f"a ground.method other than {configuration.ground.method}"
        remedy = method if whole else "a smaller tiling.max_points"
        raise PlanError(
            f"{collection.name}: as one tile, the {collection.point_count:,} points would take "
            f"{in_units(wanted)}, and there are {in_units(free)}: choose {remedy}, so that the map "
            "is cut"
        )


def one_tile_memory(collection: MapCollection, configuration: Configuration) -> tuple[int, int]:
    """Return the bytes that a map of one tile takes, and those that there are.

    `csf` looks at the map as a whole: this is what it costs.
    """
    cloth = configuration.ground.method == "csf"
    each = _BYTES_A_POINT_UNDER_CLOTH if cloth else _BYTES_A_POINT_IN_MEMORY
    images = 0
    if configuration.removal.weighs_evidence:
        each += EVIDENCE_BYTES
        images = HELD_BYTES if configuration.evidence.time != "off" else 0
    memory = configuration.execution.memory
    free = available_memory() if memory == "auto" else memory
    return BASE_BYTES + images + each * collection.point_count, free


def more_memory(configuration: Configuration) -> str:
    """Say what gives a worker more memory."""
    if is_elsewhere(configuration) and configuration.execution.scheduler is None:
        return "more cluster.memory"
    given = configuration.execution.memory != "auto"
    return "more execution.memory" if given else "fewer execution.workers"


def check_workers(configuration: Configuration) -> None:
    """Refuse workers of this machine that could not begin: they would be stopped over and over.

    Raises
    ------
    PlanError
        In one line: what a worker takes before it has read a point, and what there is.
    """
    workers = available_cores(configuration.execution.workers)
    alone = configuration.execution.cluster == "none" or workers == 1
    if alone or is_elsewhere(configuration):
        return
    memory = worker_memory_limit(configuration, workers)
    if memory < BASE_BYTES:
        raise PlanError(
            f"a worker takes {in_units(BASE_BYTES)} before it has read a point, and has "
            f"{in_units(memory)}: choose {more_memory(configuration)}"
        )


def worker_memory_limit(configuration: Configuration, workers: int) -> int:
    """Return the bytes that each worker may take: as configured, or its share of what is free."""
    if is_elsewhere(configuration) and configuration.execution.scheduler is None:
        return configuration.cluster.memory
    memory = configuration.execution.memory
    return available_memory() // workers if memory == "auto" else memory
