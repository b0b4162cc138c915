"""What the report of `apply` shows of scans: it is found out again, as the run kept none of it."""

from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import NDArray

from dynahull.evidence.range_images import NOTHING, PIXELS, Images, Views, draw_into
from dynahull.progress import Observer
from pipeline.configuration.run import Configuration
from pipeline.outputs.map_sample import MapSample
from pipeline.scan_numbers import find_scans
from pipeline.scan_source import ScanSource
from pipeline.work.files import make_rows, open_rows
from tiling.collection import MapCollection
from tiling.formats.points import PointBatch


class SeenAgain:
    """Scan numbers of all points, and the range images of scans with poses, in files.

    Parameters
    ----------
    collection : MapCollection
        The map.
    source : ScanSource
        Of its scan numbers.
    folder : Path
        Where the files are made.
    """

    def __init__(self, collection: MapCollection, source: ScanSource, folder: Path) -> None:
        self._collection, self._source = collection, source
        make_rows(folder / "scan", collection.point_count, np.int32, -1)
        self._scan = open_rows(folder / "scan", np.int32, "r+")
        self._sensor = source.sensor(collection)
        if self._sensor is not None:
            make_rows(folder / "images", len(self._sensor) * PIXELS, np.uint16, NOTHING)
            images = np.asarray(open_rows(folder / "images", np.uint16, "r+"))
            self._images: Images = images.reshape(-1, PIXELS)

    @classmethod
    def of(
        cls,
        collection: MapCollection,
        configuration: Configuration,
        folder: Path,
        observer: Observer,
    ) -> Self | None:
        """Find out what tells scans; None where nothing does, or no report asks for it."""
        if not configuration.removal.weighs_evidence or configuration.output.report != "html":
            return None
        source = find_scans(collection, configuration, observer)
        return None if source is None else cls(collection, source, folder)

    def add(self, file: int, batch: PointBatch, apart: NDArray[np.bool_]) -> None:
        """Take points of a file; those that are `apart` took no part, and are in no image."""
        scan = self._source.numbers(self._collection, file, batch)
        self._scan[batch.first_row : batch.first_row + len(scan)] = scan
        if self._sensor is not None:
            drawn = np.where(apart, np.int32(-1), scan)
            draw_into(self._images, batch.xyz, drawn, self._sensor)

    def in_sample(self, sample: MapSample, threads: int) -> MapSample:
        """Return a sample of the map with what scans saw of it, once all points were added."""
        views = None
        if self._sensor is not None:
            views = Views(self._sensor, lambda rows: np.asarray(self._images[rows]))
        return sample.seen(self._scan[sample.rows], views, threads)
