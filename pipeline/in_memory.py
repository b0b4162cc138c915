"""A map of one tile: cleaned in memory."""

from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull import clean
from dynahull.checking import valid_points
from dynahull.evidence.range_images import Returns
from dynahull.evidence.range_images import Views as ScanViews
from dynahull.labels import Label
from dynahull.result import NO_CLUSTER, CleaningResult
from pipeline.configuration.run import Configuration
from pipeline.eligibility import LEFT_OUT, PROTECTED, check_parts, is_far, marks, warn_of_left_out
from pipeline.outputs.folder import OutputNames
from pipeline.outputs.map_sample import MapSample
from pipeline.outputs.modes import scores_of
from pipeline.outputs.writing import CleanedMap, make_places, write_maps
from pipeline.places import Decision, DecisionSums
from pipeline.plan.machine import available_cores
from pipeline.progress import StageObserver
from pipeline.report_page.report_page import Views
from pipeline.scan_numbers import find_scans
from pipeline.scan_source import ScanSource
from tiling.collection import MapCollection
from tiling.resolution import coarse_step_notes, typical_place

_LOOKED_AT = 10_000
"""Points that tell where the map lies."""


def clean_in_memory(
    collection: MapCollection,
    configuration: Configuration,
    names: OutputNames,
    staging: Path,
    observer: StageObserver,
) -> CleanedMap:
    """Clean a map of one tile, and write its results."""
    output, removal = configuration.output, configuration.removal
    source = find_scans(collection, configuration, observer) if removal.weighs_evidence else None
    observer.stage("reading", collection.point_count)
    points, classes, marked, scan = _read(collection, configuration, source, observer)
    unwanted, valid = marked == LEFT_OUT, valid_points(points)
    count = int(np.count_nonzero(unwanted & valid))
    outside = int(np.count_nonzero(valid & is_far(points, configuration)))
    warn_of_left_out(count, outside, configuration.input, observer)
    deciding = valid & ~unwanted
    within = points if deciding.all() else points[deciding]
    low, high = within.min(axis=0, initial=np.inf), within.max(axis=0, initial=-np.inf)
    check_parts(low, high, configuration, observer)
    del within, deciding
    sample = points[:: max(len(points) // _LOOKED_AT, 1)]
    for note in coarse_step_notes(collection, typical_place(sample), collection.metres):
        observer.warn(note)
    sensor = None if source is None else source.sensor(collection)
    result = clean(
        points,
        configuration.method(),
        classification=classes if collection.has_classification else None,
        left_out=unwanted if count else None,
        protected=marked == PROTECTED,
        scan=scan,
        poses=sensor,
        threads=available_cores(configuration.execution.workers),
        observer=observer,
    )
    views = None
    if removal.weighs_evidence:
        weighed = np.where(result.protected, np.float32(np.nan), result.score)
        sums = DecisionSums.of(points, weighed, result.reason, removal.confidence)
    else:
        sums = DecisionSums.by_density(points[result.labels == Label.DYNAMIC])
    decision = sums.decision()
    if output.report == "html":
        views = partial(_views, points, result, scan, sensor, configuration, decision)
    rows: dict[str, NDArray[Any]] = {
        "label": result.labels,
        "cluster": result.cluster,
        "density": result.density,
        "score": result.score,
        "reason": result.reason,
    }
    scores = scores_of(rows, configuration)
    places = make_places(names, staging)
    write_maps(collection, output, result.labels, scores, places, observer)
    return CleanedMap(
        rows,
        result.counts(),
        result.clusters,
        decision,
        views,
        time=str(source or "none") if removal.weighs_evidence else None,
    )


def _views(
    points: NDArray[np.float64],
    result: CleaningResult,
    scan: NDArray[np.int32] | None,
    sensor: NDArray[np.float64] | None,
    configuration: Configuration,
    decision: Decision,
) -> Views:
    """Return what the report shows: a sample of the map, and what scans saw of it."""
    # Points that took no part are in no tile of a map that is cut, and are not shown either.
    apart = (result.labels == Label.UNSCORED) & (result.cluster == NO_CLUSTER)
    labels = np.where(apart, np.uint8(Label.INVALID), result.labels)
    shown = MapSample.of_map(points, labels, result.cluster, result.density, result.score)
    if scan is not None:
        views = None
        if sensor is not None:
            drawn = np.where(labels == Label.INVALID, np.int32(-1), scan)
            views = ScanViews(sensor, Returns.of(points, drawn, sensor).images)
        cores = available_cores(configuration.execution.workers)
        shown = shown.seen(scan[shown.rows], views, cores)
    return Views.of(shown, result.clusters, configuration.removal, decision)


def _read(
    collection: MapCollection,
    configuration: Configuration,
    source: ScanSource | None,
    observer: StageObserver,
) -> tuple[NDArray[np.float64], NDArray[np.uint8], NDArray[np.uint8], NDArray[np.int32] | None]:
    """Return the points of a map, their classes, their marks, and their scans."""
    count = collection.point_count
    points, classes = np.empty((count, 3)), np.zeros(count, np.uint8)
    marked = np.zeros(count, np.uint8)
    scan = None if source is None else np.empty(count, np.int32)
    for file, batch in collection.batches():
        rows = slice(batch.first_row, batch.first_row + len(batch.xyz))
        points[rows] = batch.xyz
        if batch.classification is not None:
            classes[rows] = batch.classification
        marked[rows] = marks(batch, configuration)
        if source is not None and scan is not None:
            scan[rows] = source.numbers(collection, file, batch)
        observer.advance(len(batch.xyz))
    return points, classes, marked, scan
