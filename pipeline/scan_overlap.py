"""Whether scans saw the same places: numbers of tiles, or of anything else, are none of scans."""

import numpy as np
from numpy.typing import NDArray

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
