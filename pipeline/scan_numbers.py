"""When each point of a map was seen: a scan number a point, where the map's files tell it.

Two points of one number were seen within about a tenth of a second, and higher numbers were seen
later. A wrong guess would cost walls, and none costs little: what is not sure is not used.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from dynahull.progress import Observer
from pipeline.configuration.run import Configuration
from pipeline.errors import ConfigurationError
from pipeline.pose_numbers import nearest_poses, numbers_of_poses
from pipeline.row_order import rows_of_a_scan
from tiling.collection import MapCollection
from tiling.errors import MapFormatError
from tiling.foreign_text import printable
from tiling.formats.points import PointBatch
from tiling.key_frames import ScanPoses

AUTO, OFF = "auto", "off"

_SCAN_NAMES = frozenset(
    {"scan", "scanid", "scanindex", "scannumber", "scanno", "sweep", "sweepid"}
    | {"frame", "frameid", "frameindex", "framenumber", "frameno", "keyframe", "keyframeid"}
)
_TIME_NAMES = frozenset(
    {"gpstime", "time", "timestamp", "timestamps", "stamp", "t", "offsettime", "timeoffset"}
    | {"pointtime", "timens", "timeus", "timesec"}
)
_SOURCE_NAMES = frozenset({"pointsourceid"})
"""In lower case and without underscores; in this order. LAS means a flight line by the last, and
scans are numbered there only where no times tell more."""

_LEAST_SCANS = 8
_MOST_SCANS = 1 << 22
_LARGEST_SCAN = 1_000_000
"""Points: what is larger is a flight line, or a station of a scanner on a tripod."""

_UNITS = ((1e17, 1e8), (1e14, 1e5), (1e11, 1e2))
"""Times since 1970 of at least the first are in units of which the second make a tenth of a second:
nanoseconds, microseconds, milliseconds. Smaller ones are seconds."""

_SECONDS = 0.1
_SECONDS_FOR_SURE = ("gpstime",)
_OFFSETS = ((40.0, 210.0), (4e4, 2.1e5), (4e7, 2.1e8))
"""Largest offset within a scan of 5 to 20 Hz, in milliseconds, microseconds and nanoseconds."""

_COARSE = 2.0**20
"""Seconds from which on float32 does not tell tenths apart."""

_FIRST_MINUTE = 600
_UNKNOWN = np.iinfo(np.int64).min
_LARGEST_NUMBER = np.iinfo(np.int32).max


class ScanSource(BaseModel):
    """Where the scan numbers of a map come from.

    Attributes
    ----------
    kind : str
        `field`; `rows`, the order of the rows; or `files`, each of which is a scan.
    scans : int
        Different numbers; an estimate where the order of the rows is all there is.
    name : str
        Of the field.
    tenth : float
        Units of the field that make a tenth of a second; 0 for scan numbers.
    firsts : tuple of int
        For each file, what number 0 stands for: tenths of a second, or a scan number.
    rows : int
        Rows that are taken for a scan.
    of_poses : tuple of int
        What number each pose of the map has, ascending: scans are numbered by their poses then.
    """

    model_config = ConfigDict(frozen=True)

    kind: Literal["field", "rows", "files"]
    scans: int
    name: str = ""
    tenth: float = 0.0
    firsts: tuple[int, ...] = ()
    rows: int = 0
    of_poses: tuple[int, ...] = ()

    def __str__(self) -> str:
        if self.kind == "field":
            posed = " with poses" if self.of_poses else ""
            return f"{printable(self.name)}, {self.scans:,} scans{posed}"
        if self.kind == "files":
            return f"key frames, {self.scans:,} scans with poses"
        return f"order of the rows, about {self.scans:,} scans"

    def numbers(self, collection: MapCollection, file: int, batch: PointBatch) -> NDArray[np.int32]:
        """Return the scan number of each point of a batch of the map, -1 where it is not known.

        Parameters
        ----------
        collection : MapCollection
            The map.
        file : int
            That the batch comes from.
        batch : PointBatch
            As `MapCollection.batches` gives it.
        """
        count = len(batch.xyz)
        if self.kind == "files":
            return np.full(count, file, np.int32)
        if self.kind == "rows":
            row = batch.first_row - collection.first_rows[file] + np.arange(count)
            return (self.firsts[file] + row // self.rows).astype(np.int32)
        found = _whole(collection.readers[file].values(batch.records, self.name), self.tenth)
        known = found != _UNKNOWN
        number = np.where(known, found - self.firsts[file], -1)
        if self.of_poses:
            number = nearest_poses(number, self.of_poses, exact=not self.tenth)
        return number.astype(np.int32)

    def sensor(self, collection: MapCollection) -> NDArray[np.float64] | None:
        """Return where the sensor was in each scan, (S, 3), metres; None where nobody tells."""
        poses = collection.poses
        if poses is None or not (self.kind == "files" or self.of_poses):
            return None
        places = np.ascontiguousarray(poses.poses[:, :, 3])
        if poses.are_of_files or collection.metres is None:
            return places
        return np.asarray(places * collection.metres)


def find_scans(
    collection: MapCollection, configuration: Configuration, observer: Observer | None = None
) -> ScanSource | None:
    """Find out what tells when the points of a map were seen, by one pass over it.

    Parameters
    ----------
    collection : MapCollection
    configuration : Configuration
        `evidence.time` is used.
    observer : Observer, optional
        Told of the pass, and of a field that was asked for and tells nothing.

    Returns
    -------
    ScanSource or None
        None where nothing tells it for sure.

    Raises
    ------
    ConfigurationError
        When the field that was asked for is not there.
    MapFormatError
        When a file is not what its header announced.
    """
    wanted = configuration.evidence.time
    check_time(collection, configuration)
    if wanted == OFF or not collection.point_count:
        return None
    poses = collection.poses
    of_map = poses is not None and not poses.are_of_files
    if wanted == AUTO and poses is not None and not of_map:
        return ScanSource(kind="files", scans=len(collection.readers))
    names = candidates(collection) if wanted == AUTO else [wanted]
    if names and observer is not None:
        observer.stage("times", collection.point_count)
    given = wanted != AUTO or of_map
    found = [
        (tally, source)
        for tally in _tallies(collection, names, given, observer)
        if (source := tally.source()) is not None
    ]
    if poses is not None and of_map:
        return _with_poses(found, poses, collection)
    if found:
        return found[0][1]
    if not given:
        return _of_rows(collection)
    if observer is not None:
        observer.warn(
            f"evidence.time: {wanted} has not the {_LEAST_SCANS} different scans, or tenths of "
            "a second, that tell when points were seen: not used"
        )
    return None


def _with_poses(
    found: "Sequence[tuple[_Tally, ScanSource]]", poses: ScanPoses, collection: MapCollection
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


def candidates(collection: MapCollection) -> list[str]:
    """Return the fields that all files have and whose names speak of scans or times, in order."""
    of_files = [
        {each.name for each in reader.description.fields if each.count == 1}
        for reader in collection.readers
    ]
    shared = set.intersection(*of_files)
    return [
        name
        for names in (_SCAN_NAMES, _TIME_NAMES, _SOURCE_NAMES)
        for name in sorted(shared)
        if _plain(name) in names
    ]


def _plain(name: str) -> str:
    return re.sub(r"[\W_]", "", name.lower())


def _whole(values: NDArray[Any], tenth: float) -> NDArray[np.int64]:
    """Return scan numbers, or tenths of a second, and `_UNKNOWN` where there is none."""
    if values.dtype.kind == "M":
        values = values.astype("datetime64[ns]").astype(np.int64)
    if values.dtype.kind in "iu":
        known = values >= 0 if not tenth else values > 0
        if values.dtype == np.uint64:
            known &= values <= np.uint64(np.iinfo(np.int64).max)
        whole = values.astype(np.int64)
        if tenth:
            whole = whole // int(tenth)
    else:
        known = np.isfinite(values) & (np.abs(values) < 2.0**62) & (values != 0)
        seconds = np.where(known, values, 0).astype(np.float64)
        whole = np.floor(seconds * 10 if tenth == _SECONDS else seconds / (tenth or 1))
        whole = whole.astype(np.int64)
    return np.where(known, whole, _UNKNOWN)


@dataclass
class _Tally:
    """What a pass over the map says of one field: different numbers, and bounds of each file."""

    name: str
    files: int
    given: bool
    tenth: float | None = None
    seen: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, np.int64))
    bounds: dict[int, tuple[int, int]] = field(default_factory=dict)
    points: int = 0
    largest: float = 0.0
    falls: int = 0
    is_out: bool = False

    def add(self, file: int, values: NDArray[Any]) -> None:
        """Take some points of a file into account."""
        self.is_out = values.dtype.kind not in "iufM"
        if self.is_out or (self.tenth is None and not self._understands(values)):
            return
        if values.dtype.kind == "f":
            self._note_offsets(values)
        whole = _whole(values, self.tenth or 0.0)
        different = np.unique(whole[np.flatnonzero(np.diff(whole, prepend=_UNKNOWN))])
        different = different[different != _UNKNOWN]
        if not len(different):
            return
        self.points += int(np.count_nonzero(whole != _UNKNOWN))
        self.seen = np.union1d(self.seen, different)
        low, high = self.bounds.get(file, (different[0], different[-1]))
        self.bounds[file] = int(min(low, different[0])), int(max(high, different[-1]))
        self.is_out |= len(self.seen) > _MOST_SCANS

    def _understands(self, values: NDArray[Any]) -> bool:
        self.tenth = _tenth_of(self.name, values, self.given)
        return self.tenth is not None

    def _note_offsets(self, values: NDArray[Any]) -> None:
        """Count how often a time falls back by much from one point to the next."""
        known = values[np.isfinite(values)].astype(np.float64)
        if len(known):
            self.largest = max(self.largest, float(known.max()))
            self.is_out = values.dtype.itemsize <= 4 and self.largest >= _COARSE
            if self.largest >= _OFFSETS[0][0]:
                self.falls += int(np.count_nonzero(np.diff(known) < -0.4 * self.largest))

    def source(self) -> ScanSource | None:
        """Return the field as a source of scan numbers; None where it is none for sure."""
        if self.is_out or self.tenth is None or len(self.seen) < _LEAST_SCANS:
            return None
        like_offsets = (
            self.tenth == _SECONDS
            and _plain(self.name) not in _SECONDS_FOR_SURE
            and self.falls > 2
            and any(low <= self.largest <= high for low, high in _OFFSETS)
        )
        a_scan = self.points / len(self.seen)
        if not self.given and (like_offsets or not 2 <= a_scan <= _LARGEST_SCAN):
            return None
        lowest = min(low for low, _ in self.bounds.values())
        firsts, span, scans = [lowest] * self.files, int(self.seen[-1]) - lowest, len(self.seen)
        if self._begins_anew(lowest):
            span = 0
            for file, (low, high) in sorted(self.bounds.items()):
                firsts[file] = low - span
                span += high + 1 - low
            scans = span
        if span > _LARGEST_NUMBER:
            return None
        return ScanSource(
            kind="field", scans=scans, name=self.name, tenth=self.tenth, firsts=tuple(firsts)
        )

    def _begins_anew(self, lowest: int) -> bool:
        """Tell whether each file begins with the same number, or in the first minute."""
        same = len(self.bounds) > 1 and all(low <= lowest + 1 for low, _ in self.bounds.values())
        return same and (not self.tenth or lowest < _FIRST_MINUTE)


def _tenth_of(name: str, values: NDArray[Any], given: bool) -> float | None:
    """Return how many units of a field make a tenth of a second.

    Returns
    -------
    float or None
        0 for scan numbers; None where no point tells yet, or it may be anything.
    """
    if values.dtype.kind == "M":
        return 1e8
    is_whole, is_scan = values.dtype.kind in "iu", _plain(name) in _SCAN_NAMES | _SOURCE_NAMES
    sizes = np.abs(values[np.isfinite(values) & (values != 0)].astype(np.float64))
    if is_scan and not given:
        return 0.0 if is_whole else None
    if not len(sizes):
        return None
    for least, tenth in _UNITS:
        if sizes.max() >= least:
            return tenth
    if is_whole:
        return 0.0 if given else None
    return _SECONDS


def _tallies(
    collection: MapCollection, names: Sequence[str], given: bool, observer: Observer | None
) -> list[_Tally]:
    """Read a map once, and return what it says of some fields."""
    tallies = [_Tally(name, len(collection.readers), given) for name in names]
    for file, batch in collection.batches() if tallies else ():
        for tally in tallies:
            if not tally.is_out:
                try:
                    tally.add(file, collection.readers[file].values(batch.records, tally.name))
                except MapFormatError:  # no fields that can be read apart
                    tally.is_out = True
        if observer is not None:
            observer.advance(len(batch.xyz))
    return tallies
