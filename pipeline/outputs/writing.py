"""What a run made of a map, and the files that it is written into."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from dynahull.labels import Label
from dynahull.result import ClusterSummary
from pipeline.configuration.run import OutputParameters
from pipeline.errors import LostPointsError
from pipeline.outputs.folder import OutputNames
from pipeline.outputs.modes import OutputMode, Scores, mode_of
from pipeline.places import Decision
from pipeline.progress import StageObserver
from pipeline.report_page.charts import TileWork
from pipeline.report_page.report_page import Views
from tiling.collection import MapCollection
from tiling.formats import MapReader, PointBatch, open_map
from tiling.formats.points import DEFAULT_BATCH
from tiling.output_file import create_file


@dataclass(frozen=True, slots=True)
class CleanedMap:
    """What became of every point, in memory or in files that look like it."""

    rows: Mapping[str, NDArray[Any]]
    """(N,) each: `label`; where they are asked for `cluster`, `density`, `score` and `reason`."""
    counts: dict[str, int]
    """Points of each label."""
    clusters: tuple[ClusterSummary, ...]
    decision: Decision
    views: Callable[[], Views] | None = None
    """Gives what the report shows; None where none is wanted."""
    tiles: TileWork | None = None
    """What they took; None where no report is wanted, or the map is one tile."""
    time: str | None = None
    """What told when points were seen, "none" where nothing did; None where nobody asked."""


def make_places(names: OutputNames, folder: Path) -> list[tuple[Path, ...]]:
    """Return the outputs of each file of the map, in a folder; make the folders they go to."""
    outputs = [tuple(folder / name for name in of_file) for of_file in names.by_file]
    for place in chain.from_iterable(outputs):
        place.parent.mkdir(parents=True, exist_ok=True)
    return outputs


@dataclass(frozen=True, slots=True)
class MapPart:
    """What goes into outputs of its own: the points of a file of the map, or of all its files."""

    name: str
    """What to call it in messages."""
    reader: MapReader
    """Whose writers write the points."""
    rows: slice
    """Of the map."""
    batches: Callable[[int], Iterator[PointBatch]]
    """Gives the points, so many at a time, counted from the first of them."""

    @property
    def count(self) -> int:
        """How many points there are."""
        return int(self.rows.stop - self.rows.start)


def parts_of(collection: MapCollection, merge: bool) -> list[MapPart]:
    """Return what goes into outputs of its own: each file of the map, or with `merge` all of it."""
    if merge:
        rows, reader = slice(0, collection.point_count), collection.readers[0].merged()
        return [MapPart(collection.name, reader, rows, partial(merged_batches, collection))]
    bounds = pairwise([*collection.first_rows, collection.point_count])
    return [
        MapPart(str(reader.description.path), reader, slice(*rows), reader.batches)
        for reader, rows in zip(collection.readers, bounds, strict=True)
    ]


def write_maps(
    collection: MapCollection,
    output: OutputParameters,
    labels: NDArray[np.uint8],
    scores: Scores,
    outputs: Sequence[tuple[Path, ...]],
    observer: StageObserver,
    written: Collection[int] = (),
    read: Callable[[int], Iterable[PointBatch]] | None = None,
) -> None:
    """Stream the input once more into its outputs, in order, with all fields.

    With `output.merge`, all files go into the same outputs, in the map's frame.

    Parameters
    ----------
    labels : (N,) uint8 array
    scores : Scores
        There where the outputs are labelled.
    outputs : sequence of tuple of Path
        Of each file of the map.
    written : collection of int
        Files of the map whose outputs are there already.
    read : callable, optional
        Gives the points of a file of the map; otherwise it is read again.

    Raises
    ------
    LostPointsError
        When the files written do not add up to the input.
    """
    parts = parts_of(collection, output.merge)
    streams = [index for index in range(len(parts)) if index not in written]
    if streams:
        observer.stage("write", sum(parts[index].count for index in streams))
    for index in streams:
        part = parts[index]
        own = {name: values[part.rows] for name, values in scores.items()}
        mode = mode_of(part.reader, output, labels[part.rows], own)
        batches: Iterable[PointBatch] = part.batches(DEFAULT_BATCH)
        if read is not None and not output.merge:
            batches = read(index)
        _stream(batches, mode, mode.counts(range(part.count)), outputs[index], observer)
    for part, places in zip(parts, outputs, strict=True):
        found = sum(open_map(path).description.point_count for path in places)
        if found != part.count:
            raise LostPointsError(f"{part.name}: {part.count} points read, {found} written")


def _stream(
    batches: Iterable[PointBatch],
    mode: OutputMode,
    counts: Sequence[int],
    places: Sequence[Path],
    observer: StageObserver,
) -> None:
    """Write points into one or two outputs, which will hold so many of them."""
    with ExitStack() as stack:
        writers = [
            stack.enter_context(each.writer(path, count))
            for each, path, count in zip(mode.formats, places, counts, strict=True)
        ]
        for batch in batches:
            for writer, records in zip(writers, mode.records(batch), strict=True):
                writer.write(records)
            observer.advance(len(batch.xyz))


def merged_batches(
    collection: MapCollection, max_points: int = DEFAULT_BATCH
) -> Iterator[PointBatch]:
    """Yield the points of all files as `output.merge` writes them: in the map's frame."""
    metres = 1.0 if collection.metres is None else collection.metres
    for file, batch in collection.batches(max_points):
        if not collection.is_moved:
            yield batch
            continue
        moved = collection.readers[file].moved(batch.records, batch.xyz / metres)
        yield replace(batch, records=moved)


def write_labels(cleaned: CleanedMap, path: Path) -> None:
    """Write what is known of every point, in input order, as Parquet."""
    titles = pa.array([label.title for label in Label])
    schema = pa.schema(
        {
            "label": pa.dictionary(pa.int8(), pa.string()),
            "cluster": pa.int32(),
            "density": pa.float64(),
            "score": pa.float32(),
            "reason": pa.uint8(),
        }
    )
    with ExitStack() as stack:
        file = stack.enter_context(create_file(path))
        writer = stack.enter_context(pq.ParquetWriter(file, schema, compression="zstd"))
        columns = [cleaned.rows[name] for name in schema.names]
        for start in range(0, len(columns[0]), DEFAULT_BATCH):
            codes, *rest = (np.asarray(each[start : start + DEFAULT_BATCH]) for each in columns)
            label = pa.DictionaryArray.from_arrays(pa.array(codes.astype(np.int8)), titles)
            table = pa.table([label, *map(pa.array, rest)], schema=schema)
            writer.write_table(table, row_group_size=DEFAULT_BATCH)
