"""The static map thinned: of each voxel the point nearest to its middle, or the means there.

Voxels are anchored at the origin of the coordinates. Points are sorted into files by voxel first,
so that memory does not grow with the map, and the choice does not depend on how it was cut.
"""

import shutil
from collections.abc import Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynahull.checking import valid_points
from dynahull.labels import Label
from pipeline.configuration.run import OutputParameters
from pipeline.outputs.averaging import write_means
from pipeline.outputs.writing import MapPart, parts_of
from pipeline.progress import StageObserver
from pipeline.work.files import make_rows, open_rows
from tiling.collection import MapCollection
from tiling.formats.points import DEFAULT_BATCH
from tiling.output_file import create_file

_RECORD = np.dtype([("cell", "<i8", 3), ("off", "<f8"), ("row", "<i8")])
_POINTS_A_FILE = 2_000_000
_MOST_FILES = 500
"""That are open at a time; with more points than fit, files are larger."""

_PRIMES = np.array([73_856_093, 19_349_663, 83_492_791])


def write_thinned(
    collection: MapCollection,
    labels: NDArray[np.uint8],
    output: OutputParameters,
    places: Sequence[Path],
    staging: Path,
    observer: StageObserver,
) -> int:
    """Write the thinned map, a file for each of the map, or one of all; return its points.

    Dynamic points are left out, and those without finite coordinates, which are in no voxel.
    Temporary files lie in the staging folder.
    """
    work = staging / "voxels"
    work.mkdir()
    passes = 3 if output.voxel_fields == "mean" else 2
    observer.stage("thinning", passes * collection.point_count)
    owners = _find_owners(collection, labels, output, work, observer)
    parts = zip(parts_of(collection, output.merge), places, strict=True)
    count = sum(_write(part, owners[part.rows], output, at, work, observer) for part, at in parts)
    shutil.rmtree(work)
    return count


def _find_owners(
    collection: MapCollection,
    labels: NDArray[np.uint8],
    output: OutputParameters,
    work: Path,
    observer: StageObserver,
) -> NDArray[np.int64]:
    """Return, in a file, for each point the row of the nearest point of its voxel, -1 for none."""
    make_rows(work / "owners", collection.point_count, np.int64, -1)
    owners = open_rows(work / "owners", np.int64, "r+")
    assert output.voxel is not None
    for file in _sorted_by_voxel(collection, labels, output.voxel, work, observer):
        points = np.fromfile(file, _RECORD)
        order = np.lexsort((points["row"], points["off"], *points["cell"].T))
        cells, rows = points["cell"][order], points["row"][order]
        first = np.ones(len(cells), np.bool_)
        first[1:] = (cells[1:] != cells[:-1]).any(axis=1)
        owners[rows] = rows[first][np.cumsum(first) - 1]
        file.unlink()
    return owners


def _file_count(points: int) -> int:
    """Return into how many files points are sorted."""
    return min(max(points // _POINTS_A_FILE, 1), _MOST_FILES)


def _sorted_by_voxel(
    collection: MapCollection,
    labels: NDArray[np.uint8],
    voxel: float,
    work: Path,
    observer: StageObserver,
) -> list[Path]:
    """Write what decides of each point into files, all points of a voxel into one."""
    count = _file_count(collection.point_count)
    files = [work / f"{number}" for number in range(count)]
    with ExitStack() as stack:
        streams = [stack.enter_context(create_file(file)) for file in files]
        for _, batch in collection.batches():
            rows = np.arange(batch.first_row, batch.first_row + len(batch.xyz))
            kept = valid_points(batch.xyz) & (np.abs(batch.xyz) < voxel * 2.0**52).all(axis=1)
            kept &= labels[rows[0] : rows[-1] + 1] != Label.DYNAMIC
            points = np.empty(int(np.count_nonzero(kept)), _RECORD)
            places = batch.xyz[kept] / voxel
            cells = np.floor(places)
            points["cell"], points["row"] = cells, rows[kept]
            points["off"] = ((places - cells - 0.5) ** 2).sum(axis=1)
            file = (points["cell"] * _PRIMES).sum(axis=1) % count
            for number in np.unique(file).tolist():
                streams[number].write(points[file == number].tobytes())
            observer.advance(len(batch.xyz))
    return files


def _write(
    part: MapPart,
    owners: NDArray[np.int64],
    output: OutputParameters,
    place: Path,
    work: Path,
    observer: StageObserver,
) -> int:
    """Write those of some points that own themselves; return their number."""
    place.parent.mkdir(parents=True, exist_ok=True)
    reader, first = part.reader, part.rows.start

    def chosen(start: int, count: int = DEFAULT_BATCH) -> NDArray[np.bool_]:
        own = owners[start : start + count]
        return np.asarray(own == np.arange(start, start + len(own)) + first)

    starts = range(0, part.count, DEFAULT_BATCH)
    count = sum(int(np.count_nonzero(chosen(start))) for start in starts)
    means, batches = None, partial(part.batches, DEFAULT_BATCH)
    if output.voxel_fields == "mean":
        files = _file_count(part.count)
        means = write_means(reader, batches(), owners, first, work, files, observer)
    with ExitStack() as stack:
        writer = stack.enter_context(reader.writer(place, count))
        stream = None if means is None else stack.enter_context(means.path.open("rb"))
        for batch in batches():
            own = chosen(batch.first_row, len(batch.xyz))
            records = batch.select(own)
            if stream is not None and means is not None and means.names:
                values = np.fromfile(stream, means.dtype, int(np.count_nonzero(own)))
                records = reader.with_values(records, {name: values[name] for name in means.names})
            writer.write(records)
            observer.advance(len(batch.xyz))
    if means is not None:
        means.path.unlink()
    return count
