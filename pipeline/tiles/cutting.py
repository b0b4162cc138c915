"""Tasks that read the map: its survey, which finds who takes part, and its points cut into chunks.

Points that are marked in the map are in a file of one value a row; all else that must be known of
who takes no part is a few numbers.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynahull.checking import valid_points
from dynahull.evidence.viewpoints import count_coordinates
from dynahull.evidence.voxels import Voxels
from dynahull.labels import Label
from dynahull.observer import Observer
from dynahull.strays import Strays, is_at_origin, warn_of_strays
from pipeline.eligibility import LEFT_OUT, PROTECTED, Watcher, hidden, may_mark, warn_of_left_out
from pipeline.work.files import open_rows, read_sealed, write_rows, write_sealed
from pipeline.work.folder import TaskReport
from pipeline.work.job import Job
from tiling.chunks import write_chunk
from tiling.formats.points import PointBatch
from tiling.output_file import make_sized
from tiling.pieces import gathered, sort_by_tile
from tiling.survey import survey_batches

SET_ASIDE_FILE = "set_aside.json"
COORDINATES = "coordinates"
_MARKS = "marks"
_AT_A_TIME = 1 << 22


@dataclass(frozen=True, slots=True, eq=False)
class SetAside:
    """What the whole map says of points that take no part."""

    heap: int
    """Points at exactly the origin, if they are a heap; otherwise 0."""
    strays: NDArray[np.int64]
    """(n,): row numbers, ascending."""
    left_out: int
    protected: int
    """Points that are marked so."""
    outside: int
    """Of those left out, the ones far from the window."""

    @property
    def unscored(self) -> int:
        """Points that are labelled so and are in no tile."""
        return self.left_out + len(self.strays)


def save_set_aside(job: Job, strays: Strays, left_out: int, protected: int, outside: int) -> None:
    """Keep what all ranges of rows together say."""
    values = {"heap": strays.heap, "strays": strays.rows.tolist(), "left_out": left_out}
    values |= {"protected": protected, "outside": outside}
    write_sealed(job.root / SET_ASIDE_FILE, values)


def warn_of_set_aside(job: Job, observer: Observer) -> None:
    """Say which points take no part."""
    known = set_aside(job)
    warn_of_left_out(known.left_out, known.outside, job.configuration.input, observer)
    warn_of_strays(known.heap, len(known.strays), observer)


def set_aside(job: Job) -> SetAside:
    """Return what `save_set_aside` kept."""
    path = job.root / SET_ASIDE_FILE
    return _read(path, path.stat().st_mtime_ns)


@lru_cache(maxsize=1)
def _read(path: Path, _changed: int) -> SetAside:
    stored = read_sealed(path)
    strays = np.array(stored["strays"], np.int64)
    counts = (stored[name] for name in ("left_out", "protected", "outside"))
    return SetAside(stored["heap"], strays, *counts)


class PointsTakingPart:
    """The points of a map, of which those are hidden that take no part."""

    def __init__(self, job: Job) -> None:
        self._job = job
        self._set_aside = set_aside(job)

    def batches(self, max_points: int, rows: range) -> Iterator[tuple[int, PointBatch]]:
        """Yield points of a range of rows; see `MapCollection.batches`."""
        source = self._job.decoded or self._job.collection
        for file, batch in source.batches(max_points, rows):
            yield file, hidden(batch, self._unwanted(batch))

    def _unwanted(self, batch: PointBatch) -> NDArray[np.bool_]:
        first, count = batch.first_row, len(batch.xyz)
        unwanted = ~valid_points(batch.xyz)
        if self._set_aside.heap:
            unwanted |= is_at_origin(batch.xyz)
        if self._set_aside.left_out:
            marked = open_rows(self._job.rows_path(_MARKS), np.uint8)
            unwanted |= marked[first : first + count] == LEFT_OUT
        strays = self._set_aside.strays
        start, stop = np.searchsorted(strays, [first, first + count])
        unwanted[strays[start:stop] - first] = True
        return unwanted


def label_unscored(job: Job, labels: NDArray[np.uint8]) -> None:
    """Label the points that are in no tile, yet are not invalid."""
    known = set_aside(job)
    labels[known.strays] = Label.UNSCORED
    if known.left_out:
        marked = open_rows(job.rows_path(_MARKS), np.uint8)
        for start in range(0, len(labels), _AT_A_TIME):
            of_block = np.flatnonzero(marked[start : start + _AT_A_TIME] == LEFT_OUT)
            labels[start + of_block] = Label.UNSCORED


def protected_rows(job: Job, rows: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Tell which points, by their row numbers, are never removed."""
    if not set_aside(job).protected:
        return np.zeros(len(rows), np.bool_)
    return np.asarray(open_rows(job.rows_path(_MARKS), np.uint8)[rows] == PROTECTED)


def make_copies(job: Job) -> None:
    """Make the files for what the survey keeps of the map; what is there of them stays."""
    if job.needs_classes:
        make_sized(job.rows_path("class"), job.collection.point_count)
    if may_mark(job.collection, job.configuration):
        make_sized(job.rows_path(_MARKS), job.collection.point_count)
    if job.scan_source is not None:
        size = job.collection.point_count * np.dtype(np.int32).itemsize
        make_sized(job.rows_path("scan"), size)
    if job.decoded is not None:
        job.decoded.make()


def survey_rows(job: Job, number: int) -> TaskReport:
    """Survey one range of rows; keep of them what the map need not be read for again."""
    rows = job.row_ranges[number]
    counts = [Voxels(np.zeros((0, 3), np.int32), np.zeros((0, 1), np.int64))]
    read = _values_kept(job, job.collection.batches(rows=rows), counts)
    batches = (batch for _, batch in read) if job.decoded is None else job.decoded.keep(read)

    def note(first_row: int, found: NDArray[np.uint8]) -> None:
        write_rows(job.rows_path(_MARKS), first_row, found)

    watcher = Watcher(job.configuration, note)
    survey = survey_batches(watcher.watch(batches))
    coordinates = Voxels.merged(counts).to_arrays(COORDINATES)
    strays = watcher.outskirts.to_arrays()
    job.work.save("survey", number, **survey.to_arrays(), **strays, **coordinates)
    return TaskReport(len(rows), (watcher.left_out, watcher.protected, watcher.outside))


def _values_kept(
    job: Job, read: Iterator[tuple[int, PointBatch]], counts: list[Voxels]
) -> Iterator[tuple[int, PointBatch]]:
    """Keep classes and scan numbers of points that pass, and count coordinates, where needed."""
    source = job.scan_source
    for file, batch in read:
        if job.needs_classes and batch.classification is not None:
            write_rows(job.rows_path("class"), batch.first_row, batch.classification)
        if source is not None:
            numbers = source.numbers(job.collection, file, batch)
            write_rows(job.rows_path("scan"), batch.first_row, numbers)
            counts.append(count_coordinates(batch.xyz, numbers, batch.first_row))
        yield file, batch


def cut_rows(job: Job, number: int) -> TaskReport:
    """Sort one range of rows by tile into a piece."""
    rows = job.cut_ranges[number]
    points, runs = sort_by_tile(job.store, PointsTakingPart(job), rows)
    job.work.save("cut", number, {"points": points}, runs=runs)
    return TaskReport(len(rows), (len(points),))


def gather_tile(job: Job, tile: int) -> TaskReport:
    """Gather the points of a tile from all pieces into its chunk; the report counts them."""
    runs = _runs_of_all(str(job.root), (job.root / "cut").stat().st_mtime_ns)
    own = runs[slice(*np.searchsorted(runs[:, 0], [tile, tile + 1]))]
    points = [
        job.work.map("cut", piece, "points")[first : first + count]
        for _, first, count, piece in own.tolist()
    ]
    chunk = gathered(job.store, tile, points)
    write_chunk(job.store, tile, chunk)
    return TaskReport(int(job.store.layout.counts[tile]), (len(chunk),))


@lru_cache(maxsize=1)
def _runs_of_all(folder: str, _changed: int) -> NDArray[np.int64]:
    """Return the runs of all pieces by tile, and of which piece each is, once for all tiles."""
    job = Job.open(folder)
    parts = [job.work.load("cut", piece, "runs")[0] for piece in range(len(job.cut_ranges))]
    pieces = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    runs = np.column_stack([np.concatenate(parts), pieces])
    return runs[np.argsort(runs[:, 0], kind="stable")]
