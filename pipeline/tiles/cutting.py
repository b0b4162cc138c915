"""Tasks that read the map: its survey, and its points cut into chunks."""

from collections.abc import Iterator
from functools import partial

from pipeline.taking_part import Watcher
from pipeline.tiles.taking_part import PointsTakingPart, make_left_out, note_left_out
from pipeline.work.folder import TaskReport
from pipeline.work.job import Job
from pipeline.work.rows import write_rows
from tiling.chunks import assemble, has_chunk
from tiling.formats.points import PointBatch
from tiling.output_file import make_sized
from tiling.pieces import write_pieces
from tiling.survey import survey_batches


def make_copies(job: Job) -> None:
    """Make the files for what the survey keeps of the map; what is there of them stays."""
    if job.needs_classes:
        make_sized(job.rows_path("class"), job.collection.point_count)
    make_left_out(job)
    if job.decoded is not None:
        job.decoded.make()


def needs_pieces(job: Job, stage: str) -> bool:
    """Tell whether a stage that gathers chunks from the pieces has any to gather yet."""
    tiles = range(len(job.store.layout))
    undone = any(job.work.report(stage, tile) is None for tile in tiles)
    return undone and not all(has_chunk(job.store, tile) for tile in tiles)


def survey_rows(job: Job, number: int) -> TaskReport:
    """Survey one range of rows; keep of them what the map need not be read for again."""
    rows = job.row_ranges[number]
    read = job.collection.batches(rows=rows)
    batches = (batch for _, batch in read) if job.decoded is None else job.decoded.keep(read)
    if job.needs_classes:
        batches = _classes_kept(job, batches)
    watcher = Watcher(job.configuration, partial(note_left_out, job))
    survey = survey_batches(watcher.watch(batches))
    job.work.save("survey", number, **survey.to_arrays(), **watcher.outskirts.to_arrays())
    return TaskReport(len(rows), (watcher.left_out,))


def _classes_kept(job: Job, batches: Iterator[PointBatch]) -> Iterator[PointBatch]:
    for batch in batches:
        if batch.classification is not None:
            write_rows(job.rows_path("class"), batch.first_row, batch.classification)
        yield batch


def cut_rows(job: Job, number: int) -> TaskReport:
    """Sort one range of rows by tile into a piece."""
    rows = job.cut_ranges[number]
    written = write_pieces(job.store, PointsTakingPart(job), rows, number)
    return TaskReport(len(rows), (written,))


def assemble_tile(job: Job, tile: int) -> TaskReport:
    """Gather the points of a tile from all pieces into its chunk."""
    chunk = assemble(job.store, tile)
    return TaskReport(int(job.store.layout.counts[tile]), (len(chunk),))
