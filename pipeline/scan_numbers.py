"""When each point of a map was seen: a scan number a point, where the map's files tell it.

Two points of one number were seen within about a tenth of a second, and higher numbers were seen
later. A wrong guess would cost walls, and none costs little: what is not sure is not used.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dynahull.observer import Observer, SilentObserver
from pipeline.configuration.run import Configuration
from pipeline.errors import ConfigurationError
from pipeline.scan_fields import LEAST_SCANS, Overlap, Tally, candidates, tallies_of
from pipeline.scan_source import ScanSource, numbers_of_poses
from tiling.collection import MapCollection
from tiling.key_frames import ScanPoses

AUTO, OFF = "auto", "off"


def find_scans(
    collection: MapCollection, configuration: Configuration, observer: Observer | None = None
) -> ScanSource | None:
    """Find out by a pass over a map what tells when its points were seen; None if nothing surely.

    Parameters
    ----------
    observer : Observer, optional
        Told of the pass, and of a field that was asked for and tells nothing.

    Raises
    ------
    ConfigurationError
        When the field that was asked for is not there.
    MapFormatError
        When a file is not what its header announced.
    """
    observer = observer or SilentObserver()
    wanted = configuration.evidence.time
    check_time(collection, configuration)
    if wanted == OFF or not collection.point_count:
        return None
    poses = collection.poses
    of_map = poses is not None and not poses.are_of_files
    if wanted == AUTO and poses is not None and not of_map:
        apart = _of_files(collection, poses, observer)
        if apart is not None:
            return apart
    names = candidates(collection) if wanted == AUTO else [wanted]
    if names:
        observer.stage("times", collection.point_count)
    given = wanted != AUTO or of_map
    found = [
        (tally, source)
        for tally in tallies_of(collection, names, given, observer)
        if (source := tally.source()) is not None
    ]
    if poses is not None and of_map:
        return _with_poses(found, poses, collection)
    if found:
        return found[0][1]
    if not given:
        return _of_rows(collection)
    observer.warn(
        f"evidence.time: {wanted} has not the {LEAST_SCANS} different scans, or tenths of a "
        "second, that tell when points were seen: not used"
    )
    return None


def _of_files(collection: MapCollection, poses: ScanPoses, observer: Observer) -> ScanSource | None:
    """Return the files as the source, or the scans in them if these saw the same places."""
    if poses.counts is None:
        return ScanSource(kind="files", scans=len(poses.poses), name="key frames")
    source = ScanSource(kind="files", scans=len(poses.poses), name="scans of the file")
    observer.stage("times", collection.point_count)
    overlap = Overlap()
    for file, batch in collection.batches():
        overlap.add(batch.xyz, source.numbers(collection, file, batch).astype(np.int64))
        observer.advance(len(batch.xyz))
    return source if overlap.is_shared() else None


def _with_poses(
    found: Sequence[tuple[Tally, ScanSource]], poses: ScanPoses, collection: MapCollection
) -> ScanSource:
    """Return the first source that the poses go with, its scans numbered by them."""
    refused: list[ConfigurationError] = []
    for tally, source in found:
        try:
            first, of_poses = numbers_of_poses(poses, tally.seen, source.name, source.tenth > 0)
        except ConfigurationError as error:
            refused.append(error)
            continue
        firsts = (first,) * len(collection.readers)
        return source.model_copy(update={"firsts": firsts, "of_poses": of_poses})
    if refused:
        raise refused[0]
    raise ConfigurationError(
        "input.poses: expected scans, or a map whose points have a scan number or a time, found "
        f"neither in {collection.name}"
    )


def _of_rows(collection: MapCollection) -> ScanSource | None:
    """Return the order of the rows as a source of scan numbers, if it is one."""
    rows = rows_of_a_scan(collection)
    if not rows:
        return None
    counts = [reader.description.point_count for reader in collection.readers]
    firsts = np.cumsum([0, *(-(-count // rows) for count in counts)]).tolist()
    return ScanSource(kind="rows", scans=firsts[-1], firsts=tuple(firsts[:-1]), rows=rows)


def check_time(collection: MapCollection, configuration: Configuration) -> None:
    """Refuse a field of `evidence.time` that the map does not have.

    Raises
    ------
    ConfigurationError
        In one line that lists those it has.
    """
    wanted = configuration.evidence.time
    if wanted in (AUTO, OFF):
        return
    for reader in collection.readers:
        single = [each.name for each in reader.description.fields if each.count == 1]
        if wanted not in single:
            raise ConfigurationError(
                f"evidence.time: expected auto, off, or a field of {reader.description.path} "
                f"({', '.join(single) or 'it has none'}), found {wanted!r}"
            )


_LENGTHS = tuple(1 << power for power in range(10, 18))
"""Rows of a piece that are tried: a scan of any sensor is about as long as one of them."""

_SHORT = 256
"""Rows of a piece that is much shorter than a scan."""

_PIECES = 40
"""That are looked at together."""

_WINDOWS = 3
"""Stretches of the rows that are looked at; the test must hold in each."""

_SAMPLED = 2000
"""Points of a piece, at most."""

_BATCH = 1 << 17

_FULL = 50_000
"""Rows of a stretch of which every one is looked at."""

_PROBES, _FOLLOWING = 200, 256
"""Points whose nearest among so many following rows is compared with the nearest among as many
drawn at random. 256 rows hold the next firing of the same beam of all sensors known."""

_CELL = 0.5
"""Metres: the size of a place."""

_FARTHEST = 1e9
_MIXED = np.array([1, 1_000_003, 998_244_353])
"""A number for each cell of a place, nearly always another."""

_MOST_APART = 0.5
"""Distance to the following rows over that to random ones, at most; 1 where rows are shuffled."""

_MOST_SHIFT = 0.5
"""Distance, along an axis, of the means of a piece and of the next but one, over their spread."""

_LEAST_RETURNS = 0.7
"""Pieces that return to a place, over those of the same rows shuffled."""

_MOST_OF_SHORT = 0.6
"""Returns of short pieces over those of the best, at most."""

_NEARLY = 0.85
"""Share of the most returns at which a piece is as long as a scan."""


def rows_of_a_scan(collection: MapCollection) -> int:
    """Return about how many rows a scan has; 0 where the rows are not scans for sure.

    Many SLAM programs write scans one after the other. Then consecutive rows lie near each other,
    as the beam sweeps; every piece of the rows of the length of a scan lies where the pieces before
    and after it lie; and each place is returned to by nearly as many pieces as if the rows were
    shuffled, but by few that are much shorter than a scan. Rows that are shuffled fail the first of
    these. Rows that are sorted, by a coordinate, by voxels (as PCL's filter leaves them), along a
    curve, by tiles or by direction, fail the others.
    """
    lengths = [each for each in _LENGTHS if each * _PIECES <= collection.point_count]
    if not lengths:
        return 0
    longest = lengths[-1] * _PIECES
    every = [_SHORT, *lengths]
    starts = np.linspace(0, collection.point_count - longest, _WINDOWS).astype(np.int64)
    found = []
    for start in np.unique(starts).tolist():
        stretch = _Stretch(collection, start, every)
        if not stretch.is_coherent():
            return 0
        found.append([stretch.returns(length) for length in every])
    shifts, of_stretches = np.moveaxis(np.array(found), 2, 0)
    short = of_stretches[:, 0].max()
    returns = np.where(shifts <= _MOST_SHIFT, of_stretches, 0.0)[:, 1:].min(axis=0)
    if returns.max() < max(_LEAST_RETURNS, short / _MOST_OF_SHORT):
        return 0
    return lengths[int(np.argmax(returns >= max(_LEAST_RETURNS, _NEARLY * returns.max())))]


class _Stretch:
    """Points of the consecutive rows that pieces of some lengths take, from a place on.

    Of the first rows all are kept; for each length every so many of the rows of all pieces, with
    the number of the piece.
    """

    def __init__(self, collection: MapCollection, start: int, lengths: list[int]) -> None:
        self._full: list[NDArray[np.float64]] = []
        self._samples: dict[int, list[tuple[NDArray[np.int64], NDArray[np.float64]]]]
        self._samples = {length: [] for length in lengths}
        rows = range(start, start + lengths[-1] * _PIECES)
        for _, batch in collection.batches(_BATCH, rows):
            offsets = batch.first_row - start + np.arange(len(batch.xyz))
            finite = (np.abs(batch.xyz) < _FARTHEST).all(axis=1)
            self._full.append(batch.xyz[finite & (offsets < _FULL)])
            for length, samples in self._samples.items():
                step = max(length // _SAMPLED, 1)
                chosen = finite & (offsets % step == 0) & (offsets < length * _PIECES)
                samples.append((offsets[chosen] // length, batch.xyz[chosen]))

    def is_coherent(self) -> bool:
        """Tell whether following rows lie nearer than random ones."""
        points = np.concatenate(self._full)
        if len(points) <= 2 * _FOLLOWING:
            return False
        random = np.random.default_rng(0)
        probes = random.integers(0, len(points) - _FOLLOWING, _PROBES)
        following = probes[:, None] + 1 + np.arange(_FOLLOWING)
        others = random.integers(0, len(points), following.shape)
        near, far = (
            np.median(np.linalg.norm(points[rows] - points[probes, None], axis=2).min(axis=1))
            for rows in (following, others)
        )
        return bool(near <= _MOST_APART * far)

    def returns(self, length: int) -> tuple[float, float]:
        """Return how far pieces wander, and how often they return to a place, 1 as if shuffled."""
        piece = np.concatenate([pieces for pieces, _ in self._samples[length]])
        xyz = np.concatenate([points for _, points in self._samples[length]])
        counts = np.bincount(piece, minlength=_PIECES)
        if counts.min() < 2:
            return np.inf, 0.0
        ends = np.cumsum(counts)[:-1]
        parts = np.split(xyz, ends)
        means = np.array([part.mean(axis=0) for part in parts])
        spreads = np.array([part.std(axis=0) for part in parts])
        apart = np.abs(means[2:] - means[:-2]) / (spreads[2:] + spreads[:-2] + 1e-9) * 2
        cells = np.floor((xyz - xyz.min(axis=0)) / _CELL).astype(np.int64)
        _, place = np.unique(cells @ _MIXED, return_inverse=True)
        shuffled = np.random.default_rng(0).permutation(piece)
        found, expected = (_pieces_of_places(place, each) for each in (piece, shuffled))
        shift = float(np.median(apart, axis=0).max())
        return shift, (found - 1) / max(expected - 1, 1.0)


def _pieces_of_places(place: NDArray[np.int64], piece: NDArray[np.int64]) -> float:
    """Return in how many pieces the place of a point is seen, in the mean over points."""
    pairs = np.unique(place * _PIECES + piece)
    counts = np.bincount(pairs // _PIECES, minlength=int(place.max()) + 1)
    return float(counts[place].mean())
