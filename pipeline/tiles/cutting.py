"""Tasks that read the map: its survey, and its points cut into chunks."""

import numpy as np

from pipeline.tiles.job import Job
from pipeline.tiles.rows import open_rows
from pipeline.tiles.work import TaskReport
from tiling.chunks import assemble
from tiling.pieces import write_pieces
from tiling.survey import survey


def survey_rows(job: Job, number: int) -> TaskReport:
    """Survey one range of rows."""
    rows = job.row_ranges[number]
    job.work.save("survey", number, **survey(job.collection, rows).to_arrays())
    return TaskReport(len(rows))


def cut_rows(job: Job, number: int) -> TaskReport:
    """Sort one range of rows by tile into a piece; keep their classes where they are needed."""
    rows = job.row_ranges[number]
    written = write_pieces(job.store, job.collection, rows, number)
    if job.needs_classes:
        classes = open_rows(job.rows_path("class"), np.uint8, "r+")
        for _, batch in job.collection.batches(rows=rows):
            if batch.classification is not None:
                last = batch.first_row + len(batch.xyz)
                classes[batch.first_row : last] = batch.classification
    return TaskReport(len(rows), (written,))


def assemble_tile(job: Job, tile: int) -> TaskReport:
    """Gather the points of a tile from all pieces into its chunk."""
    held = assemble(job.store, tile)
    return TaskReport(int(job.store.layout.counts[tile]), (held,))
