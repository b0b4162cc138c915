"""The static map thinned: of each voxel the point nearest to its middle, with all its fields.

Voxels are anchored at the origin of the coordinates. Points are sorted into files by voxel first,
so that memory does not grow with the map, and the choice does not depend on how it was cut.
"""

import shutil
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.checking import valid_points
from dynahull.labels import Label
from pipeline.configuration.run import OutputParameters
from pipeline.outputs.writing import merged_batches
from pipeline.progress import StageObserver
from pipeline.work.files import make_rows, open_rows
from tiling.collection import MapCollection
from tiling.formats import MapReader, PointBatch
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

    Points without finite coordinates are in no voxel, and are left out.

    Parameters
    ----------
    collection : MapCollection
    labels : (N,) uint8 array
        Dynamic points are left out.
    output : OutputParameters
        `voxel`, the edge in metres, and `merge`.
    places : sequence of Path
        Of the outputs.
    staging : Path
        Where temporary files may lie.
    observer : StageObserver
    """
    work = staging / "voxels"
    work.mkdir()
    make_rows(work / "chosen", collection.point_count, np.uint8, 0)
    chosen = open_rows(work / "chosen", np.uint8, "r+")
    observer.stage("thinning", 2 * collection.point_count)
    edge = output.voxel
    assert edge is not None
    for file in _sorted_by_voxel(collection, labels, edge, work, observer):
        points = np.fromfile(file, _RECORD)
        order = np.lexsort((points["row"], points["off"], *points["cell"].T))
        cells = points["cell"][order]
        first = np.ones(len(cells), np.bool_)
        first[1:] = (cells[1:] != cells[:-1]).any(axis=1)
        chosen[points["row"][order[first]]] = 1
        file.unlink()
    if output.merge:
        reader = collection.readers[0].merged()
        _write(reader, merged_batches(collection), chosen, places[0], observer)
    else:
        first_rows = [*collection.first_rows, collection.point_count]
        for reader, place, bounds in zip(
            collection.readers, places, pairwise(first_rows), strict=True
        ):
            _write(reader, reader.batches(), chosen[slice(*bounds)], place, observer)
    count = int(np.count_nonzero(chosen))
    shutil.rmtree(work)
    return count


def _sorted_by_voxel(
    collection: MapCollection,
    labels: NDArray[np.uint8],
    voxel: float,
    work: Path,
    observer: StageObserver,
) -> list[Path]:
    """Write what decides of each point into files, all points of a voxel into one."""
    count = min(max(collection.point_count // _POINTS_A_FILE, 1), _MOST_FILES)
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
    reader: MapReader,
    batches: Iterable[PointBatch],
    chosen: NDArray[Any],
    place: Path,
    observer: StageObserver,
) -> None:
    """Write the chosen ones of some points, numbered from 0, as a reader's file has them."""
    place.parent.mkdir(parents=True, exist_ok=True)
    with reader.writer(place, int(np.count_nonzero(chosen))) as writer:
        for batch in batches:
            own = chosen[batch.first_row : batch.first_row + len(batch.xyz)] != 0
            writer.write(batch.select(own))
            observer.advance(len(batch.xyz))
