"""The finite points of maps, sorted into tiles on the disk: few of them are held at a time.

All maps of an evaluation are cut into the same tiles, a quadtree by the points of all together. A
point lies in the tile of its voxel's middle, so that no voxel is cut in two, and each tile of a map
knows the box of its points. Finite means here what `valid` means to the method: no coordinate is
NaN or beyond 1e150.
"""

from collections.abc import Iterator
from copy import copy
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.checking import valid_points
from dynahull.kernels import NO_RANK, NearestSearch
from dynahull.observer import Observer
from pipeline.errors import EvaluationError
from pipeline.evaluation.truth import Labels, RowReader, RowValues, Truth
from pipeline.plan.machine import available_cores
from tiling.collection import MapCollection
from tiling.formats.points import PointBatch
from tiling.layout import Layout, quadtree
from tiling.survey import merge, survey_batches

_Floats = NDArray[np.float64]


TILE_POINTS = 1_000_000
"""Points of all maps together in a tile, at most; a single column of more is not divided."""

BATCH = 250_000
"""Points that are read at a time."""

POINT_BYTES = 34
"""On the disk."""

_COLUMNS: dict[str, Any] = {
    "xyz": np.float64,
    "rows": np.int64,
    "labels": np.int8,
    "removed": np.bool_,
}


class TiledCloud:
    """The finite points of a map, or those of some labels: a file for each column of a tile.

    Attributes
    ----------
    low, high : (T, 3) float64 arrays
        Box of the points of each tile; infinities the wrong way round where there are none.
    """

    def __init__(self, name: str, folder: Path, tile_count: int) -> None:
        self.name = name
        self.low = np.full((tile_count, 3), np.inf)
        self.high = np.full((tile_count, 3), -np.inf)
        self._folder = folder
        self._counts = np.zeros((tile_count, len(Truth)), np.int64)
        self._chosen = np.ones(len(Truth), np.bool_)
        folder.mkdir(exist_ok=True)

    def choose(self, *labels: Truth) -> "TiledCloud":
        """Return the points of some labels only; they share the files."""
        chosen = copy(self)
        chosen._chosen = np.isin(np.arange(len(Truth)), labels)
        return chosen

    @property
    def counts(self) -> NDArray[np.int64]:
        """Points in each tile, (T,)."""
        return np.asarray(self._counts[:, self._chosen].sum(axis=1))

    def __len__(self) -> int:
        """Return the number of points."""
        return int(self.counts.sum())

    def tiles(self) -> Iterator[int]:
        """Yield the tiles that have points."""
        yield from np.flatnonzero(self.counts).tolist()

    def watched_tiles(self, stage: str, observer: Observer) -> Iterator[int]:
        """Yield the tiles that have points, and tell of the progress."""
        counts = self.counts
        observer.stage(stage, int(counts.sum()))
        for tile in np.flatnonzero(counts).tolist():
            yield tile
            observer.advance(int(counts[tile]))

    def box(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the lowest and the highest coordinates of all tiles that have points, (3,)."""
        some = self.counts > 0
        return (
            self.low[some].min(axis=0, initial=np.inf),
            self.high[some].max(axis=0, initial=-np.inf),
        )

    def append(self, tile: int, xyz: NDArray[np.float64], labels: Labels, **more: Any) -> None:
        """Put one or more points into a tile, after those that are there; (n, 3), and their labels.

        More columns are `rows`, (n,) int64, and `removed`, (n,) bool, where they are needed.
        """
        for name, values in {"xyz": xyz, "labels": labels, **more}.items():
            with self._path(tile, name).open("ab") as stream:
                np.ascontiguousarray(values, _COLUMNS[name]).tofile(stream)
        self.low[tile] = np.minimum(self.low[tile], xyz.min(axis=0))
        self.high[tile] = np.maximum(self.high[tile], xyz.max(axis=0))
        self._counts[tile] += np.bincount(labels, minlength=len(Truth))

    def relabel(self, tile: int, labels: Labels) -> None:
        """Give all points of a tile other labels."""
        np.asarray(labels, np.int8).tofile(self._path(tile, "labels"))
        self._counts[tile] = np.bincount(labels, minlength=len(Truth))

    def mark_removed(self, tile: int, removed: NDArray[np.bool_]) -> None:
        """Say which points of a tile were removed."""
        np.asarray(removed, np.bool_).tofile(self._path(tile, "removed"))

    def xyz(self, tile: int) -> NDArray[np.float64]:
        """Return the points of a tile, (n, 3), in the order of their rows."""
        return self._read(tile, "xyz")

    def rows(self, tile: int) -> NDArray[np.int64]:
        """Return the row numbers of the points of a tile, (n,)."""
        return self._read(tile, "rows")

    def labels(self, tile: int) -> Labels:
        """Return what is true of the points of a tile, (n,)."""
        return self._read(tile, "labels")

    def removed(self, tile: int) -> NDArray[np.bool_]:
        """Return which points of a tile were removed, (n,)."""
        return self._read(tile, "removed")

    def _read(self, tile: int, name: str) -> NDArray[Any]:
        values = np.fromfile(self._path(tile, name), _COLUMNS[name])
        if name == "xyz":
            values = values.reshape(-1, 3)
        if self._chosen.all():
            return values
        labels = np.fromfile(self._path(tile, "labels"), np.int8)
        return values[self._chosen[labels]]

    def _path(self, tile: int, name: str) -> Path:
        return self._folder / f"{tile}.{name}"


@dataclass(frozen=True, slots=True)
class CloudSource:
    """A map that is to be cut, and what is known of its rows."""

    collection: MapCollection
    chosen: RowValues | None = None
    """Which rows belong to the cloud; otherwise all."""
    labels: RowValues | None = None
    """`Truth` of each row; otherwise all points are called static."""
    removed: RowValues | None = None
    """Which rows were removed; otherwise the cloud does not know."""

    def batches(self) -> Iterator[tuple[int, dict[str, NDArray[Any]]]]:
        """Yield rows read, and `xyz`, `rows`, `labels` and perhaps `removed` of the points."""
        values = {"chosen": self.chosen, "labels": self.labels, "removed": self.removed}
        readers = {
            name: RowReader(each, self.collection.name) for name, each in values.items() if each
        }
        for _, batch in self.collection.batches(BATCH):
            count = len(batch.xyz)
            columns: dict[str, NDArray[Any]] = {
                "xyz": batch.xyz,
                "rows": np.arange(batch.first_row, batch.first_row + count),
                "labels": np.full(count, Truth.STATIC, np.int8),
            }
            for name, reader in readers.items():
                columns[name] = reader.take(count)
            wanted = valid_points(batch.xyz)
            if self.chosen is not None:
                wanted &= columns.pop("chosen")
            yield count, {name: column[wanted] for name, column in columns.items()}


def cut_clouds(
    sources: dict[str, CloudSource], voxel: float, folder: Path, observer: Observer
) -> dict[str, TiledCloud]:
    """Cut maps, which have a finite point each, into the same tiles, of whole voxels."""
    total = sum(source.collection.point_count for source in sources.values())
    observer.stage("survey", total)
    surveys = (survey_batches(_middles(each, voxel, observer)) for each in sources.values())
    layout = quadtree(merge(surveys).occupancy, TILE_POINTS)
    observer.stage("sorting", total)
    return {
        name: _cut(source, layout, voxel, folder / name, observer)
        for name, source in sources.items()
    }


def voxel_cells(xyz: NDArray[np.float64], voxel: float) -> NDArray[np.float64]:
    """Return the voxel of each point, (n, 3), whole numbers in float64: no place is too far."""
    return np.floor(xyz / voxel)


def _middles(source: CloudSource, voxel: float, observer: Observer) -> Iterator[PointBatch]:
    for count, columns in source.batches():
        yield PointBatch(0, _middles_of(columns["xyz"], voxel), None)
        observer.advance(count)


def _middles_of(xyz: NDArray[np.float64], voxel: float) -> NDArray[np.float64]:
    return (voxel_cells(xyz, voxel) + 0.5) * voxel


def _cut(
    source: CloudSource, layout: Layout, voxel: float, folder: Path, observer: Observer
) -> TiledCloud:
    """Sort the points of a map into tiles."""
    cloud = TiledCloud(source.collection.name, folder, len(layout))
    for count, columns in source.batches():
        tiles = layout.tile_of(_middles_of(columns["xyz"], voxel))
        order = np.argsort(tiles, kind="stable")
        present, starts = np.unique(tiles[order], return_index=True)
        for tile, bounds in zip(present.tolist(), pairwise([*starts, len(order)]), strict=True):
            some = order[slice(*bounds)]
            cloud.append(tile, **{name: column[some] for name, column in columns.items()})
        observer.advance(count)
    check_points(cloud)
    return cloud


def check_points(cloud: TiledCloud, among: str = "") -> None:
    """Refuse a cloud without a point."""
    if not len(cloud):
        raise EvaluationError(f"{cloud.name}: expected finite points{among}, found none")


def distance_apart(first: TiledCloud, second: TiledCloud) -> float:
    """Return the distance between the boxes of two clouds, metres; 0 where they meet."""
    (low, high), (other_low, other_high) = first.box(), second.box()
    gaps = np.maximum(np.maximum(low - other_high, other_low - high), 0.0)
    return float(np.linalg.norm(gaps))


class Nearest(NamedTuple):
    """What is nearest to some places."""

    distances: _Floats
    """(m,): infinite where nothing is near enough."""
    labels: Labels
    """(m,): `Truth` of the nearest point: of equally near ones the first in the order of `Truth`,
    so that no order of rows matters; unknown where nothing is near enough."""


def find_nearest(places: _Floats, cloud: TiledCloud, at_most: float = np.inf) -> Nearest:
    """Find the nearest point of a cloud to each of some places, (m, 3), which lie close together.

    Where nothing is as near as `at_most`, nothing is found. A place asks the tiles in the order of
    their distance, until none is left that may hold a point as near as the nearest so far:
    distances of boxes are computed as those of points are, and rounding is monotonic. Of a tile
    only those points are looked at that some place may reach.
    """
    # A hair more: squares are rounded, and what is found is compared with the bound itself.
    bound = (at_most * (1 + 1e-12)) ** 2
    search = NearestSearch(places, bound, available_cores("auto"))
    low, high = places.min(axis=0), places.max(axis=0)
    tiles = np.flatnonzero(cloud.counts)
    tile_low, tile_high = cloud.low[tiles], cloud.high[tiles]
    gaps = _squared_gaps(tile_low, tile_high, low, high)
    # Of tiles that the box of the places meets, the one whose middle is nearest to its own first.
    apart = np.square((tile_low + tile_high) / 2 - (low + high) / 2).sum(axis=1)
    for at in np.lexsort((apart, gaps)).tolist():
        if gaps[at] > search.squared.max():
            break
        tile = int(tiles[at])
        own = _squared_gaps(places, places, cloud.low[tile], cloud.high[tile])
        asking = np.flatnonzero(own <= search.squared)
        if len(asking):
            points, labels = cloud.xyz(tile), cloud.labels(tile)
            near = places[asking]
            reach = search.squared[asking].max()
            of_points = _squared_gaps(points, points, near.min(axis=0), near.max(axis=0))
            reached = of_points <= reach
            search.offer(points[reached], labels[reached].astype(np.int64), asking)
    distances = np.sqrt(search.squared)
    found = (search.rank != NO_RANK) & (distances <= at_most)
    return Nearest(
        np.where(found, distances, np.inf),
        np.where(found, search.rank, Truth.UNKNOWN).astype(np.int8),
    )


def _squared_gaps(low: _Floats, high: _Floats, box_low: _Floats, box_high: _Floats) -> _Floats:
    """Return the squared distance of each of some boxes, or points, from a box, (n,)."""
    dx, dy, dz = np.maximum(np.maximum(low - box_high, box_low - high), 0.0).T
    return np.asarray((dx * dx + dy * dy) + dz * dz)


def look_up(
    cloud: TiledCloud, other: TiledCloud, observer: Observer, stage: str, at_most: float = np.inf
) -> Iterator[tuple[int, Nearest]]:
    """Look up every point of a cloud in another; yield what is nearest to each tile's points."""
    for tile in cloud.watched_tiles(stage, observer):
        yield tile, find_nearest(cloud.xyz(tile), other, at_most)
