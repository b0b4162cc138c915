"""A map of one tile: cleaned in memory."""

from functools import partial
from pathlib import Path
from threading import Thread

from dynahull import clean
from dynahull.loading import load_libraries
from pipeline.cleaned_map import CleanedMap
from pipeline.configuration import Configuration
from pipeline.decoded import MOST_KEPT, read_map
from pipeline.machine import available_cores
from pipeline.outputs import OutputNames
from pipeline.progress import StageObserver
from pipeline.report_page.page import Views
from pipeline.report_page.sample import MapSample
from pipeline.resources import memory_left
from pipeline.write_results import write_maps
from tiling.formats.collection import MapCollection
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
    decoded = read_map(collection, most_kept, observer)
    sample = decoded.points[:: max(len(decoded.points) // _LOOKED_AT, 1)]
    for note in coarse_step_notes(collection.readers, typical_place(sample)):
        observer.warn(note)
    result = clean(
        decoded.points,
        configuration.method(),
        classification=decoded.classification,
        threads=available_cores(configuration.execution.workers),
        observer=observer,
    )
    views = None
    if configuration.output.report == "html":
        shown = MapSample.of_map(decoded.points, result.labels, result.cluster, result.density)
        views = partial(Views.of, shown, result.clusters, configuration.removal)
    output = configuration.output
    write_maps(
        collection,
        output,
        result.labels,
        result.density,
        names,
        staging,
        observer,
        read=decoded.batches,
    )
    return CleanedMap(
        result.labels, result.cluster, result.density, result.counts(), result.clusters, views
    )
