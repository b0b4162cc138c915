"""Fields whose names speak of scans or times, and what a pass over the map says of each.

Numbers of tiles, or of anything else, are told from those of scans by whether scans saw the same
places.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.observer import Observer
from pipeline.scan_source import TENTH, UNKNOWN, ScanSource, whole_numbers
from tiling.collection import MapCollection
from tiling.errors import MapFormatError

_CELL = 0.5
"""Metres: the size of a place."""

_LEAST_SHARED = 0.12
"""Share of the places that several scans must have seen. Two stations of a scanner share some 15 %,
eight scans half, a drive three quarters; tiles of 10 m 10 % at most, where they touch."""

_MOST_PAIRS = 1 << 18
_FARTHEST = 1e9
_MIXED = np.array([0x9E3779B97F4A7C15, 0xBF58476D1CE4E5B9, 0x94D049BB133111EB], np.uint64)

_Numbers = NDArray[np.uint64]


class Overlap:
    """Gathers which places scans saw: of all places, or of some that are drawn at random.

    What is gathered does not depend on how the points come.
    """

    def __init__(self) -> None:
        self._one_of = 1
        self._pairs, self._places = np.empty(0, np.uint64), np.empty(0, np.uint64)

    def add(self, xyz: NDArray[np.float64], scan: NDArray[np.int64]) -> None:
        """Take points into account, (n, 3) metres, and the number of the scan of each."""
        seen = (np.abs(xyz) < _FARTHEST).all(axis=1)
        cells = np.floor(xyz[seen] / _CELL).astype(np.int64).view(np.uint64)
        places = _mixed((cells * _MIXED).sum(axis=1, dtype=np.uint64))
        pairs = _mixed(places ^ _mixed(scan[seen].view(np.uint64)))
        new = np.diff(pairs, prepend=~pairs[:1]) != 0  # most are those of the point before
        self._take(pairs[new], places[new])
        while len(self._pairs) > _MOST_PAIRS:
            self._one_of *= 2
            self._take(np.empty(0, np.uint64), np.empty(0, np.uint64))

    def is_shared(self) -> bool:
        """Tell whether enough places were seen by several scans."""
        _, scans = np.unique(self._places, return_counts=True)
        several = np.count_nonzero(scans > 1)
        return bool(several and several >= _LEAST_SHARED * len(scans))

    def _take(self, pairs: _Numbers, places: _Numbers) -> None:
        """Add pairs of a scan and a place to the drawn ones, each once."""
        pairs = np.concatenate([self._pairs, pairs])
        places = np.concatenate([self._places, places])
        drawn = places % np.uint64(self._one_of) == 0
        self._pairs, firsts = np.unique(pairs[drawn], return_index=True)
        self._places = places[drawn][firsts]


def _mixed(numbers: _Numbers) -> _Numbers:
    """Mix the bits of numbers (as SplitMix64 ends)."""
    numbers = numbers + _MIXED[0]
    numbers = (numbers ^ numbers >> np.uint64(30)) * _MIXED[1]
    numbers = (numbers ^ numbers >> np.uint64(27)) * _MIXED[2]
    return numbers ^ numbers >> np.uint64(31)


_SCAN_NAMES = frozenset(
    {"scan", "scanid", "scanindex", "scannumber", "scanno", "sweep", "sweepid"}
    | {"frame", "frameid", "frameindex", "framenumber", "frameno", "keyframe", "keyframeid"}
    | {"scanidx", "frameidx", "keyframeidx", "keyframeindex", "originalcloudindex", "cloudindex"}
)
_TIME_NAMES = frozenset(
    {"gpstime", "time", "timestamp", "timestamps", "stamp", "t"}
    | {"pointtime", "timens", "timeus", "timesec"}
)
_SOURCE_NAMES = frozenset({"pointsourceid", "sourceid"})
"""In lower case, without underscores, and without the `scalar_` of CloudCompare; in this order. LAS
means a flight line by the last, and scans are numbered there only where no times tell more."""

LEAST_SCANS = 8
_MOST_SCANS = 1 << 22
_LARGEST_SCAN = 1_000_000
"""Points: what is larger is a flight line, or a station of a scanner on a tripod."""

_UNITS = ((1e17, 1e8), (1e14, 1e5), (1e11, 1e2))
"""Times since 1970 of at least the first are in units of which the second make a tenth of a second:
nanoseconds, microseconds, milliseconds. Smaller ones are seconds."""

_SECONDS_FOR_SURE = ("gpstime",)
_OFFSETS = ((0.5, 4.0), (40.0, 210.0), (4e4, 2.1e5), (4e7, 2.1e8))
"""Largest offset within a scan of some Hz, in seconds; and within one of 5 to 20 Hz, in
milliseconds, microseconds and nanoseconds."""

_FALL = 0.4
"""Of the largest value: what falls by more, from a point to the next, may begin anew."""

_ASCENTS = 4
"""To a descent, where values go up like saw teeth: in each scan, or ring, from zero on."""

_COARSE = 2.0**20
"""Seconds from which on float32 does not tell tenths apart."""

_WHOLE = 2.0**24
"""Numbers up to which float32 tells one from the next."""

_FIRST_MINUTE = 600
_LARGEST_NUMBER = np.iinfo(np.int32).max


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
    return re.sub(r"[\W_]", "", name.lower().removeprefix("scalar_"))


def _is_whole(values: NDArray[Any]) -> bool:
    """Tell whether values are whole numbers, of whatever type."""
    known = values[np.isfinite(values)]
    return values.dtype.kind in "iu" or bool(
        (known == np.floor(known)).all() and (np.abs(known) < _WHOLE).all()
    )


@dataclass
class Tally:
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
    ascents: int = 0
    descents: int = 0
    overlap: Overlap = field(default_factory=Overlap)
    is_out: bool = False

    def add(self, file: int, xyz: NDArray[np.float64], values: NDArray[Any]) -> None:
        """Take some points of a file into account."""
        self.is_out = values.dtype.kind not in "iufM"
        if self.is_out or (self.tenth is None and not self._understands(values)):
            return
        if values.dtype.kind != "M":
            self._note_order(values)
        whole = whole_numbers(values, self.tenth or 0.0)
        known = whole != UNKNOWN
        different = np.unique(whole[np.flatnonzero(np.diff(whole, prepend=UNKNOWN))])
        different = different[different != UNKNOWN]
        if not len(different):
            return
        self.points += int(np.count_nonzero(known))
        self.seen = np.union1d(self.seen, different)
        low, high = self.bounds.get(file, (different[0], different[-1]))
        self.bounds[file] = int(min(low, different[0])), int(max(high, different[-1]))
        self.is_out |= len(self.seen) > _MOST_SCANS
        if not self.tenth and not self.given:
            self.overlap.add(xyz[known], whole[known])
            self.is_out |= not _is_whole(values)

    def _understands(self, values: NDArray[Any]) -> bool:
        self.tenth = _tenth_of(self.name, values, self.given)
        return self.tenth is not None

    def _note_order(self, values: NDArray[Any]) -> None:
        """Count how often values go up and down from a point to the next, and fall by much."""
        known = values[np.isfinite(values)].astype(np.float64)
        if not len(known):
            return
        self.largest = max(self.largest, float(known.max()))
        coarse = values.dtype.kind == "f" and values.dtype.itemsize <= 4 and self.tenth != 0
        self.is_out = coarse and self.largest >= _COARSE
        steps = np.diff(known)
        falls = steps < -_FALL * self.largest
        self.falls += int(np.count_nonzero(falls))
        self.descents += int(np.count_nonzero((steps < 0) & ~falls))
        self.ascents += int(np.count_nonzero(steps > 0))

    @property
    def _like_offsets(self) -> bool:
        """Whether values may tell when a point was seen within its scan: they begin ever anew."""
        teeth = self.falls >= LEAST_SCANS and self.ascents >= _ASCENTS * self.descents
        fits = any(low <= self.largest <= high for low, high in _OFFSETS)
        unsure = self.tenth == TENTH and _plain(self.name) not in _SECONDS_FOR_SURE
        return teeth or (unsure and fits and self.falls > 2)

    def source(self) -> ScanSource | None:
        """Return the field as a source of scan numbers; None where it is none for sure."""
        if self.is_out or self.tenth is None or len(self.seen) < LEAST_SCANS:
            return None
        a_scan = self.points / len(self.seen)
        if not self.given and (self._like_offsets or not 2 <= a_scan <= _LARGEST_SCAN):
            return None
        if not self.given and not self.tenth and not self.overlap.is_shared():
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
    """Return how many units of a field make a tenth of a second, 0 for scan numbers.

    None where no point tells yet, or it may be anything.
    """
    if values.dtype.kind == "M":
        return 1e8
    is_whole, is_scan = values.dtype.kind in "iu", _plain(name) in _SCAN_NAMES | _SOURCE_NAMES
    sizes = np.abs(values[np.isfinite(values) & (values != 0)].astype(np.float64))
    if is_scan and (not given or not is_whole):
        whole = _is_whole(values)
        if whole or not given:
            return 0.0 if whole else None
    if not len(sizes):
        return None
    for least, tenth in _UNITS:
        if sizes.max() >= least:
            return tenth
    if is_whole:
        return 0.0 if given else None
    return TENTH


def tallies_of(
    collection: MapCollection, names: Sequence[str], given: bool, observer: Observer
) -> list[Tally]:
    """Read a map once, and return what it says of some fields."""
    tallies = [Tally(name, len(collection.readers), given) for name in names]
    for file, batch in collection.batches() if tallies else ():
        for tally in tallies:
            if not tally.is_out:
                try:
                    values = collection.readers[file].values(batch.records, tally.name)
                    tally.add(file, batch.xyz, values)
                except MapFormatError:  # no fields that can be read apart
                    tally.is_out = True
        observer.advance(len(batch.xyz))
    return tallies
