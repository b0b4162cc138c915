"""A map planned, or cut into chunks, without being cleaned."""

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from pipeline.cluster.choice import workers_for
from pipeline.configuration.run import Configuration
from pipeline.eligibility import check_parts, survey_map
from pipeline.errors import OutputError, PlanError
from pipeline.metres import open_collection
from pipeline.outputs.folder_lock import locked_folder
from pipeline.plan.machine import available_cores
from pipeline.plan.plan import check_plan, draw_plan, make_plan
from pipeline.plan.resources import check_one_tile, check_workers, is_one_tile, one_tile_memory
from pipeline.progress import StageObserver
from pipeline.replacing import refuse_own_folders
from pipeline.scan_numbers import find_scans
from pipeline.showing import check_named_file, drawable, only_showing, printable
from pipeline.tiles.cleaning import gather_chunks, plan_tiles
from pipeline.work.folder import REMOVED_FOLDER, WORK_FOLDER, remove_work
from pipeline.work.job import CHUNKS_FOLDER, unchanged
from pipeline.work.opening import open_job
from tiling.collection import MapCollection, content_hash, find_map_files
from tiling.output_file import writing_only_into

_PRODUCTS = ("chunks", "store.json")
"""What `tile` leaves; a folder that has the last of them is whole."""

_PUBLISHING = "publishing"
"""Within the work folder: they are being moved, so that those in the folder are no others."""


def plan_map(
    maps: Sequence[str],
    configuration: Configuration,
    observer: StageObserver,
    picture: Path | None,
    *,
    as_json: bool = False,
) -> tuple[str, PlanError | None]:
    """Survey a map and return its plan as text, or as JSON; draw it if wanted.

    The second value says why the run would be refused, if it would.

    Raises
    ------
    TilingError, PipelineError
    """
    workers = available_cores(configuration.execution.workers)
    paths = find_map_files(maps)
    if picture is not None:
        check_named_file(picture, ".png", paths)
        picture = drawable(picture, observer.warn)
    collection = open_collection(paths, configuration.input, workers)
    configuration = configuration.of_size(collection.point_count)
    observer.stage("survey", collection.point_count)
    surveyed, _ = survey_map((batch for _, batch in collection.batches()), configuration)
    observer.finish()
    check_parts(surveyed.minimum, surveyed.maximum, configuration, observer)
    one_tile = is_one_tile(collection, configuration)
    if one_tile:
        tiling = {"max_points": max(collection.point_count, 1)}
        whole = configuration.tiling.model_copy(update=tiling)
        configuration = configuration.model_copy(update={"tiling": whole})
    known = not one_tile and _knows_scans(collection, configuration, observer)
    plan = make_plan(collection, surveyed, configuration, workers, scans_known=known)
    if one_tile:
        memory, _ = one_tile_memory(collection, configuration)
        plan = replace(plan, worker_memory=memory, disk=0)
    drawn = ""
    if picture is not None:
        with only_showing(str(picture), observer.warn):
            draw_plan(plan, surveyed, picture)
            drawn = f"\ndrawn:             {printable(picture)}"
    refused = None
    try:
        if one_tile:
            check_one_tile(collection, configuration)
        else:
            check_plan(plan, configuration, Path())
    except PlanError as error:
        refused = error
    if as_json:
        return json.dumps({**plan.figures(), "one_tile": one_tile}, indent=2), refused
    told = "\none tile: cleaned in memory, without temporary files" if one_tile else ""
    return plan.to_text() + told + drawn, refused


def _knows_scans(
    collection: MapCollection, configuration: Configuration, observer: StageObserver
) -> bool:
    """Tell whether the run will ask the range images of scans."""
    if not configuration.removal.weighs_evidence:
        return False
    source = find_scans(collection, configuration, observer)
    observer.finish()
    return source is not None


def tile_map(
    maps: Sequence[str], output: Path, configuration: Configuration, observer: StageObserver
) -> int:
    """Cut a map into chunks that lie in a folder of their own; return how many.

    Raises
    ------
    TilingError, PipelineError
        With no chunk in the folder.
    """
    paths = find_map_files(maps)
    refuse_own_folders(output, paths)
    check_workers(configuration)
    output.mkdir(parents=True, exist_ok=True)
    work = output / WORK_FOLDER
    try:
        with locked_folder(output), writing_only_into(output), unchanged(paths) as state:
            _take_back(output, work)
            if {path.name for path in output.iterdir()} - {WORK_FOLDER, REMOVED_FOLDER}:
                raise OutputError(
                    f"{output}: expected an empty folder for the chunks; choose another -o"
                )
            collection = open_collection(paths, configuration.input)
            digest = collection.with_poses(content_hash(paths))
            job = open_job(work, paths, state, digest, configuration, False, observer)
            with workers_for(job) as executor:
                plan_tiles(
                    job, executor, observer, lambda plan: check_plan(plan, configuration, output)
                )
                gather_chunks(job, executor, observer)
            observer.finish()
            tiles = len(job.store.layout)
            (work / _PUBLISHING).touch()
            for name in _PRODUCTS:
                (work / CHUNKS_FOLDER / name).rename(output / name)
            remove_work(work)
    finally:
        if not any(output.iterdir()):
            output.rmdir()
    return tiles


def _take_back(output: Path, work: Path) -> None:
    """Take back what a run published that was killed before it had ended."""
    if not (work / _PUBLISHING).exists():
        return  # what is there is the user's
    chunks = work / CHUNKS_FOLDER
    for name in _PRODUCTS:
        if (output / name).exists() and not (chunks / name).exists():
            (output / name).rename(chunks / name)
