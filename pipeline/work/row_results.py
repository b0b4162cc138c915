"""What became of each row of the map, filled in from what the tasks of all tiles kept."""

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from dynahull.labels import Label
from dynahull.result import NO_CLUSTER
from pipeline.tiles.taking_part import label_unscored
from pipeline.work.job import Job
from pipeline.work.rows import make_rows, open_rows

LABELS: dict[str, tuple[DTypeLike, float]] = {"label": (np.uint8, Label.INVALID)}
SCORES: dict[str, tuple[DTypeLike, float]] = {
    "cluster": (np.int32, NO_CLUSTER),
    "density": (np.float64, np.nan),
    "score": (np.float32, np.nan),
}
"""Files of one value a row: their types, and what a row has that is in no tile."""


class RowResults:
    """Labels and, where wanted, clusters and densities, in files of one value a row.

    One process writes them. The rows of a tile lie all over a file: workers of several machines
    would write to the same page, and on NFS the last of them would undo what the others wrote.

    Parameters
    ----------
    job : Job
    """

    def __init__(self, job: Job) -> None:
        self._job = job
        kinds = LABELS | (SCORES if job.configuration.output.needs_scores else {})
        self._files: dict[str, NDArray[Any]] = {}
        for name, (kind, value) in kinds.items():
            make_rows(job.rows_path(name), job.collection.point_count, kind, value)
            self._files[name] = open_rows(job.rows_path(name), kind, "r+")
        label_unscored(job, self._files["label"])

    def add(self, tile: int) -> None:
        """Take over what the label task of a tile kept."""
        (rows,) = self._job.work.load("ground", tile, "core_rows")
        values = self._job.work.load("label", tile, *self._files)
        for file, of_tile in zip(self._files.values(), values, strict=True):
            file[rows] = of_tile

    def flush(self) -> None:
        """Let other processes see it, on other machines as well."""
        for file in self._files.values():
            if isinstance(file, np.memmap):
                file.flush()
