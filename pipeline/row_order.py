"""Whether the rows of a map are scans, one after the other, as many SLAM programs write them.

In such a map consecutive rows lie near each other, as the beam sweeps; every piece of the rows of
the length of a scan lies where the pieces before and after it lie; and each place is returned to by
nearly as many pieces as if the rows were shuffled, but by few that are much shorter than a scan.
Rows that are shuffled fail the first of these. Rows that are sorted, by a coordinate, by voxels (as
PCL's filter leaves them), along a curve, by tiles or by direction, fail the others.
"""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from tiling.collection import MapCollection

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
    """Return about how many rows a scan has; 0 where the rows are not scans for sure."""
    lengths = [each for each in _LENGTHS if each * _PIECES <= collection.point_count]
    if not lengths:
        return 0
    longest = lengths[-1] * _PIECES
    every = [_SHORT, *lengths]
    starts = np.linspace(0, collection.point_count - longest, _WINDOWS).astype(np.int64)
    found = []
    for start in np.unique(starts).tolist():
        stretch = _Stretch.read(collection, start, every)
        if not stretch.is_coherent():
            return 0
        found.append([stretch.returns(length) for length in every])
    shifts, of_stretches = np.moveaxis(np.array(found), 2, 0)
    short = of_stretches[:, 0].max()
    returns = np.where(shifts <= _MOST_SHIFT, of_stretches, 0.0)[:, 1:].min(axis=0)
    if returns.max() < max(_LEAST_RETURNS, short / _MOST_OF_SHORT):
        return 0
    return lengths[int(np.argmax(returns >= max(_LEAST_RETURNS, _NEARLY * returns.max())))]


@dataclass
class _Stretch:
    """Points of a stretch of consecutive rows.

    Attributes
    ----------
    full : list of (n, 3) float64 array
        Those of the first rows.
    samples : dict of int to list of (offsets, xyz)
        For each length of a piece, every so many of the rows of all pieces.
    """

    full: list[NDArray[np.float64]] = field(default_factory=list)
    samples: dict[int, list[tuple[NDArray[np.int64], NDArray[np.float64]]]] = field(
        default_factory=dict
    )

    @classmethod
    def read(cls, collection: MapCollection, start: int, lengths: list[int]) -> "_Stretch":
        """Read the rows from a place on that pieces of these lengths take."""
        stretch = cls(samples={length: [] for length in lengths})
        rows = range(start, start + lengths[-1] * _PIECES)
        for _, batch in collection.batches(_BATCH, rows):
            offsets = batch.first_row - start + np.arange(len(batch.xyz))
            finite = (np.abs(batch.xyz) < _FARTHEST).all(axis=1)
            stretch.full.append(batch.xyz[finite & (offsets < _FULL)])
            for length, samples in stretch.samples.items():
                step = max(length // _SAMPLED, 1)
                chosen = finite & (offsets % step == 0) & (offsets < length * _PIECES)
                samples.append((offsets[chosen] // length, batch.xyz[chosen]))
        return stretch

    def is_coherent(self) -> bool:
        """Tell whether following rows lie nearer than random ones."""
        points = np.concatenate(self.full)
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
        piece = np.concatenate([pieces for pieces, _ in self.samples[length]])
        xyz = np.concatenate([points for _, points in self.samples[length]])
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
