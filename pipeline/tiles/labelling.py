"""The task that labels the points of one tile, once all are scored, and what all tiles then say."""

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from dynahull.density import SMALLEST_CLUSTER
from dynahull.evidence.reasons import NO_REASON
from dynahull.labels import Label
from dynahull.removal import removal_percentages, remove_likely, smallest_counted
from dynahull.result import NO_CLUSTER
from pipeline.errors import WorkError
from pipeline.outputs.map_sample import MapSample, is_sampled
from pipeline.places import ARRAY_NAMES, Decision, DecisionSums
from pipeline.plan.machine import available_cores
from pipeline.report_page.charts import TileWork
from pipeline.tiles.cutting import label_unscored, protected_rows
from pipeline.tiles.density import KeptScores, first_cluster, scores_of
from pipeline.tiles.ground import labelled_points
from pipeline.tiles.thresholds import Cut, find_cuts
from pipeline.tiles.weighing import judge_tile, scan_views
from pipeline.work.files import GO_ON, make_rows, open_rows, read_sealed, write_sealed
from pipeline.work.folder import TaskReport
from pipeline.work.job import JOB_FILE, Job
from tiling.chunks import read_rows

CUTS_FILE = "cuts.json"

_STAGES_OF_A_TILE = ("chunk", "columns", "ground", "height", "density", "evidence", "label")

LABELS: dict[str, tuple[DTypeLike, float]] = {"label": (np.uint8, Label.INVALID)}
SCORES: dict[str, tuple[DTypeLike, float]] = {
    "cluster": (np.int32, NO_CLUSTER),
    "density": (np.float64, np.nan),
    "score": (np.float32, np.nan),
    "reason": (np.uint8, NO_REASON),
}
"""Files of one value a row: their types, and what a row has that is in no tile."""

_SHOWN = ("label", "cluster", "density", "score")
_SHOWN_XYZ = "shown_xyz"
_SCORED = (Label.STATIC, Label.DYNAMIC, Label.UNSCORED)
"""Labels of those points of a tile that were not set aside before the scoring."""


def save_cuts(job: Job, counts: list[int], cuts: list[Cut] | None) -> None:
    """Keep what all tiles together say of the removal: N_i, and the cut of each cluster.

    With one model a tile there are no cuts yet: only the smallest and the largest N_i are kept,
    which is all that Eq. 1 asks of other tiles.
    """
    values = {
        "counts": counts if cuts is not None else _extremes(job, counts),
        "cuts": None if cuts is None else [(cut.density, int(cut.last_row)) for cut in cuts],
    }
    write_sealed(job.root / CUTS_FILE, values)


def label_tile(job: Job, tile: int) -> TaskReport:
    """Label the points of a tile's core.

    Labels and scores are kept, and the places of points that the report shows.

    The report counts the points of each label, then those removed from each cluster.
    """
    removal = job.configuration.removal
    judged = judge_tile(job, tile) if removal.weighs_evidence else None
    score = None if judged is None else judged.score
    chunk, labels = labelled_points(job, tile)
    labels, core_rows = labels[chunk.core], chunk.rows[chunk.core]
    core_xyz = chunk.xyz[chunk.core]
    cluster_of, density = scores_of(job, tile)
    counts, cuts = _cuts_of(job, tile)
    removed = []
    place = np.flatnonzero(labels == Label.STATIC)  # scored are those that were not set aside
    safe = protected_rows(job, core_rows[place])
    for cluster, (count, cut) in enumerate(zip(counts, cuts, strict=True)):
        members = np.flatnonzero(cluster_of == cluster)
        if count < SMALLEST_CLUSTER:
            labels[place[members]] = Label.UNSCORED
        if score is None:
            dynamic = cut.dynamic(density[members], core_rows[place[members]])
        else:
            dynamic = remove_likely(score[members], removal.confidence).dynamic
        dynamic &= ~safe[members]
        labels[place[members[dynamic]]] = Label.DYNAMIC
        removed.append(int(np.count_nonzero(dynamic)))
    kept: dict[str, NDArray[Any]] = {"label": labels}
    core = np.stack([job.store.layout.low[tile], job.store.layout.high[tile]])
    if judged is not None:
        kept |= {"score": judged.score, "reason": judged.reason}
        weighed = np.where(safe, np.float32(np.nan), judged.score)
        sums = DecisionSums.of(core_xyz[place], weighed, judged.reason, removal.confidence, core)
    else:
        sums = DecisionSums.by_density(core_xyz[labels == Label.DYNAMIC], core)
    kept |= sums.to_arrays()
    if job.configuration.output.report == "html":
        kept[_SHOWN_XYZ] = core_xyz[is_sampled(core_rows, job.collection.point_count)]
    if job.configuration.clustering.scope == "tile":
        limits = [np.nan if cut.density is None else cut.density for cut in cuts]
        kept["thresholds"] = np.array(limits)
    job.work.save("label", tile, **kept)
    counted = np.bincount(labels, minlength=len(Label)).tolist()
    return TaskReport(len(core_rows), (*counted, *removed))


def gather_decision(job: Job) -> Decision:
    """Return what was decided, from the sums that the label tasks of all tiles kept."""
    parts = (
        DecisionSums.from_arrays(*job.work.load("label", tile, *ARRAY_NAMES))
        for tile in range(len(job.store.layout))
    )
    return DecisionSums.merged(parts).decision()


def _cuts_of(job: Job, tile: int) -> tuple[list[int], list[Cut]]:
    """Return N_i and the cut of every cluster that the tile's points may be in."""
    stored = read_sealed(job.root / CUTS_FILE)
    if stored["cuts"] is not None:
        return stored["counts"], [Cut(density, row) for density, row in stored["cuts"]]
    report = job.work.report("density", tile)
    if report is None:
        raise WorkError(f"{job.root}: expected the scores of tile {tile}, found none; {GO_ON}")
    counts = list(report.counts[1:])
    if job.configuration.removal.weighs_evidence:
        return counts, [Cut(None)] * len(counts)
    percentages = tile_percentages(job, counts, stored["counts"])
    threshold = job.configuration.removal.threshold
    return counts, find_cuts([KeptScores(job, tile)], counts, percentages, threshold)


def tile_percentages(job: Job, counts: list[int], extremes: list[int]) -> Sequence[Fraction]:
    """Return R_i of some clusters (Eq. 1), given the smallest and the largest N_i of the map."""
    removal, k = job.configuration.removal, job.configuration.neighbours.k
    every = [*counts, *extremes]
    return removal_percentages(every, removal.min_percent, removal.max_percent, k)[: len(counts)]


def _extremes(job: Job, counts: list[int]) -> list[int]:
    """Return N_min and N_max of Eq. 1."""
    populated = [count for count in counts if count > 0] or [0]
    return [smallest_counted(populated, job.configuration.neighbours.k), max(populated)]


def seen_by_scans(job: Job, sample: MapSample) -> MapSample:
    """Return the sample of the map, and what scans saw of it."""
    cores = available_cores(job.configuration.execution.workers)
    told = job.viewpoints is not None and job.viewpoints.are_told
    return sample.seen(job.scans_of(sample.rows), scan_views(job) if told else None, cores)


def tile_work(job: Job) -> TileWork:
    """Return what the tiles took, as their tasks report it."""
    layout = job.store.layout
    tiles = range(len(layout))
    begun = (job.root / JOB_FILE).stat().st_mtime
    seconds, finished = np.zeros(len(tiles)), np.zeros(len(tiles))
    for tile in tiles:
        for stage in _STAGES_OF_A_TILE:
            report = job.work.report(stage, tile)
            if report is not None:
                seconds[tile] += report.seconds
        finished[tile] = job.work.path("density", tile, ".done").stat().st_mtime
    overfull = np.zeros(len(tiles), np.bool_)
    overfull[layout.overfull(job.store.max_points)] = True
    return TileWork(layout.low, layout.high, layout.counts, seconds, finished < begun, overfull)


class RowResults:
    """Labels and, where wanted, clusters and densities, in files of one value a row.

    One process writes them. The rows of a tile lie all over a file: workers of several machines
    would write to the same page, and on NFS the last of them would undo what the others wrote.
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        self._shows = job.configuration.output.report == "html"
        self._shown: list[MapSample] = []
        kinds = LABELS | (SCORES if job.configuration.output.needs_scores else {})
        self._files: dict[str, NDArray[Any]] = {}
        for name, (kind, value) in kinds.items():
            make_rows(job.rows_path(name), job.collection.point_count, kind, value)
            self._files[name] = open_rows(job.rows_path(name), kind, "r+")
        label_unscored(job, self._files["label"])

    def add(self, tile: int) -> None:
        """Take over what was found of a tile: its label task is done."""
        rows, core = read_rows(self._job.store, tile)
        own, values = rows[core], _values_of(self._job, tile)
        for name, file in self._files.items():
            file[own] = values[name]
        if self._shows:
            total = self._job.collection.point_count
            shown = is_sampled(own, total)
            (xyz,) = self._job.work.load("label", tile, _SHOWN_XYZ)
            of_shown = (values[name][shown] for name in _SHOWN)
            self._shown.append(MapSample(total, own[shown], xyz, *of_shown))

    def flush(self) -> None:
        """Let other processes see it, on other machines as well."""
        for file in self._files.values():
            if isinstance(file, np.memmap):
                file.flush()

    def sample(self) -> MapSample:
        """Return the points that the report shows; none without a report."""
        return MapSample.of_parts(self._job.collection.point_count, self._shown)


def _values_of(job: Job, tile: int) -> dict[str, NDArray[Any]]:
    """Return what was found of the points of a tile's core, by the names of the files of rows."""
    (labels,) = job.work.load("label", tile, "label")
    place = np.flatnonzero(np.isin(labels, _SCORED))
    cluster, density = scores_of(job, tile)
    found = {"cluster": cluster + first_cluster(job, tile), "density": density}
    if job.configuration.removal.weighs_evidence:
        judged = ("score", "reason")
        found |= dict(zip(judged, job.work.load("label", tile, *judged), strict=True))
    values = {"label": labels}
    for name, (kind, nothing) in SCORES.items():
        values[name] = np.full(len(labels), nothing, kind)
        values[name][place] = found.get(name, nothing)
    return values
