"""How many scans saw through each place: what stands lets no ray pass.

A range image holds, for each direction from where the sensor was, how far the nearest return is.
Images of parts of a scan are joined by the nearer return: so they are those of the whole scan, in
any order, to the last bit. Directions are those of the map, whichever way the sensor looked.
"""

from collections.abc import Callable, Iterable, Iterator
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

IMAGE_BYTES = 2 * PIXELS
"""Of one range image."""

HELD_BYTES = 3 * _SCANS_AT_A_TIME * IMAGE_BYTES
"""Of the images that are in memory while it is counted what they saw, at most: of each scan as it
lies in a file, as it was read, and the nearest returns around."""

_Rows = npt.NDArray[np.intp]


@dataclass(frozen=True, slots=True)
class Returns:
    """The nearest return in each pixel, of some points of a map.

    Attributes
    ----------
    pixel : (n,) int64 array
        Number of the scan times `PIXELS`, and the pixel; ascending, each once.
    range : (n,) uint16 array
        Centimetres.
    """

    pixel: Integers
    range: Images

    @classmethod
    def of(cls, xyz: Floats, scan: Scans, sensor: Floats) -> Self:
        """Find the nearest returns; see `draw_images`."""
        seen = np.unique(scan[scan >= 0])
        pixels, ranges = [np.zeros(0, np.int64)], [np.zeros(0, np.uint16)]
        for begin in range(0, len(seen), _SCANS_AT_A_TIME):
            rows = seen[begin : begin + _SCANS_AT_A_TIME].astype(np.intp)
            images = draw_images([(xyz, scan)], sensor, rows)
            row, pixel = np.nonzero(images != NOTHING)
            pixels.append(rows[row] * PIXELS + pixel)
            ranges.append(images[row, pixel])
        return cls(np.concatenate(pixels), np.concatenate(ranges))

    def put_into(self, images: Images) -> None:
        """Put the returns into the images of all scans, (S, PIXELS)."""
        flat = images.reshape(-1)
        flat[self.pixel] = np.minimum(flat[self.pixel], self.range)


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


def draw_images(parts: Iterable[tuple[Floats, Scans]], sensor: Floats, rows: _Rows) -> Images:
    """Return the range images of some scans.

    Parameters
    ----------
    parts : iterable of (n, 3) float64 array and (n,) int32 array
        Points of a map, and the row of `sensor` that saw each, -1 where it is not known.
    sensor : (S, 3) float64 array
        Where the sensor was in each scan, metres.
    rows : (R,) int array
        The scans wanted.

    Returns
    -------
    (R, PIXELS) uint16 array
    """
    images = np.full((len(rows), PIXELS), NOTHING, np.uint16)
    places = np.full(len(sensor), -1, np.int32)
    places[rows] = np.arange(len(rows))
    for xyz, scan in parts:
        _draw(xyz, scan, sensor, places, images)
    return images


def draw_into(images: Images, xyz: Floats, scan: Scans, sensor: Floats) -> None:
    """Draw further points into the range images of all scans, (S, PIXELS); see `draw_images`."""
    _draw(xyz, scan, sensor, np.arange(len(sensor), dtype=np.int32), images)


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
def _draw(
    xyz: Floats, scan: Scans, sensor: Floats, places: npt.NDArray[np.int32], images: Images
) -> None:
    for i in range(len(xyz)):
        s = scan[i]
        if s < 0 or s >= len(sensor) or places[s] < 0:
            continue
        x, y, z = xyz[i, 0] - sensor[s, 0], xyz[i, 1] - sensor[s, 1], xyz[i, 2] - sensor[s, 2]
        distance = np.sqrt(x * x + y * y + z * z)
        if distance >= _NEAREST:
            nearer = np.uint16(min(distance * 100.0, NOTHING - 1.0))
            place, pixel = places[s], _pixel_of(x, y, z)
            images[place, pixel] = min(images[place, pixel], nearer)


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
