"""A part of a map cleaned in seconds, to choose parameters by: `dynahull-pipeline preview`.

The part is a map of its own, in the format of the whole, and cleaned by an ordinary run.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pipeline.configuration.run import Configuration
from pipeline.eligibility import survey_map
from pipeline.errors import ConfigurationError, OutputError
from pipeline.metres import open_collection
from pipeline.outputs.folder import default_folder
from pipeline.outputs.run_report import RunReport
from pipeline.plan.machine import available_cores
from pipeline.progress import StageObserver
from pipeline.run import run
from pipeline.scan_numbers import find_scans
from tiling.collection import MapCollection, find_map_files
from tiling.formats.points import PointBatch
from tiling.output_file import atomic_file, writing_only_into
from tiling.survey import Occupancy

SMALLEST_SIDE = 4.0
"""Metres: a window that is chosen is no narrower, and thinned where it holds too many points."""

PART_FOLDER = ".dynahull-preview"
"""Within the output folder: the part of the map that is cleaned."""

_TYPICAL = 0.5
"""Share of a map's points that lie in squares of the size of a typical one, or in larger ones."""

_FILLED = 0.85
"""Of the points wanted, in a window that is chosen: its points are estimated from a few."""

_LOOKED_AT = 2_000_000
"""Points of a large map that a window is chosen by."""

_LOOKS = 2_000
"""Places of the file that they are read from: near in a file is often near in the map."""

_LOOKS_INTO_CHUNKS = 50
"""The same of compressed files: whatever is wanted of a chunk, all before it must be decoded."""


@dataclass(frozen=True, slots=True)
class Window:
    """A rectangle, seen from above: low <= x, y < high, metres."""

    low: tuple[float, float]
    high: tuple[float, float]

    def holds(self, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which points lie in it."""
        flat = xyz[:, :2]
        return np.asarray(((flat >= self.low) & (flat < self.high)).all(axis=1))

    def __str__(self) -> str:
        (left, bottom), (right, top) = self.low, self.high
        return f"x from {left:,.2f} to {right:,.2f} m, y from {bottom:,.2f} to {top:,.2f} m"


WHOLE = Window((-np.inf, -np.inf), (np.inf, np.inf))


def preview(
    maps: Sequence[str],
    output: Path | None,
    configuration: Configuration,
    observer: StageObserver,
    *,
    points: int,
    window: Window | None = None,
) -> RunReport:
    """Clean a part of a map, and write its report.

    Parameters
    ----------
    maps : sequence of str
        Files, folders or globs that together are one map.
    output : Path or None
        `<map>_preview` in the current folder by default.
    points : int
        Points of the part, at most; of more every n-th is taken.
    window : Window or None
        Where; None for a typical place. A map of few points is taken as a whole.

    Raises
    ------
    ConfigurationError
        When there is no point in the window.
    TilingError, DynaHullError, PipelineError
        As for `run`.
    """
    paths = find_map_files(maps)
    cores = available_cores(configuration.execution.workers)
    collection = open_collection(paths, configuration.input, cores)
    folder = output or _preview_folder(paths)
    values = configuration.model_dump()
    values["output"]["report"] = "html"
    configuration = Configuration.model_validate(values)
    if window is None and collection.point_count <= points:
        return run(list(paths), folder, configuration, observer)
    if window is None:
        window = _choose_window(collection, configuration, points, observer)
    part = _Part(points)
    kept = part.gathered(collection, window, observer)
    if not kept:
        raise ConfigurationError(f"{collection.name}: no point in the window, {window}")
    with writing_only_into(folder):
        files = _write_part(collection, kept, folder)
        configuration = _with_poses_of_part(collection, kept, files, configuration, observer)
    observer.warn(_description(part, window, collection))
    return run(files, folder, configuration, observer)


def typical_window(occupancy: Occupancy, scale: float, points: int) -> Window:
    """Find a square that is worth looking at: no sparse edge, and no place where all was seen from.

    Squares are as large as they may be for half of the map to lie in such that do not have too
    many points; of these the fullest is taken.

    Parameters
    ----------
    occupancy : Occupancy
        Of the map, or of some of its points.
    scale : float
        Points of the map for each one in the occupancy.
    points : int
        That the square should have at most. It has more where even squares of `SMALLEST_SIDE` do.
    """
    if not len(occupancy.counts):
        return WHOLE
    half = 1 << max(0, int(np.ceil(np.log2(SMALLEST_SIDE / 2 / occupancy.cell))))
    columns, counts = _together(occupancy.columns // half, occupancy.counts)
    cell, side = occupancy.cell * half, 2
    found = None
    while True:
        low, held = _squares(columns, counts, side)
        small = held * scale <= points
        fits = held[small].sum() >= _TYPICAL * held.sum()
        if found is not None and not fits:
            return found
        # Where even the smallest squares have too many points, one in the middle is thinned.
        chosen = int(np.argmax(np.where(small, held, -1))) if fits else _median(held)
        left, bottom = (low[chosen] * cell).tolist()
        found = Window((left, bottom), (left + side * cell, bottom + side * cell))
        if not fits or held[chosen] == counts.sum():
            return found
        side *= 2


def _median(held: NDArray[np.int64]) -> int:
    """Return the square that half of the points lie in less full ones than."""
    order = np.argsort(held, kind="stable")
    below = np.cumsum(held[order])
    return int(order[np.searchsorted(below, below[-1] / 2)])


def _squares(
    columns: NDArray[np.int64], counts: NDArray[np.int64], side: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return low corners and points of the squares of `side` columns that hold any.

    They are on four lattices, half a side apart.
    """
    corners, held = [], []
    for shift in ((x, y) for x in (0, side // 2) for y in (0, side // 2)):
        squares, points = _together((columns + shift) // side, counts)
        corners.append(squares * side - shift)
        held.append(points)
    return np.concatenate(corners), np.concatenate(held)


def _together(
    columns: NDArray[np.int64], counts: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Add up the counts of equal columns."""
    low = columns.min(axis=0)
    height = int(columns[:, 1].max() - low[1]) + 1
    keys = (columns[:, 0] - low[0]) * height + columns[:, 1] - low[1]
    distinct, inverse = np.unique(keys, return_inverse=True)
    places = np.column_stack([distinct // height, distinct % height]) + low
    return places, np.bincount(inverse, counts).astype(np.int64)


def _choose_window(
    collection: MapCollection, configuration: Configuration, points: int, observer: StageObserver
) -> Window:
    """Choose by a survey of the map, or of some places of one that is large and can be seeked."""
    total = collection.point_count
    seekable = all(reader.seekable for reader in collection.readers)
    ranges = [range(total)]
    if seekable and total > 2 * _LOOKED_AT:
        looks = _LOOKS if collection.writes_parts else _LOOKS_INTO_CHUNKS
        starts = [total * look // looks for look in range(looks)]
        ranges = [range(start, start + _LOOKED_AT // looks) for start in starts]
    observer.stage("looking", sum(len(rows) for rows in ranges))
    survey, _ = survey_map(_batches(collection, ranges, observer), configuration)
    scale = total / max(survey.point_count, 1)
    return typical_window(survey.occupancy, scale, round(_FILLED * points))


def _batches(
    collection: MapCollection, ranges: Iterable[range], observer: StageObserver
) -> Iterable[PointBatch]:
    for rows in ranges:
        for _, batch in collection.batches(rows=rows):
            yield batch
            observer.advance(len(batch.xyz))


class _Part:
    """Gathers the points of a window; every n-th by row number where there are too many.

    Each row has a rank, and those below a limit are held. The limit is halved as often as twice
    the points wanted are held, so that the points in the end do not depend on how they came.
    """

    def __init__(self, most: int) -> None:
        self.inside = 0
        self.count = 0
        self._most = most
        self._limit = 1.0
        self._held: list[tuple[int, PointBatch, NDArray[np.float64]]] = []

    def add(self, file: int, batch: PointBatch, window: Window) -> None:
        """Take what lies in the window."""
        inside = window.holds(batch.xyz) & np.isfinite(batch.xyz).all(axis=1)
        self.inside += int(np.count_nonzero(inside))
        ranks = _ranks(batch.first_row, len(batch.xyz))
        self._hold(file, batch, ranks, inside & (ranks < self._limit))
        while self.count > 2 * self._most:
            self._keep_below(self._limit / 2)

    def gathered(
        self, collection: MapCollection, window: Window, observer: StageObserver
    ) -> dict[int, list[PointBatch]]:
        """Return the batches of each file of a map, in order."""
        observer.stage("selecting", collection.point_count)
        for file, batch in collection.batches():
            self.add(file, batch, window)
            observer.advance(len(batch.xyz))
        if self.count > self._most:
            ranks = np.concatenate([ranks for _, _, ranks in self._held])
            self._keep_below(float(np.partition(ranks, self._most)[self._most]))
        files: dict[int, list[PointBatch]] = {}
        for file, batch, _ in self._held:
            files.setdefault(file, []).append(batch)
        return files

    def _keep_below(self, limit: float) -> None:
        self._limit, held, self.count = limit, self._held, 0
        self._held = []
        for file, batch, ranks in held:
            self._hold(file, batch, ranks, ranks < limit)

    def _hold(
        self, file: int, batch: PointBatch, ranks: NDArray[np.float64], chosen: NDArray[np.bool_]
    ) -> None:
        if chosen.any():
            some = PointBatch(batch.first_row, batch.xyz[chosen], batch.select(chosen))
            self._held.append((file, some, ranks[chosen]))
            self.count += len(some.xyz)


def _ranks(first_row: int, count: int) -> NDArray[np.float64]:
    """Return numbers in [0, 1) for consecutive rows, as evenly spread as the golden ratio makes."""
    rows = np.arange(first_row, first_row + count, dtype=np.uint64)
    return np.asarray((rows * np.uint64(0x9E3779B97F4A7C15) >> np.uint64(11)) * 2.0**-53)


def _write_part(
    collection: MapCollection, kept: dict[int, list[PointBatch]], folder: Path
) -> list[Path]:
    """Write the part as maps like those it comes from, into a folder that is ours alone."""
    place = folder / PART_FOLDER
    if place.is_symlink():
        raise OutputError(f"{place}: expected a folder of a preview's own, found a link")
    place.mkdir(parents=True, exist_ok=True)
    files = []
    for file, batches in kept.items():
        said = collection.readers[file].description
        number = f"{file + 1}_" if len(collection.readers) > 1 else ""
        path = place / f"part_{number}{said.path.stem}{said.suffix}"
        count = sum(len(batch.xyz) for batch in batches)
        reader = collection.readers[file]
        with atomic_file(path) as temporary, reader.writer(temporary, count) as writer:
            for batch in batches:
                writer.write(batch.records)
        files.append(path)
    return files


def _preview_folder(paths: Sequence[Path]) -> Path:
    return Path(default_folder(paths).name.removesuffix("_dynahull") + "_preview")


def _description(part: _Part, window: Window, collection: MapCollection) -> str:
    """Say what was cleaned, and what of it does not hold for the whole map."""
    where, rim = "the whole map", ""
    if window != WHOLE:
        where = f"the window {window}"
        rim = ", and what is at its rim lacks what lies beyond"
    thinned = ""
    if part.count < part.inside:
        thinned = f", thinned from {part.inside:,}, so that densities are lower than the map's"
    return (
        f"preview of {collection.name}: {part.count:,} of its {collection.point_count:,} points, "
        f"{where}{thinned}; clusters, and with them R_i, are those of this part{rim}"
    )


def _with_poses_of_part(
    collection: MapCollection,
    kept: Mapping[int, Sequence[PointBatch]],
    files: Sequence[Path],
    configuration: Configuration,
    observer: StageObserver,
) -> Configuration:
    """Return the configuration that a part is cleaned with; write its poses beside its `files`."""
    poses, beside = collection.poses, files[0].parent / "poses.txt"
    if poses is None or poses.counts is not None:
        return configuration
    if poses.are_of_files:
        frame = "map" if poses.are_applied else "sensor"
        np.savetxt(beside, poses.poses[list(kept)].reshape(-1, 12), "%.17g")
        return _changed(configuration, poses=str(beside), frame=frame)
    if not configuration.removal.weighs_evidence:
        return configuration
    source = find_scans(collection, configuration, observer)
    of_part = configuration
    if source is not None and not source.tenth:
        # Poses go with scans by their numbers, or else in order: of the part, all do in order.
        numbers = [
            source.numbers(collection, file, batch)
            for file, batches in kept.items()
            for batch in batches
        ]
        seen = np.unique(np.concatenate(numbers))
        np.savetxt(beside, poses.poses[seen[seen >= 0]].reshape(-1, 12), "%.17g")
        of_part = _changed(configuration, poses=str(beside))
    if source is None or _is_like(source.kind, files, of_part):
        return of_part
    observer.warn("the part has too few scans: it is decided without their poses")
    return _changed(configuration, poses=None)


def _is_like(kind: str, files: Sequence[Path], configuration: Configuration) -> bool:
    """Tell whether the scans of the part are found, and have poses, as those of the map."""
    try:
        collection = open_collection(files, configuration.input)
        found = find_scans(collection, configuration)
    except ConfigurationError:
        return False
    return found is not None and found.kind == kind and bool(found.of_poses)


def _changed(configuration: Configuration, **values: Any) -> Configuration:
    changed = configuration.input.model_copy(update=values)
    return configuration.model_copy(update={"input": changed})
