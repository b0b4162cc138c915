"""From where scans are looked at: where the sensor was, or, if nobody tells, above their middle.

The points of a map are in their places, whoever looks. So a range image may be drawn from another
place than the sensor's: what lies behind a place, and was seen, shows that nothing was there. A
metre above the median of a scan's points is near the sensor, for sensors that look all around.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Self

import numpy as np

from dynahull.checking import valid_points
from dynahull.evidence.visits import Scans
from dynahull.evidence.voxels import Floats, Voxels, cells_of

_STEP = 0.5
"""Metres: medians are found in steps, so that they are those of parts of the map together."""

_ABOVE = np.array([0.0, 0.0, 1.0])
"""Metres: outdoors, most of what a sensor sees is the ground."""

_EVERY = 7
"""One row of so many counts, by its number in the whole map."""

MOST_VIEWPOINTS = 20_000
"""Of longer recordings, scans on end share one."""

_SCANS_AT_A_TIME = 2_000


@dataclass(frozen=True, slots=True)
class Viewpoints:
    """From where the scans of a map are looked at.

    Attributes
    ----------
    numbers : (S,) int32 array
        The first scan that is looked at from each place, ascending.
    places : (S, 3) float64 array
        Metres; no numbers where nothing is known.
    are_told : bool
        Whether the sensor was there, by the poses of the scans.
    """

    numbers: Scans
    places: Floats
    are_told: bool = False

    @classmethod
    def of_poses(cls, sensor: Floats) -> Self:
        """Take the places of the sensor, (S, 3), in the scans 0 to S - 1."""
        return cls(np.arange(len(sensor), dtype=np.int32), sensor, are_told=True)

    @classmethod
    def of_counts(cls, parts: Callable[[], Iterable[Voxels]]) -> Self:
        """Find the medians of scans by what `count_coordinates` says of parts of a map.

        Some scans are looked at together, so that memory is bounded.

        Parameters
        ----------
        parts : callable
            Returns what the parts say, one after the other; it is asked several times.
        """
        scans = np.zeros(0, np.int32)
        for part in parts():
            scans = np.union1d(scans, part.cells[:, 0])
        numbers = scans[:: -(-len(scans) // MOST_VIEWPOINTS) or 1]
        places = np.empty((len(numbers), 3))
        for begin in range(0, len(numbers), _SCANS_AT_A_TIME):
            some = slice(begin, begin + _SCANS_AT_A_TIME)
            own = [part.select(np.isin(part.cells[:, 0], numbers[some])) for part in parts()]
            places[some] = _medians(Voxels.merged(own)) + _ABOVE
        return cls(numbers, places)

    def rows(self, scan: Scans) -> Scans:
        """Return the viewpoint of each point, (n,), by the number of its scan; -1 where none is."""
        rows = np.searchsorted(self.numbers, scan, side="right") - 1
        return np.where(scan >= 0, rows, -1).astype(np.int32)


def _medians(counts: Voxels) -> Floats:
    """Return the median of each scan along each axis, (S, 3), in the order of their numbers."""
    cells, total = counts.cells, np.cumsum(counts.sums[:, 0])
    # Three groups a scan: its coordinates along each axis.
    firsts = np.flatnonzero((np.diff(cells[:, :2], axis=0, prepend=-1) != 0).any(axis=1))
    before = np.concatenate([[0], total])[firsts]
    after = np.concatenate([before[1:], total[-1:]])
    middles = np.searchsorted(total, before + (after - before + 1) // 2)
    return np.asarray(((cells[middles, 2] + 0.5) * _STEP).reshape(-1, 3))


def count_coordinates(xyz: Floats, scan: Scans, first_row: int) -> Voxels:
    """Count coordinates along each axis, in steps, of the scans of consecutive points of a map.

    Parameters
    ----------
    xyz : (n, 3) float64 array
        Points that cannot be measured do not count.
    scan : (n,) int32 array
        The scan of each, -1 where it is not known.
    first_row : int
        Number of the first of them in the whole map.

    Returns
    -------
    Voxels
        Its cells are scan, axis and step.
    """
    own = slice(-first_row % _EVERY, None, _EVERY)
    chosen = valid_points(xyz[own]) & (scan[own] >= 0)
    steps = cells_of(np.ascontiguousarray(xyz[own][chosen]), _STEP)
    cells = np.empty((len(steps), 3, 3), np.int32)
    cells[:, :, 0] = scan[own][chosen, None]
    cells[:, :, 1] = np.arange(3)
    cells[:, :, 2] = steps
    return Voxels.of(cells.reshape(-1, 3), np.ones((3 * len(steps), 1), np.int64))
