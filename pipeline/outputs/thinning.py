"""The static map thinned: of each voxel the point nearest to its middle, or the means there.

Voxels are anchored at the origin of the coordinates. Points are sorted into files by voxel first,
so that memory does not grow with the map, and the choice does not depend on how it was cut.
"""

import re
import shutil
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.checking import valid_points
from dynahull.labels import Label
from pipeline.configuration.run import OutputParameters
from pipeline.outputs.writing import MapPart, parts_of
from pipeline.progress import StageObserver
from pipeline.work.files import make_rows, open_rows
from tiling.collection import MapCollection
from tiling.formats import Field, MapReader, PointBatch
from tiling.formats.points import DEFAULT_BATCH
from tiling.output_file import create_file

_WORDS = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|\d+")
_NO_QUANTITIES = frozenset(
    {"label", "labels", "class", "classes", "classification", "category", "semantic", "object"}
    | {"segment", "instance", "cluster", "reason", "original", "user", "source", "id", "ids"}
    | {"index", "number", "count", "line", "ring", "channel", "scan", "frame", "sweep"}
    | {"return", "returns", "flag", "flags", "synthetic", "key", "withheld", "overlap", "edge"}
    | {"normal", "normals", "nx", "ny", "nz", "qw", "qx", "qy", "qz", "wavepacket", "wave", "t"}
)
"""Words in the names of fields of which no mean is one."""

_COLOURS = ("rgb", "rgba", "bgr", "bgra")
"""Fields that hold a channel in each of their four bytes."""

_HALF = 32
"""Bits: sums of either half of a number cannot overflow."""


@dataclass(frozen=True, slots=True)
class Means:
    """The means of the points of a thinned file, in its order, in a file of their own.

    Quantities are averaged in their own type, rounded where it is of integers; packed colours
    channel by channel. Labels, classes, numbers, flags and directions are those of the nearest
    point.
    """

    path: Path
    dtype: np.dtype[Any]

    @property
    def names(self) -> tuple[str, ...]:
        """The fields."""
        return self.dtype.names or ()


def averaged_fields(reader: MapReader) -> list[str]:
    """Return the names of the fields whose values are averaged."""
    every = reader.description.fields
    names = [field.name for field in every]
    return [
        field.name
        for field in every
        if field.count == 1 and names.count(field.name) == 1 and _is_quantity(field)
    ]


def _is_quantity(field: Field) -> bool:
    try:
        kind = np.dtype(field.dtype)
    except TypeError:  # no number
        return False
    words = {word.lower() for word in _WORDS.findall(field.name)}
    is_number = bool(words & _NO_QUANTITIES) or any(word.endswith("id") for word in words)
    is_quantity = not is_number or "angle" in words  # `scan_angle` is one
    return _is_packed(field.name, kind) or (kind.kind in "iuf" and is_quantity)


def _is_packed(name: str, kind: np.dtype[Any]) -> bool:
    return name.lower() in _COLOURS and kind.itemsize == 4


def write_means(
    reader: MapReader,
    batches: Iterable[PointBatch],
    owners: NDArray[np.int64],
    first: int,
    work: Path,
    files: int,
    observer: StageObserver,
) -> Means:
    """Average the fields of a file's points, each over its voxel.

    Parameters
    ----------
    batches : iterable of PointBatch
        All points of a file.
    owners : (n,) int64 array
        For each of them the row, in the map, of the nearest point of its voxel; -1 for none.
    first : int
        Row, in the map, of the file's first point. What other files own is left out.
    work : Path
        Where temporary files may lie; there must be none.
    files : int
        Into which the points are sorted.
    """
    names, record = averaged_fields(reader), np.dtype([])
    paths = [work / f"{number}" for number in range(files)]
    with ExitStack() as stack:
        streams = [stack.enter_context(create_file(path)) for path in paths]
        for batch in batches:
            if not record.names:
                record = _record(reader, names, batch)
            owner = owners[batch.first_row : batch.first_row + len(batch.xyz)] - first
            own = (owner >= 0) & (owner < len(owners))
            points = np.zeros(int(np.count_nonzero(own)), record)
            points["owner"] = owner[own]
            points["nearest"] = points["owner"] == batch.first_row + np.flatnonzero(own)
            for name in list(names):
                values = reader.values(batch.records, name)
                if record["values"][name].kind in "iu" and values.dtype.kind == "f":
                    names.remove(name)  # integers with nulls: those of the nearest are taken
                else:
                    points["values"][name] = values[own]
            file = points["owner"] * files // max(len(owners), 1)
            for number in np.unique(file).tolist():
                streams[number].write(points[file == number].tobytes())
            observer.advance(len(batch.xyz))
    means = Means(work / "means", np.dtype([(name, record["values"][name]) for name in names]))
    with create_file(means.path) as stream:
        for path in paths:
            points = np.fromfile(path, record)
            stream.write(_averaged(points[np.argsort(points["owner"], kind="stable")], means))
            path.unlink()
    return means


def _record(reader: MapReader, names: list[str], batch: PointBatch) -> np.dtype[Any]:
    """Return what is kept of a point; scaled numbers of LAS are not the integers it describes."""
    kinds = [reader.values(batch.records[:0], name).dtype.newbyteorder("=") for name in names]
    values = np.dtype([*zip(names, kinds, strict=True)])
    return np.dtype([("owner", "<i8"), ("nearest", "?"), ("values", values)])


def _averaged(points: NDArray[Any], means: Means) -> bytes:
    """Return the means of points that are sorted by owner."""
    new = np.ones(len(points), np.bool_)
    new[1:] = points["owner"][1:] != points["owner"][:-1]
    group = np.cumsum(new) - 1
    found = np.empty(int(np.count_nonzero(new)), means.dtype)
    for name in means.names:
        values = points["values"][name]
        if _is_packed(name, values.dtype):
            channels = np.ascontiguousarray(values).view(np.uint8).reshape(-1, 4)
            columns = [_mean_of_integers(channels[:, each], group, new) for each in range(4)]
            found[name] = np.stack(columns, axis=1).view(values.dtype)[:, 0]
        elif values.dtype.kind == "f":
            found[name] = _mean_of_floats(values, group, values[points["nearest"]])
        else:
            found[name] = _mean_of_integers(values, group, new)
    return found.tobytes()


def _mean_of_floats(
    values: NDArray[Any], group: NDArray[np.intp], nearest: NDArray[Any]
) -> NDArray[np.float64]:
    """Average what is finite, added up in the order of the rows; what has no mean is the nearest's.

    The differences from the nearest are added up, so that few digits are lost far from the origin.
    """
    count, finite = len(nearest), np.isfinite(values)
    wide = nearest.astype(np.float64)
    about = np.where(np.isfinite(wide), wide, 0.0)
    with np.errstate(over="ignore", invalid="ignore"):
        off = values[finite].astype(np.float64) - about[group[finite]]
        total = np.bincount(group[finite], off, count)
        there = np.bincount(group[finite], minlength=count)
        mean = about + total / np.maximum(there, 1)
    return np.where((there > 0) & np.isfinite(mean), mean, wide)


def _mean_of_integers(
    values: NDArray[Any], group: NDArray[np.intp], new: NDArray[np.bool_]
) -> NDArray[Any]:
    """Average exactly, and round: halves up."""
    starts, count = np.flatnonzero(new), np.bincount(group)
    if not len(starts):
        return values
    wide = values.astype(np.uint64 if values.dtype.kind == "u" else np.int64)
    high = np.add.reduceat((wide >> wide.dtype.type(_HALF)).astype(np.int64), starts)
    low = np.add.reduceat((wide & wide.dtype.type((1 << _HALF) - 1)).astype(np.int64), starts)
    whole, rest = np.divmod(high, count)
    mean = (whole << _HALF) + ((rest << _HALF) + low + count // 2) // count
    return np.asarray(mean.astype(values.dtype))


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
