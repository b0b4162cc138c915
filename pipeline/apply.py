"""Deciding again without computing again: `dynahull-pipeline apply`.

The map is split anew by what a run kept of each point in `labels.parquet`. Nothing is held of all
points but files of one value a row, so that memory does not grow with the map.
"""

import json
import shutil
from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from dynahull.checking import valid_points
from dynahull.evidence.range_images import RETURN_BYTES, Returns
from dynahull.evidence.range_images import Views as ScanViews
from dynahull.labels import Label
from dynahull.protection import Area
from dynahull.removal import removal_percentages, remove_likely
from dynahull.result import NO_CLUSTER, ClusterSummary
from pipeline.areas import areas_of_voxels
from pipeline.configuration.effect import check_effect, check_work
from pipeline.configuration.run import Configuration, load_configuration
from pipeline.eligibility import PROTECTED, check_parts, marks
from pipeline.errors import ConfigurationError, InputChangedError, OutputError
from pipeline.metres import open_collection
from pipeline.outputs.folder import OutputNames, output_folder
from pipeline.outputs.map_sample import MapSample, is_sampled
from pipeline.outputs.modes import check_mode, scores_of
from pipeline.outputs.reading import row_columns
from pipeline.outputs.run_report import RunReport
from pipeline.outputs.writing import CleanedMap, make_places, write_maps
from pipeline.places import NOWHERE, SIDE, Decision, DecisionSums
from pipeline.plan.machine import available_cores
from pipeline.plan.resources import check_space, output_size
from pipeline.progress import StageObserver
from pipeline.replacing import CONFIGURATION_FILE, LABELS_FILE
from pipeline.report_page.report_page import Views
from pipeline.run import write_account
from pipeline.scan_numbers import find_scans
from pipeline.tiles.thresholds import Cut, find_cuts
from pipeline.work.files import make_rows, open_rows, read_arrays, write_arrays
from pipeline.work.job import unchanged
from pipeline.work.kept_returns import gather, kept_returns
from tiling.collection import MapCollection, content_hash
from tiling.formats.points import PointBatch

_FREE = ("removal", "output", "execution")
"""Sections that say nothing of what was computed."""

_ROWS_AT_A_TIME = 1 << 20

_KINDS: dict[str, DTypeLike] = {
    "label": np.uint8,
    "cluster": np.int32,
    "density": np.float64,
    "score": np.float32,
    "reason": np.uint8,
}

_ROW_BYTES = sum(np.dtype(kind).itemsize for kind in _KINDS.values())

_RETURNS_BYTES = 2 * RETURN_BYTES
"""A point, for what scans saw, as it was read and gathered."""

Kept = dict[str, NDArray[Any]]
"""What a run kept of each point, (N,) each, by the names of `_KINDS`."""


def decide_again(
    folder: Path,
    output: Path | None,
    settings: Sequence[str],
    protect: Sequence[Area],
    restore: Sequence[int],
    observer: StageObserver,
) -> RunReport:
    """Split the map of a finished run anew, and write all its results again.

    Parameters
    ----------
    output : Path or None
        Where the results go; in place of the run's own by default.
    settings : sequence of str
        As `--set` takes them, of the sections `removal`, `output` and `execution`.
    protect : sequence of Area
        Where nothing is removed, beside those of the run.
    restore : sequence of int
        Numbers of places of the run's report that are put back.

    Raises
    ------
    ConfigurationError
        When a setting or a number is not one that can be applied, or has no effect.
    OutputError
        When the folder holds no result with all scores.
    InputChangedError
        When the map is not the one that was cleaned.
    """
    report = _report_of(folder)
    configuration = _configured(folder, report, settings, protect)
    _check_places(report, restore)
    paths = [Path(file.path) for file in report.files]
    cores = available_cores(configuration.execution.workers)
    collection = open_collection(paths, configuration.input, cores)
    check_mode(collection.readers, configuration)
    names = OutputNames.of_run(collection.readers, configuration.output)
    results, place = names.all_files(configuration.output), output or folder
    with output_folder(place, results, paths) as staging, unchanged(paths):
        size = output_size(collection, configuration)
        rows = _ROW_BYTES + (_RETURNS_BYTES if report.time not in (None, "none") else 0)
        check_space(place, rows * collection.point_count, size, configuration.output.keep_free)
        _check_content(collection, report, observer)
        kept = _read_kept(folder / LABELS_FILE, staging / "rows", collection.point_count)
        if restore:
            areas = _areas_of_places(collection, report, kept, restore, observer)
            protect = (*configuration.removal.protect, *areas)
            removal = configuration.removal.model_copy(update={"protect": protect})
            configuration = configuration.model_copy(update={"removal": removal})
        cleaned = _Decision(collection, configuration, report, kept, staging, observer).made()
        places = make_places(names, staging)
        scores = scores_of(kept, configuration)
        write_maps(collection, configuration.output, kept["label"], scores, places, observer)
        digest = report.input_hash
        made = write_account(
            place, collection, digest, configuration, cleaned, names, staging, observer
        )
        shutil.rmtree(staging / "rows")
    return made


def _report_of(folder: Path) -> RunReport:
    report = RunReport.read(folder)
    if LABELS_FILE not in report.outputs:
        raise OutputError(
            f"{folder}: expected {LABELS_FILE}, which keeps the scores, found none; run again with "
            "--labels"
        )
    return report


def _configured(
    folder: Path, report: RunReport, settings: Sequence[str], areas: Sequence[Area]
) -> Configuration:
    """Return the run's configuration with what is decided anew."""
    own = load_configuration(str(folder / CONFIGURATION_FILE))
    given = load_configuration(str(folder / CONFIGURATION_FILE), settings)
    if given.output.labels is False:
        raise ConfigurationError(
            f"output.labels: expected true, as apply writes {LABELS_FILE} again, found false"
        )
    every = [*given.removal.protect, *areas]
    wanted = [*settings, "output.labels=true"]
    wanted.append("removal.protect=" + json.dumps([area.model_dump() for area in every]))
    given = load_configuration(str(folder / CONFIGURATION_FILE), wanted)
    for section in type(own).model_fields:
        if section not in _FREE and getattr(own, section) != getattr(given, section):
            raise ConfigurationError(
                f"{section}: expected settings of {', '.join(_FREE)} alone; run again to change "
                "others, by which scores are computed"
            )
    if given.removal.weighs_evidence and not own.removal.weighs_evidence:
        raise ConfigurationError(
            "removal.decision: the run weighed no evidence; run again with -c auto"
        )
    check_effect(settings, given)
    check_work(settings)
    if given.removal.protect_classes and not all("LA" in file.format for file in report.files):
        raise ConfigurationError("removal.protect_classes expects a LAS map with classes")
    return given


def _check_content(collection: MapCollection, report: RunReport, observer: StageObserver) -> None:
    observer.stage("hashing", collection.point_count)
    if content_hash(collection.paths) != report.input_hash:
        raise InputChangedError(f"{collection.name}: the map changed since it was cleaned")
    if report.poses_hash not in (None, collection.poses and collection.poses.hashed()):
        raise InputChangedError(f"{collection.name}: its poses changed since it was cleaned")


def _check_places(report: RunReport, numbers: Sequence[int]) -> None:
    for number in numbers:
        if number not in {place.number for place in report.places}:
            listed = f"1 to {len(report.places)}" if report.places else "none"
            raise ConfigurationError(
                f"--restore {number}: expected the number of a place in the report: {listed}"
            )


def _read_kept(table: Path, folder: Path, count: int) -> Kept:
    """Read what a run kept of each point, into files of one value a row."""
    folder.mkdir()
    kept: Kept = {}
    for name, kind in _KINDS.items():
        make_rows(folder / name, count, kind, 0)
        kept[name] = open_rows(folder / name, kind, "r+")
    first = 0
    for columns in row_columns(table, tuple(_KINDS)):
        stop = first + len(columns["label"])
        if stop > count:
            break
        for name, values in columns.items():
            kept[name][first:stop] = values
        first = stop
    if first != count:
        raise OutputError(
            f"{table}: expected {count:,} points as in the map, found another number; run again"
        )
    return kept


def _areas_of_places(
    collection: MapCollection,
    report: RunReport,
    kept: Kept,
    numbers: Sequence[int],
    observer: StageObserver,
) -> list[Area]:
    """Return the voxels of places of the run's report: what it removed there is theirs alone."""
    by_evidence = report.configuration["removal"]["decision"] == "auto"
    observer.stage("restoring", collection.point_count)

    def parts() -> Iterator[DecisionSums]:
        for _, batch in collection.batches():
            own = slice(batch.first_row, batch.first_row + len(batch.xyz))
            gone = kept["label"][own] == Label.DYNAMIC
            if by_evidence:
                score, reason = kept["score"][own][gone], kept["reason"][own][gone]
                yield DecisionSums.of(batch.xyz[gone], score, reason, 0.0, NOWHERE)
            else:
                yield DecisionSums.by_density(batch.xyz[gone], NOWHERE)
            observer.advance(len(batch.xyz))

    return areas_of_voxels(DecisionSums.merged(parts()).cells_of(numbers), SIDE)


class _ScoredRows:
    """Consecutive rows as `find_cuts` looks at them."""

    def __init__(self, kept: Kept, rows: slice) -> None:
        self._cluster, self._density = kept["cluster"][rows], kept["density"][rows]
        self._first = rows.start

    def densities(self, cluster: int) -> NDArray[np.float64]:
        return np.asarray(self._density[self._cluster == cluster])

    def rows_at(self, cluster: int, density: float) -> NDArray[np.int64]:
        tied = (self._cluster == cluster) & (self._density == density)
        return np.asarray(np.flatnonzero(tied) + self._first)


class _Decision:
    """One look at all points: which go, what the report shows, and the places."""

    def __init__(
        self,
        collection: MapCollection,
        configuration: Configuration,
        report: RunReport,
        kept: Kept,
        staging: Path,
        observer: StageObserver,
    ) -> None:
        self._collection, self._configuration = collection, configuration
        self._report, self._kept, self._observer = report, kept, observer
        # Of one model a tile some numbers are of no cluster.
        self._counts = [0] * (1 + max((each.index for each in report.clusters), default=-1))
        for each in report.clusters:
            self._counts[each.index] = each.count
        self._sums: list[DecisionSums] = []
        self._shown: list[MapSample] = []
        self._reports = configuration.output.report == "html"
        # What the report shows of scans is found out again, as the run kept none of it.
        finds = self._reports and configuration.removal.weighs_evidence
        self._source = find_scans(collection, configuration, observer) if finds else None
        self._scans: list[NDArray[np.int32]] = []
        self._sensor = None if self._source is None else self._source.sensor(collection)
        if self._sensor is not None:
            self._returns = staging / "rows" / "returns"
            self._returns.mkdir()

    def made(self) -> CleanedMap:
        configuration, kept = self._configuration, self._kept
        removal, counts, k = configuration.removal, self._counts, configuration.neighbours.k
        percentages = removal_percentages(counts, removal.min_percent, removal.max_percent, k)
        cuts = self._cuts(percentages)
        removed = np.zeros(len(counts), np.int64)
        found = np.zeros(len(Label), np.int64)
        self._observer.stage("deciding", self._collection.point_count)
        low, high = np.full(3, np.inf), np.full(3, -np.inf)
        for file, batch in self._collection.batches():
            seen = batch.xyz[valid_points(batch.xyz)]
            low = np.minimum(low, seen.min(axis=0, initial=np.inf))
            high = np.maximum(high, seen.max(axis=0, initial=-np.inf))
            rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
            safe = marks(batch, configuration) == PROTECTED
            labels, cluster = kept["label"][rows], kept["cluster"][rows]
            dynamic = self._dynamic(rows, cuts) & ~safe
            labels[labels == Label.DYNAMIC] = Label.STATIC
            labels[dynamic] = Label.DYNAMIC
            found += np.bincount(labels, minlength=len(Label))
            removed += np.bincount(cluster[dynamic], minlength=len(counts))
            self._take(file, batch, rows, safe)
            self._observer.advance(len(batch.xyz))
        check_parts(low, high, configuration, self._observer)
        clusters = tuple(
            ClusterSummary(
                each.index,
                each.centroid,
                each.count,
                float(percentages[each.index]),
                cuts[each.index].density,
                int(removed[each.index]),
            )
            for each in self._report.clusters
        )
        decision, views = DecisionSums.merged(self._sums).decision(), None
        if self._reports:
            views = partial(self._views, clusters, decision)
        return CleanedMap(
            kept,
            {label.title: int(found[label]) for label in Label},
            clusters,
            decision,
            views,
            time=self._report.time if removal.weighs_evidence else None,
        )

    def _views(self, clusters: Sequence[ClusterSummary], decision: Decision) -> Views:
        """Return what the report shows."""
        sample = MapSample.of_parts(self._collection.point_count, self._shown)
        if self._scans:
            views = None
            if self._sensor is not None:
                gather(self._returns, len(self._sensor), self._returns_of_batches)
                views = ScanViews(self._sensor, kept_returns(self._returns).images)
            cores = available_cores(self._configuration.execution.workers)
            sample = sample.seen(np.concatenate(self._scans), views, cores)
        return Views.of(sample, clusters, self._configuration.removal, decision)

    def _cuts(self, percentages: Sequence[Fraction]) -> list[Cut]:
        """Find where each cluster is cut, by the clusters' own numbers."""
        if self._configuration.removal.weighs_evidence:
            return [Cut(None)] * len(self._counts)
        total = self._collection.point_count
        self._observer.stage("rescale", total)
        tiles = [
            _ScoredRows(self._kept, slice(start, start + _ROWS_AT_A_TIME))
            for start in range(0, total, _ROWS_AT_A_TIME)
        ]
        threshold = self._configuration.removal.threshold
        return find_cuts(tiles, self._counts, percentages, threshold)

    def _dynamic(self, rows: slice, cuts: Sequence[Cut]) -> NDArray[np.bool_]:
        removal, kept = self._configuration.removal, self._kept
        if removal.weighs_evidence:
            return remove_likely(kept["score"][rows], removal.confidence).dynamic
        cluster, density = kept["cluster"][rows], kept["density"][rows]
        dynamic = np.zeros(len(cluster), np.bool_)
        for index, cut in enumerate(cuts):
            members = np.flatnonzero(cluster == index)
            dynamic[members] = cut.dynamic(density[members], members + rows.start)
        return dynamic

    def _take(self, file: int, batch: PointBatch, rows: slice, safe: NDArray[np.bool_]) -> None:
        """Take over what the report shows of some points, and what it says of places."""
        removal, kept, xyz = self._configuration.removal, self._kept, batch.xyz
        label, cluster, density, score, reason = (kept[name][rows] for name in _KINDS)
        if removal.weighs_evidence:
            scores = np.where(safe, np.float32(np.nan), score)
            sums = DecisionSums.of(xyz, scores, reason, removal.confidence, NOWHERE)
        else:
            sums = DecisionSums.by_density(xyz[label == Label.DYNAMIC], NOWHERE)
        self._sums = [DecisionSums.merged([*self._sums, sums])]
        if self._reports:
            total, own = self._collection.point_count, np.arange(rows.start, rows.stop)
            apart = (label == Label.UNSCORED) & (cluster == NO_CLUSTER)
            apart |= label == Label.INVALID
            chosen = np.flatnonzero(is_sampled(own, total) & ~apart)
            columns: list[NDArray[Any]] = [own, xyz, label, cluster, density, score]
            self._shown.append(MapSample(total, *(column[chosen] for column in columns)))
            if self._source is not None:
                scan = self._source.numbers(self._collection, file, batch)
                self._scans.append(scan[chosen])
                if self._sensor is not None:
                    drawn = np.where(apart, np.int32(-1), scan)
                    returns = Returns.of(xyz, drawn, self._sensor)
                    part = {"counts": returns.counts}
                    write_arrays(
                        self._returns / f"{rows.start}.part", part, {"returns": returns.returns}
                    )

    def _returns_of_batches(self) -> Iterator[Returns]:
        for path in self._returns.glob("*.part"):
            yield Returns(*read_arrays(path, "counts", "returns"))
