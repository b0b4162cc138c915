"""How many scans saw through each place: what stands lets no ray pass.

A range image holds, for each direction from where the sensor was, how far the nearest return is.
Most of its pixels are empty: what is kept are the returns, four bytes each, and the image of a scan
is drawn when it is looked at. Images of parts of a scan are joined by the nearer return: so they
are those of the whole scan, in any order, to the last bit. Directions are those of the map,
whichever way the sensor looked.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Self

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, helper
from dynahull.evidence.visits import Scans
from dynahull.evidence.voxels import Cells, Floats, Integers
from dynahull.threads import over_items

FACE = 90
"""Pixels along each side of the six faces of a cube about the sensor: some degree each."""

PIXELS = 6 * FACE * FACE

Images = npt.NDArray[np.uint16]
"""Ranges in centimetres, (scans, PIXELS); `NOTHING` where nothing returned."""

NOTHING = 65_535

THROUGH, CLEARLY, MET = range(3)
"""Columns of what is counted: scans whose return in the direction of a voxel is behind it; whose
returns in all directions around are behind it; and whose return is at the voxel itself."""

VIEWS = 3

_FARTHEST = 40.0
"""Metres: farther away, a pixel is wider than a person."""

_NEAREST = 0.3
"""Metres: what is nearer is the sensor's own mount."""

_SCANS_AT_A_TIME = 128
_LEAST_A_THREAD = 20_000

RETURN_BYTES = 4
"""Of one return."""

HELD_BYTES = _SCANS_AT_A_TIME * PIXELS * (RETURN_BYTES + 2 * 2)
"""Of the scans that are in memory while it is counted what they saw: of each its image, the nearest
returns around, and at most as many returns as it has pixels, unless tiles share many of them."""

_Rows = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Returns:
    """The nearest return in each pixel of each scan, of some points of a map.

    Attributes
    ----------
    counts : (S,) int64 array
        Returns of each scan.
    returns : (n,) uint32 array
        Scan after scan: the pixel in the upper sixteen bits, centimetres in the lower.
    """

    counts: Integers
    returns: npt.NDArray[np.uint32]

    @classmethod
    def of(cls, xyz: Floats, scan: Scans, sensor: Floats) -> Self:
        """Find the nearest returns.

        Parameters
        ----------
        xyz : (n, 3) float64 array
            Points of a map, metres.
        scan : (n,) int32 array
            The row of `sensor` that saw each, -1 where it is not known.
        sensor : (S, 3) float64 array
            Where the sensor was in each scan, metres.
        """
        keys = _keys(xyz, scan, sensor)
        keys.sort()
        pixels = keys >> 16
        nearest = keys[np.diff(pixels, prepend=-1) != 0]
        counts = np.bincount(nearest >> 32, minlength=len(sensor)).astype(np.int64, copy=False)
        return cls(counts, nearest.astype(np.uint32))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Return those of all parts together; a pixel may be there once for each part."""
        counts = np.sum([part.counts for part in parts], axis=0)
        together = cls(counts, np.empty(counts.sum(), np.uint32))
        together.take(parts)
        return together

    def take(self, parts: Iterable[Self]) -> None:
        """Write all returns anew: those of all parts, which together are as many in each scan."""
        places = np.cumsum(self.counts) - self.counts
        for part in parts:
            before = np.cumsum(part.counts) - part.counts
            moved = np.repeat(places - before, part.counts)
            self.returns[moved + np.arange(len(part.returns))] = part.returns
            places += part.counts

    def images(self, rows: _Rows) -> Images:
        """Return the range images of some scans, (R, PIXELS)."""
        images = np.full((len(rows), PIXELS), NOTHING, np.uint16)
        stops = np.cumsum(self.counts)[rows]
        _draw(stops - self.counts[rows], stops, self.returns, images)
        return images


@dataclass(frozen=True, slots=True)
class Views:
    """Where the sensor was in each scan, and what it saw.

    Attributes
    ----------
    sensor : (S, 3) float64 array
        Metres; no numbers where it is not known.
    images_of : callable
        Given some rows of `sensor`, returns the range images of these scans.
    """

    sensor: Floats
    images_of: Callable[[_Rows], Images]

    def count(self, cells: Cells, side: float, threads: int = 1) -> Integers:
        """Count the scans that saw through the middle of each voxel, and those that met it.

        Returns
        -------
        (V, VIEWS) int64 array
        """
        counts = np.zeros((len(cells), VIEWS), np.int64)
        middles = (cells.astype(np.float64) + 0.5) * side
        for rows in self._near(middles):
            sensor, images = self.sensor[rows], self.images_of(rows)
            look = partial(_look_at, middles, sensor, images, _nearest_around(images), counts)
            over_items(look, len(cells), threads, _LEAST_A_THREAD)
        return counts

    def _near(self, middles: Floats) -> Iterator[_Rows]:
        """Yield the scans from which any of the places may be near, some at a time."""
        low = middles.min(axis=0, initial=np.inf) - _FARTHEST
        high = middles.max(axis=0, initial=-np.inf) + _FARTHEST
        near = np.flatnonzero(((self.sensor >= low) & (self.sensor <= high)).all(axis=1))
        for begin in range(0, len(near), _SCANS_AT_A_TIME):
            yield near[begin : begin + _SCANS_AT_A_TIME]


@helper
def _pixel_of(x: float, y: float, z: float) -> int:
    """Return the pixel of a direction, which is no zero."""
    along_x, along_y, along_z = abs(x), abs(y), abs(z)
    if along_x >= along_y and along_x >= along_z:
        face, u, v = (0 if x > 0 else 1), y / along_x, z / along_x
    elif along_y >= along_z:
        face, u, v = (2 if y > 0 else 3), x / along_y, z / along_y
    else:
        face, u, v = (4 if z > 0 else 5), x / along_z, y / along_z
    column = min(int((u + 1.0) * (0.5 * FACE)), FACE - 1)
    row = min(int((v + 1.0) * (0.5 * FACE)), FACE - 1)
    return (face * FACE + row) * FACE + column


@compiled
def _keys(xyz: Floats, scan: Scans, sensor: Floats) -> Integers:
    """Return scan, pixel and centimetres of each return, in one number that sorts by them."""
    keys, count = np.empty(len(xyz), np.int64), 0
    for i in range(len(xyz)):
        s = np.int64(scan[i])
        if s < 0 or s >= len(sensor):
            continue
        x, y, z = xyz[i, 0] - sensor[s, 0], xyz[i, 1] - sensor[s, 1], xyz[i, 2] - sensor[s, 2]
        distance = np.sqrt(x * x + y * y + z * z)
        if distance >= _NEAREST:
            centimetres = int(min(distance * 100.0, NOTHING - 1.0))
            keys[count] = (s << 32) | (_pixel_of(x, y, z) << 16) | centimetres
            count += 1
    return keys[:count]


@compiled
def _draw(
    starts: Integers, stops: Integers, returns: npt.NDArray[np.uint32], images: Images
) -> None:
    for r in range(len(images)):
        for i in range(starts[r], stops[r]):
            pixel, centimetres = returns[i] >> 16, np.uint16(returns[i] & 0xFFFF)
            images[r, pixel] = min(images[r, pixel], centimetres)


@compiled
def _nearest_around(images: Images) -> Images:
    """Return the nearest return in each pixel and those around it on its face."""
    found = np.empty_like(images)
    for s in range(len(images)):
        for face in range(6):
            for row in range(FACE):
                for column in range(FACE):
                    nearest = images[s, (face * FACE + row) * FACE + column]
                    for i in range(max(row - 1, 0), min(row + 2, FACE)):
                        for j in range(max(column - 1, 0), min(column + 2, FACE)):
                            nearest = min(nearest, images[s, (face * FACE + i) * FACE + j])
                    found[s, (face * FACE + row) * FACE + column] = nearest
    return found


@compiled
def _look_at(
    middles: Floats,
    sensor: Floats,
    images: Images,
    around: Images,
    counts: Integers,
    begin: int,
    end: int,
) -> None:
    for s in range(len(sensor)):
        for v in range(begin, end):
            x = middles[v, 0] - sensor[s, 0]
            y = middles[v, 1] - sensor[s, 1]
            z = middles[v, 2] - sensor[s, 2]
            squared = x * x + y * y + z * z
            if not _NEAREST * _NEAREST <= squared <= _FARTHEST * _FARTHEST:
                continue
            distance = np.sqrt(squared) * 100.0
            margin = 20.0 + 0.01 * distance
            pixel = _pixel_of(x, y, z)
            nearest, nearest_around = images[s, pixel], around[s, pixel]
            if nearest != NOTHING:
                counts[v, THROUGH] += nearest > distance + margin
                counts[v, MET] += abs(nearest - distance) <= margin
            counts[v, CLEARLY] += nearest_around != NOTHING and nearest_around > distance + margin
