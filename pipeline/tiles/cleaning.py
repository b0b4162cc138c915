"""Algorithm 1 over tiles: the same labels and densities as in memory, to the last bit."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from dynahull.clustering import Clusters, fit_clusters, sample_rows
from dynahull.evidence.viewpoints import Viewpoints
from dynahull.evidence.voxels import Voxels
from dynahull.labels import Label
from dynahull.removal import removal_percentages
from dynahull.result import ClusterSummary
from dynahull.strays import OUTSKIRTS_NAMES, Outskirts, Strays
from dynahull.warn import (
    warn_of_clusters,
    warn_of_densities,
    warn_of_ground,
    warn_of_much_removed,
    warn_of_sparse_map,
)
from pipeline.eligibility import check_parts, survey_of_others
from pipeline.errors import ConfigurationError, PlanError
from pipeline.outputs.map_sample import MapSample
from pipeline.plan.plan import Plan, make_plan
from pipeline.progress import StageObserver
from pipeline.scan_numbers import find_scans
from pipeline.tiles.cutting import (
    COORDINATES,
    make_copies,
    save_set_aside,
    set_aside,
    warn_of_set_aside,
)
from pipeline.tiles.density import KeptScores, first_cluster
from pipeline.tiles.ground import SAMPLE_NAMES, summaries
from pipeline.tiles.labelling import RowResults, save_cuts
from pipeline.tiles.stages import do_stage, exhaust
from pipeline.tiles.thresholds import Cut, find_cuts
from pipeline.tiles.weighing import gather_returns
from pipeline.work.files import write_arrays, write_sealed
from pipeline.work.folder import TaskReport, remove_work
from pipeline.work.job import (
    CHUNKS_FOLDER,
    CLUSTERS_FILE,
    FITTING,
    PLANNING,
    SAMPLE,
    SCANS_FILE,
    TIMING,
    VIEWPOINTS_FILE,
    Job,
)
from pipeline.workers.executors import Executor
from tiling.chunks import ChunkStore, grid_of
from tiling.collection import MapCollection
from tiling.errors import TilingError
from tiling.ledger import noting
from tiling.output_file import atomic_file
from tiling.resolution import coarse_step_notes
from tiling.survey import Survey, merge

_SURVEY_NAMES = ("point_counts", "bounds", "cell", "columns", "counts")


def clean_tiles(
    job: Job, executor: Executor, observer: StageObserver, check: Callable[[Plan], None]
) -> tuple[dict[str, int], tuple[ClusterSummary, ...], MapSample]:
    """Label every point of a map that is cut into tiles.

    Labels, clusters and densities are in files, a value a row. `check` is told of the plan before
    any tile is cut, and raises where it cannot be carried out.

    Returns
    -------
    counts : dict of str to int
        Points of each label.
    clusters : tuple of ClusterSummary
    sample : MapSample
        The points that the report shows.
    """
    plan_tiles(job, executor, observer, check)
    place = job.store.layout.typical_place()
    for note in coarse_step_notes(job.collection, place, job.collection.metres):
        observer.warn(note)
    gather_chunks(job, executor, observer)
    tiles = job.store.layout.counts.tolist()
    _set_ground_aside(job, executor, observer, tiles)
    find_clusters(job, observer)
    job.remove_spent(SAMPLE)
    counts = _counted(job, do_stage(job, executor, observer, "density", tiles))
    for spent in ("free", SAMPLE):
        job.remove_spent(spent)
    if job.configuration.removal.weighs_evidence:
        gather_returns(job)
        reports = do_stage(job, executor, observer, "evidence", tiles)
        counted = [report.counts for _, report in reports]  # none, where no point takes part
        wide, scored = np.reshape(counted, (-1, 2)).sum(axis=0)
        job.remove_spent("spread")
        warn_of_sparse_map(int(wide), int(scored), observer)
    else:
        levels = [job.work.load("density", tile, "levels")[0] for tile in range(len(tiles))]
        warn_of_densities(np.sum(levels, axis=0), observer)
    percentages, cuts = _rescaled(job, counts, observer)
    results, found, removed = RowResults(job), _labels_of_no_tile(job), dict[int, int]()
    for tile, report in do_stage(job, executor, observer, "label", tiles):
        results.add(tile)
        found += np.array(report.counts[: len(Label)], np.int64)
        # A cluster of the map is in many tiles.
        for cluster, gone in enumerate(report.counts[len(Label) :], first_cluster(job, tile)):
            removed[cluster] = removed.get(cluster, 0) + gone
    results.flush()
    clusters = _summaries(job, counts, percentages, cuts, removed)
    if job.configuration.removal.weighs_evidence:
        warn_of_much_removed(clusters, observer)
    return {label.title: int(found[label]) for label in Label}, clusters, results.sample()


def find_times(job: Job, collection: MapCollection, observer: StageObserver) -> None:
    """Find out what tells when points were seen, where the evidence is weighed.

    The map is the job's, opened so that all cores read it.
    """
    if not job.configuration.removal.weighs_evidence or job.work.has_done(TIMING):
        return
    source = find_scans(collection, job.configuration, observer)
    stored = None if source is None else source.model_dump(mode="json")
    with noting() as written:
        write_sealed(job.root / SCANS_FILE, {"source": stored})
    job.work.finish_step(TIMING, written)


def _set_ground_aside(
    job: Job, executor: Executor, observer: StageObserver, tiles: Sequence[int]
) -> None:
    if job.configuration.ground.method == "slope" and not job.is_spent("columns"):
        exhaust(do_stage(job, executor, observer, "columns", tiles))
    ground = sum(
        report.counts[0] for _, report in do_stage(job, executor, observer, "ground", tiles)
    )
    job.remove_spent("columns")
    warn_of_ground(ground, sum(tiles), job.configuration.ground.method, observer)
    if job.labelling == "height":
        exhaust(do_stage(job, executor, observer, "height", tiles))


def plan_tiles(
    job: Job, executor: Executor, observer: StageObserver, check: Callable[[Plan], None]
) -> None:
    """Survey the map, and plan its tiles."""
    rows = [len(part) for part in job.row_ranges]
    if any(job.work.report("survey", number) is None for number in range(len(rows))):
        make_copies(job)
    reports = do_stage(job, executor, observer, "survey", rows)
    if job.work.has_done(PLANNING):
        exhaust(reports)
        job.store.make()
        warn_of_set_aside(job, observer)
        return
    try:
        survey, strays, marked = _whole_survey(job, reports)
        with noting() as written:
            save_set_aside(job, strays, *marked)
            if job.scan_source is not None:
                _keep_viewpoints(job)
        warn_of_set_aside(job, observer)
        check_parts(survey.minimum, survey.maximum, job.configuration, observer)
        known = job.viewpoints is not None
        workers = executor.workers
        plan = make_plan(job.collection, survey, job.configuration, workers, scans_known=known)
        check(plan)
    except (ConfigurationError, PlanError, TilingError):
        # Refused: there is nothing to go on with.
        remove_work(job.root)
        raise
    overfull = len(plan.layout.overfull(plan.max_points))
    if overfull:
        observer.warn(
            f"{overfull} tiles hold more than tiling.max_points: a column of the lattice, "
            f"{plan.layout.cell:g} m wide, is not divided"
        )
    with noting() as stored:
        _store(job, plan, survey).save()
    job.work.finish_step(PLANNING, [*written, *stored])


def gather_chunks(job: Job, executor: Executor, observer: StageObserver) -> None:
    """Cut a map whose tiles are planned into chunks: sort its points by tile, and gather these."""
    if not job.is_spent("cut"):
        exhaust(do_stage(job, executor, observer, "cut", [len(part) for part in job.cut_ranges]))
        if job.decoded is not None and not job.decoded.has_records:
            job.decoded.path.unlink(missing_ok=True)
    tiles = job.store.layout.counts.tolist()
    exhaust(do_stage(job, executor, observer, "chunk", tiles))
    job.remove_spent("cut")


def find_clusters(job: Job, observer: StageObserver) -> None:
    """Fit the model of the map on the sample gathered from all tiles."""
    if job.configuration.clustering.scope == "tile" or job.work.has_done(FITTING):
        return
    centroids = _scored_by(job)
    if centroids is None:
        centroids = _fitted(job, observer).centroids
    with noting() as written, atomic_file(job.root / CLUSTERS_FILE) as temporary:
        write_arrays(temporary, {"centroids": centroids})
    job.work.finish_step(FITTING, written)


def _scored_by(job: Job) -> NDArray[np.float64] | None:
    """Return the model that tiles were scored by, if any was: another machine may fit another."""
    for tile in range(len(job.store.layout)):
        if job.work.report("density", tile) is not None:
            return job.work.load("density", tile, "centroids")[0]
    return None


def _fitted(job: Job, observer: StageObserver) -> Clusters:
    parameters = job.configuration.clustering
    tiles = range(len(job.store.layout))
    counts = job.store.layout.counts.tolist()
    observer.stage("clustering", sum(counts))
    xyz, rows = np.empty((0, 3)), np.empty(0, np.int64)
    for tile in tiles:
        more_xyz, more_rows = job.work.load(SAMPLE, tile, *SAMPLE_NAMES)
        xyz, rows = np.concatenate([xyz, more_xyz]), np.concatenate([rows, more_rows])
        # A sample of samples is the sample of the whole: so it never grows.
        chosen = sample_rows(rows, job.finite_count, parameters)
        xyz, rows = xyz[chosen], rows[chosen]
        observer.advance(counts[tile])
    return fit_clusters(xyz, parameters)


def _whole_survey(
    job: Job, reports: Iterator[tuple[int, TaskReport]]
) -> tuple[Survey, Strays, list[int]]:
    """Put the surveys of all ranges of rows together; count those that are marked."""
    outskirts = Outskirts(job.configuration.neighbours.k)
    marked = [0, 0, 0]

    def surveys() -> Iterator[Survey]:
        for number, report in reports:
            outskirts.merge(
                Outskirts.from_arrays(*job.work.load("survey", number, *OUTSKIRTS_NAMES))
            )
            marked[:] = map(sum, zip(marked, report.counts, strict=True))
            yield Survey.from_arrays(*job.work.load("survey", number, *_SURVEY_NAMES))

    merged = merge(surveys())
    strays = outskirts.strays()
    return survey_of_others(merged, strays), strays, marked


def _keep_viewpoints(job: Job) -> None:
    """Find from where scans are looked at by what all ranges of rows say of them."""

    def parts() -> Iterator[Voxels]:
        for number in range(len(job.row_ranges)):
            (found,) = summaries(job, "survey", number, COORDINATES)
            yield Voxels(found.cells, found.values.astype(np.int64))

    viewpoints = Viewpoints.of_counts(parts)
    with atomic_file(job.root / VIEWPOINTS_FILE) as temporary:
        write_arrays(temporary, {"numbers": viewpoints.numbers, "places": viewpoints.places})


def _store(job: Job, plan: Plan, survey: Survey) -> ChunkStore:
    chunks = job.configuration.tiling.format
    return ChunkStore(
        job.root / CHUNKS_FOLDER,
        plan.layout,
        plan.halo,
        survey.point_count,
        chunks,
        None if chunks == "parquet" else grid_of(job.collection, survey),
        plan.max_points,
    )


def _counted(job: Job, reports: Iterator[tuple[int, TaskReport]]) -> NDArray[np.int64]:
    """Return N_i of every cluster of the map, from the counts of all tiles."""
    if job.configuration.clustering.scope == "map":
        counts = np.zeros(len(job.clusters.centroids), np.int64)
        for _, report in reports:
            counts += np.array(report.counts[1:], np.int64)
        return counts
    numbered = {}
    for tile, report in reports:
        for cluster, count in enumerate(report.counts[1:], first_cluster(job, tile)):
            numbered[cluster] = count
    counts = np.full(max(numbered, default=-1) + 1, -1, np.int64)
    counts[list(numbered)] = list(numbered.values())
    return counts


def _rescaled(
    job: Job, counts: NDArray[np.int64], observer: StageObserver
) -> tuple[Sequence[Fraction], list[Cut] | None]:
    """Apply Eq. 1, and find the cut of each cluster over all tiles."""
    observer.stage("rescale", int(counts[counts >= 0].sum()))
    removal = job.configuration.removal
    present = counts[counts >= 0].tolist()
    warn_of_clusters(present, job.configuration.method(), observer)
    k = job.configuration.neighbours.k
    percentages = removal_percentages(present, removal.min_percent, removal.max_percent, k)
    if job.configuration.clustering.scope == "tile":
        save_cuts(job, present, None)
        return percentages, None
    tiles = [KeptScores(job, tile) for tile in range(len(job.store.layout))]
    if removal.weighs_evidence:
        cuts = [Cut(None)] * len(present)
    else:
        cuts = find_cuts(tiles, present, percentages, removal.threshold)
    save_cuts(job, present, cuts)
    return percentages, cuts


def _labels_of_no_tile(job: Job) -> NDArray[np.int64]:
    """Count the points of each label that are in no tile: those that take no part."""
    found = np.zeros(len(Label), np.int64)
    found[Label.UNSCORED] = unscored = set_aside(job).unscored
    found[Label.INVALID] = job.collection.point_count - job.finite_count - unscored
    return found


def _summaries(
    job: Job,
    counts: NDArray[np.int64],
    percentages: Sequence[Fraction],
    cuts: list[Cut] | None,
    removed: Mapping[int, int],
) -> tuple[ClusterSummary, ...]:
    """Return what all tiles together say of the clusters."""
    if cuts is not None:
        centroids, thresholds = job.clusters.centroids, [cut.density for cut in cuts]
    else:
        centroids, thresholds = np.empty((0, 3)), []
        for tile in range(len(job.store.layout)):
            centroids = np.concatenate([centroids, *job.work.load("density", tile, "centroids")])
            (limits,) = job.work.load("label", tile, "thresholds")
            thresholds += [None if np.isnan(limit) else limit for limit in limits.tolist()]
    present = np.flatnonzero(counts >= 0).tolist()
    return tuple(
        ClusterSummary(
            index=index,
            centroid=(float(centre[0]), float(centre[1]), float(centre[2])),
            count=int(counts[index]),
            percentage=float(percentage),
            threshold=threshold,
            removed=removed.get(index, 0),
        )
        for index, centre, percentage, threshold in zip(
            present, centroids, percentages, thresholds, strict=True
        )
    )
