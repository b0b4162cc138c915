"""A map of one tile: cleaned in memory."""

from functools import partial
from pathlib import Path
from threading import Thread

import numpy as np
from numpy.typing import NDArray

from dynahull import clean
from dynahull.checking import valid_points
from dynahull.labels import Label
from dynahull.loading import load_libraries
from dynahull.parameters import RemovalParameters
from dynahull.result import NO_CLUSTER, CleaningResult
from pipeline.cleaned_map import CleanedMap
from pipeline.configuration.run import Configuration
from pipeline.decision import Decision
from pipeline.outputs.decoded import MOST_KEPT, read_map
from pipeline.outputs.folder import OutputNames
from pipeline.outputs.map_sample import MapSample
from pipeline.outputs.modes import PointScores
from pipeline.places import DecisionSums
from pipeline.plan.machine import available_cores
from pipeline.plan.resources import memory_left
from pipeline.progress import StageObserver
from pipeline.report_page.page import Views
from pipeline.taking_part import warn_of_left_out
from pipeline.write_results import write_maps
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
    # Reading leaves this process time to load what the method needs.
    Thread(target=load_libraries, daemon=True).start()
    most_kept = min(MOST_KEPT, memory_left(collection, configuration) // 2)
    decoded = read_map(collection, most_kept, observer, configuration.input)
    if decoded.left_out is not None:
        count = int(np.count_nonzero(decoded.left_out & valid_points(decoded.points)))
        warn_of_left_out(count, configuration.input, observer)
    sample = decoded.points[:: max(len(decoded.points) // _LOOKED_AT, 1)]
    for note in coarse_step_notes(collection.readers, typical_place(sample), collection.metres):
        observer.warn(note)
    result = clean(
        decoded.points,
        configuration.method(),
        classification=decoded.classification,
        left_out=decoded.left_out,
        threads=available_cores(configuration.execution.workers),
        observer=observer,
    )
    decision = _decision(decoded.points, result, configuration.removal)
    views = None
    if configuration.output.report == "html":
        # Points that took no part are in no tile of a map that is cut, and are not shown either.
        apart = (result.labels == Label.UNSCORED) & (result.cluster == NO_CLUSTER)
        labels = np.where(apart, np.uint8(Label.INVALID), result.labels)
        shown = MapSample.of_map(
            decoded.points, labels, result.cluster, result.density, result.score
        )
        views = partial(Views.of, shown, result.clusters, configuration.removal, decision)
    output = configuration.output
    write_maps(
        collection,
        output,
        result.labels,
        PointScores(
            result.density, result.score if configuration.removal.weighs_evidence else None
        ),
        names,
        staging,
        observer,
        read=decoded.batches,
    )
    return CleanedMap(
        result.labels,
        result.cluster,
        result.density,
        result.score,
        result.counts(),
        result.clusters,
        decision,
        views,
    )


def _decision(
    points: NDArray[np.float64], result: CleaningResult, removal: RemovalParameters
) -> Decision | None:
    if not removal.weighs_evidence:
        return None
    return DecisionSums.of(points, result.score, result.reason, removal.confidence).decision()
