"""Proves from the files alone that a run lost nothing, and that its labels follow.

Inputs are the files that `run.json` names. They and the outputs are streamed side by side, and of
each point the whole record is compared, as the files store it.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.labels import Label
from dynahull.removal import removable_count, removal_count, removal_percentages, remove_likely
from pipeline.configuration.run import Configuration
from pipeline.eligibility import PROTECTED, marks
from pipeline.errors import OutputError, VerificationError
from pipeline.metres import open_collection
from pipeline.outputs.modes import DENSITY, LABEL, SCORE, mode_of, scores_of
from pipeline.outputs.reading import added_values, row_columns
from pipeline.outputs.run_report import InputFile, RunReport
from pipeline.outputs.writing import MapPart, parts_of
from pipeline.replacing import LABELS_FILE, RUN_FILE, no_result
from tiling.collection import MapCollection, content_hash
from tiling.foreign_text import printable_path
from tiling.formats import MapReader, PointBatch, open_map
from tiling.formats.points import DEFAULT_BATCH, row_digests

_BATCH = DEFAULT_BATCH // 4
_MOST_WAYS = 10_000
"""Ways to share equal points out to two outputs, that are followed at once."""

_SAFE = "protected"

Columns = dict[str, NDArray[Any]]


def find_results(folder: Path) -> list[Path]:
    """Return the output folder itself, or the output folders in it, each of one map.

    Raises
    ------
    VerificationError
        When there are none.
    """
    found = [folder] if (folder / RUN_FILE).is_file() else []
    found = found or sorted(path.parent for path in folder.rglob(RUN_FILE) if path.is_file())
    if not found:
        raise VerificationError(no_result(folder))
    return found


def verify(folder: Path) -> str:
    """Verify the results in the output folder of a run; say what was proven, in one line.

    Raises
    ------
    VerificationError
        When something is not as it must be.
    TilingError, OSError
        When a file cannot be read.
    """
    report, configuration = _read_report(folder)
    paths = [Path(file.path) for file in report.files]
    collection = open_collection(paths, configuration.input)
    if content_hash(paths) != report.input_hash:
        raise VerificationError(
            f"{collection.name}: expected the map that was cleaned, found one "
            f"that was changed since"
        )
    table = None
    if configuration.output.labels:
        table = _Rows(_table(folder / LABELS_FILE, configuration))
    parts = parts_of(collection, configuration.output.merge)
    for part, file in zip(parts, report.files, strict=False):  # merged are all into the first's
        _verify_part(folder, file, part, configuration, table)
    if table is not None and table.has_more():
        raise VerificationError(f"{folder / LABELS_FILE}: expected a row a point, found more")
    counts = report.counts
    gone = counts[Label.DYNAMIC.title]
    if sum(counts.values()) != collection.point_count:
        raise VerificationError(f"{folder / RUN_FILE}: expected counts of all points")
    said = (
        f"{report.points:,} points = {report.points - gone:,} static + {gone:,} dynamic, every "
        "field, in order"
    )
    if table is None:
        return said
    _verify_labels(folder, report, configuration, collection)
    follow = "scores" if configuration.removal.weighs_evidence else "densities"
    return f"{said}; labels follow from the {follow}"


def _read_report(folder: Path) -> tuple[RunReport, Configuration]:
    """Read what a run says of itself; all that it lists must be there."""
    try:
        report = RunReport.read(folder)
        configuration = Configuration.model_validate(report.configuration)
    except (OutputError, ValueError):
        raise VerificationError(no_result(folder)) from None
    missing = [name for name in report.outputs if not (folder / name).is_file()]
    if missing:
        raise VerificationError(f"{folder / missing[0]}: expected a result, found no file")
    return report, configuration


def _verify_part(
    folder: Path,
    file: InputFile,
    part: MapPart,
    configuration: Configuration,
    table: "_Rows | None",
) -> None:
    """Compare points of the input with what was written of them."""
    reader, batches = part.reader, part.batches(_BATCH)
    outputs = [_Output(folder / name, reader, file.labelled is None) for name in file.outputs]
    found = sum(output.count for output in outputs)
    if found != part.count:
        raise VerificationError(
            f"{folder / file.outputs[0]}: expected {part.count} points in all "
            f"outputs of {printable_path(file.path)}, found {found}"
        )
    if table is None and file.labelled is None:
        _verify_order(reader.description.path, batches, *outputs)
        return
    columns = table or _Rows(_labelled(folder / str(file.labelled), configuration))
    for batch in batches:
        own = columns.take(len(batch.xyz))
        scores = scores_of(own, configuration)
        mode = mode_of(reader, configuration.output, own[LABEL], scores)
        expected = mode.records(replace(batch, first_row=0))
        for output, records in zip(outputs, expected, strict=True):
            output.compare(row_digests(records))


class _Output:
    """One output, whose digests are read as they are asked for."""

    def __init__(self, path: Path, model: MapReader, same_fields: bool) -> None:
        reader = open_map(path)
        said, wanted = reader.description, model.description
        if same_fields and (said.fields, said.crs) != (wanted.fields, wanted.crs):
            raise VerificationError(f"{path}: expected the fields and the CRS of the input")
        self.count = said.point_count
        self._path = path
        self._batches = (row_digests(batch.records) for batch in reader.batches(_BATCH))
        self._held: list[bytes] = []
        self._first = 0

    def at(self, row: int) -> bytes | None:
        """Return the digest of a row, None behind the last one."""
        while row >= self._first + len(self._held):
            more = next(self._batches, None)
            if more is None:
                return None
            self._held += more
        return self._held[row - self._first]

    def forget(self, row: int) -> None:
        del self._held[: row - self._first]
        self._first = row

    def compare(self, digests: Sequence[bytes]) -> None:
        """Compare the next rows, and drop them."""
        for row, digest in enumerate(digests, self._first):
            if self.at(row) != digest:
                raise VerificationError(
                    f"{self._path}: expected point {row} as it is in the input, found another"
                )
        self.forget(self._first + len(digests))


def _verify_order(
    path: Path, batches: Iterable[PointBatch], static: _Output, dynamic: _Output
) -> None:
    """Check that two outputs, one point after the other, make up the input.

    Where a point is next in both, both ways are followed: what is known is how many points may have
    been taken from the first so far.
    """
    ways, row = [0], 0
    for batch in batches:
        for digest in row_digests(batch.records):
            following: list[int] = []
            for taken in ways:
                if dynamic.at(row - taken) == digest and following[-1:] != [taken]:
                    following.append(taken)
                if static.at(taken) == digest:
                    following.append(taken + 1)
            if not following:
                raise VerificationError(
                    f"{path}: expected point {row} next in an output, found it "
                    "in none, or not in its place"
                )
            if len(following) > _MOST_WAYS:
                raise VerificationError(
                    f"{path}: expected points that can be told apart, found "
                    f"too many that are equal near point {row}; run again with --labels"
                )
            ways, row = following, row + 1
        static.forget(ways[0])
        dynamic.forget(row - ways[-1])


class _Rows:
    """Columns of all points, taken some rows at a time."""

    def __init__(self, batches: Iterator[Columns]) -> None:
        self._batches = batches
        self._held: Columns = {}

    def has_more(self) -> bool:
        """Tell whether there are rows that nobody took."""
        return self._grow() or bool(self._held and len(self._held[LABEL]))

    def _grow(self) -> bool:
        """Hold further rows; tell whether there were any."""
        more, held = next(self._batches, None), self._held
        if more is None:
            return False
        self._held = {k: np.concatenate([held[k], v]) if held else v for k, v in more.items()}
        return True

    def take(self, count: int) -> Columns:
        while not self._held or len(self._held[LABEL]) < count:
            if not self._grow():
                raise VerificationError("expected a label for each point, found fewer")
        taken = {name: values[:count] for name, values in self._held.items()}
        self._held = {name: values[count:] for name, values in self._held.items()}
        return taken


def _table(path: Path, configuration: Configuration) -> Iterator[Columns]:
    names = [LABEL, "cluster", DENSITY, *([SCORE] if configuration.removal.weighs_evidence else [])]
    return row_columns(path, names, _BATCH)


def _labelled(path: Path, configuration: Configuration) -> Iterator[Columns]:
    """Yield what a labelled map says of its points."""
    names = [LABEL, DENSITY, *([SCORE] if configuration.removal.weighs_evidence else [])]
    for columns in zip(*(added_values(path, name) for name in names), strict=True):
        found: Columns = dict(zip(names, columns, strict=True))
        yield {**found, LABEL: found[LABEL].astype(np.uint8)}


def _protected(
    path: Path, collection: MapCollection, configuration: Configuration
) -> Iterator[Columns]:
    """Yield the columns of `labels.parquet`, and which points are protected."""
    rows = _Rows(_table(path, configuration))
    for _, batch in collection.batches(_BATCH):
        safe = marks(batch, configuration) == PROTECTED
        yield {**rows.take(len(safe)), _SAFE: safe}


def _verify_labels(
    folder: Path, report: RunReport, configuration: Configuration, collection: MapCollection
) -> None:
    """Check that labels follow from the densities, or from the scores; what is protected stays."""
    path = folder / LABELS_FILE

    def fail(expected: str) -> VerificationError:
        return VerificationError(f"{path}: expected {expected}, found other labels")

    removal = configuration.removal
    sums = _ClusterSums([cluster.index for cluster in report.clusters])
    labels = np.zeros(len(Label), np.int64)
    for columns in _protected(path, collection, configuration):
        safe, dynamic = columns[_SAFE], columns[LABEL] == Label.DYNAMIC
        if np.any(safe & dynamic):
            raise fail("protected points to stay")
        labels += np.bincount(columns[LABEL], minlength=len(Label))
        sums.add(columns)
        if removal.weighs_evidence:
            likely = remove_likely(columns[SCORE], removal.confidence).dynamic
            if not np.array_equal(likely & ~safe, dynamic):
                raise fail(f"points of a score of {removal.confidence} or more to be dynamic")
    if {label.title: int(labels[label]) for label in Label} != report.counts:
        raise fail(f"the counts of {RUN_FILE}")
    if removal.weighs_evidence:
        return
    if sums.gone.sum() != labels[Label.DYNAMIC]:
        raise fail("dynamic points to have a cluster and a finite density")
    shares = removal_percentages(
        sums.counts.tolist(), removal.min_percent, removal.max_percent, configuration.neighbours.k
    )
    reached = sums.thresholds(lambda: _protected(path, collection, configuration))
    for place, (cluster, share) in enumerate(zip(report.clusters, shares, strict=True)):
        number = cluster.index
        count, gone = int(sums.counts[place]), int(sums.gone[place])
        finite = int(sums.finite[place])
        if (cluster.count, cluster.removed) != (count, gone):
            raise fail(f"the points of cluster {number} that {RUN_FILE} has")
        wanted, spared = min(removal_count(share, count), finite), bool(sums.spared[place])
        if removal.threshold == "rank" and (gone > wanted if spared else gone != wanted):
            raise fail(f"{float(share):.2f} % of cluster {number} to be dynamic (Eq. 1)")
        fewest = 0 if spared else removable_count(share, count, finite)
        if removal.threshold == "stepped" and 0 < gone < fewest:
            raise fail(f"{float(share):.2f} % of cluster {number} or more to be dynamic")
        if not reached[place]:
            raise fail(f"the least dense points of cluster {number} to be dynamic")


class _ClusterSums:
    """What is counted of each cluster, in the order of their numbers, which may have gaps."""

    def __init__(self, numbers: list[int]) -> None:
        self._numbers = numbers
        self.counts, self.finite, self.gone, self.spared = np.zeros((4, len(numbers)), np.int64)
        self._densest = np.full(len(numbers), -np.inf)

    def add(self, columns: Columns) -> None:
        for place, rows, density, dynamic in self._clusters(columns):
            self.spared[place] += np.count_nonzero(columns[_SAFE][rows])
            finite = np.isfinite(density)
            self.counts[place] += len(density)
            self.finite[place] += np.count_nonzero(finite)
            self.gone[place] += np.count_nonzero(dynamic & finite)
            gone = density[dynamic & finite]
            self._densest[place] = gone.max(initial=self._densest[place])

    def thresholds(self, again: Callable[[], Iterator[Columns]]) -> list[bool]:
        """Tell for each cluster whether no point stays that is less dense than one that goes.

        Of points as dense as the densest that goes, those go that come first.
        """
        right = [True] * len(self.counts)
        last_gone = np.full(len(self.counts), -1)
        first_kept = np.full(len(self.counts), np.iinfo(np.int64).max)
        row = 0
        for columns in again():
            for place, rows, density, dynamic in self._clusters(columns):
                most = self._densest[place]
                stays = ~dynamic & ~columns[_SAFE][rows]
                right[place] &= not bool(np.any(stays & (density < most)))
                tied = density == most
                gone, kept = rows[tied & dynamic] + row, rows[tied & stays] + row
                last_gone[place] = gone.max(initial=last_gone[place])
                first_kept[place] = kept.min(initial=first_kept[place])
            row += len(columns[LABEL])
        in_order = (last_gone < first_kept).tolist()
        return [one and other for one, other in zip(right, in_order, strict=True)]

    def _clusters(self, columns: Columns) -> Iterator[tuple[int, Any, Any, Any]]:
        """Yield place, rows, densities, and which are dynamic, of the points of each cluster."""
        for place, number in enumerate(self._numbers):
            rows = np.flatnonzero(columns["cluster"] == number)
            yield place, rows, columns[DENSITY][rows], columns[LABEL][rows] == Label.DYNAMIC
