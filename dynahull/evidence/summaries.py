"""What is summed over the voxels of a map, and all that is ever read of points around a point."""

from dataclasses import dataclass
from typing import Self, TypeVar

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled
from dynahull.evidence.shapes import MOMENTS, moments_of, moved_moments
from dynahull.evidence.visits import SPANS, Scans, marks_of
from dynahull.evidence.voxels import Cells, Floats, Integers, Voxels, cells_of
from dynahull.summary import Summary

AnySummary = TypeVar("AnySummary", bound=Summary)

FINEST = 0.1
"""Side of the finest voxels, metres; each level above has twice the side."""

LEVELS = 5

REACH = 2 * FINEST * 2 ** (LEVELS - 1)
"""Metres: no point farther than this, along x or y, decides anything about a point."""

GROUND, SCORED, DENSITY, THICKNESS = range(4)
"""Columns of what is summed: ground points, scored points, and of these the logarithms of density
and thickness; the moments of the scored points follow."""

SHAPE = 4
COLUMNS = SHAPE + MOMENTS
"""After them come the marks of scans, where scans are known."""

OCTAVE = 256
"""Logarithms to base 2 are summed in whole steps, so many to an octave."""

THINNEST = 1e-4
"""Metres; what is thinner is told from nothing."""

_DENSEST = 2.0**30
_POINTS_AT_A_TIME = 250_000


class TimedVoxels(Voxels):
    """Sums over points whose scans are known: the marks of these follow."""

    marks = len(SPANS)


@dataclass(frozen=True, slots=True)
class ScoredPoints:
    """Ground-free points, and what their neighbours say.

    Attributes
    ----------
    xyz : (n, 3) float64 array
        Metres.
    density : (n,) float64 array
        k / v; infinite where flat, NaN in a cluster too small to be scored.
    spread : (n, SPREAD_COLUMNS) float32 array
        See `dynahull.density.reference_spreads`.
    height : (n,) float64 array
        Above the ground, metres; NaN where none is near.
    scan : (n,) int32 array or None
        Number of the scan that saw each; -1 where it is not known.
    """

    xyz: Floats
    density: Floats
    spread: npt.NDArray[np.float32]
    height: Floats
    scan: Scans | None = None

    def __len__(self) -> int:
        return len(self.xyz)

    def part(self, chosen: slice | npt.NDArray[np.bool_] | npt.NDArray[np.intp]) -> Self:
        """Return some of the points."""
        return type(self)(
            self.xyz[chosen],
            self.density[chosen],
            self.spread[chosen],
            self.height[chosen],
            None if self.scan is None else self.scan[chosen],
        )

    def log_density(self) -> Floats:
        """Return the logarithm of the density to base 2, within what can be summed."""
        density = np.nan_to_num(self.density, nan=1.0, posinf=_DENSEST)
        return logarithms(np.clip(density, 1 / _DENSEST, _DENSEST))

    def log_thickness(self) -> Floats:
        """Return the logarithm of the thickness to base 2."""
        thickness = np.nan_to_num(self.spread[:, 0]).astype(np.float64)
        return logarithms(np.maximum(thickness, THINNEST))


def summarise_points(points: ScoredPoints) -> Voxels:
    """Sum up scored points in the finest voxels, (V, COLUMNS), and mark their scans."""
    begins = range(0, max(len(points), 1), _POINTS_AT_A_TIME)
    return Voxels.merged(
        [_summarised(points.part(slice(begin, begin + _POINTS_AT_A_TIME))) for begin in begins]
    )


def _summarised(points: ScoredPoints) -> Voxels:
    values = np.empty((len(points), COLUMNS), np.int64)
    values[:, GROUND] = 0
    values[:, SCORED] = 1
    values[:, DENSITY] = in_steps(points.log_density())
    values[:, THICKNESS] = in_steps(points.log_thickness())
    values[:, SHAPE:] = moments_of(points.xyz)
    return _marked(cells_of(points.xyz, FINEST), values, points.scan)


def summarise_ground(xyz: Floats, scan: Scans | None = None) -> Voxels:
    """Sum up points that are not scored: ground, and what lies too high, (V, COLUMNS)."""
    counted = _marked(cells_of(xyz, FINEST), np.ones((len(xyz), 1), np.int64), scan)
    sums = np.zeros((len(counted), COLUMNS + counted.marks), np.int64)
    sums[:, GROUND] = counted.sums[:, 0]
    sums[:, COLUMNS:] = counted.sums[:, 1:]
    return type(counted)(counted.cells, sums)


def about_middles(voxels: Voxels, way: int = 1) -> Voxels:
    """Return sums over points, their moments taken from the middles of voxels, not from the origin.

    They are small then, and take few bytes on a disk. Way -1 goes back to the origin.
    """
    sums = moved_moments(voxels.cells, voxels.sums, SCORED, SHAPE, FINEST, way)
    return type(voxels)(voxels.cells, sums)


def _marked(cells: Cells, values: Integers, scan: Scans | None) -> Voxels:
    if scan is None:
        return Voxels.of(cells, values)
    return TimedVoxels.of(cells, np.column_stack([values, marks_of(scan)]))


LIKELY, ODDS = 1, 2
"""Columns of summed odds: points come first, then those more likely to have moved than not, and the
logarithms of their odds."""

LARGEST_ODDS = 8.0
"""Of a logarithm of odds that is summed: one point must not speak for all."""


def summarise_odds(xyz: Floats, log_odds: npt.NDArray[np.float32]) -> Voxels:
    """Sum up what the first round made of points, in the finest voxels, (V, 3)."""
    values = np.ones((len(xyz), 3), np.int64)
    values[:, LIKELY] = log_odds > 0
    values[:, ODDS] = in_steps(np.clip(log_odds.astype(np.float64), -LARGEST_ODDS, LARGEST_ODDS))
    return Voxels.of(cells_of(xyz, FINEST), values)


@compiled
def logarithms(values: Floats) -> Floats:
    """Return logarithms to base 2, one by one: NumPy's may depend on the place in the array."""
    found = np.empty(len(values))
    for i in range(len(values)):
        found[i] = np.log2(values[i])
    return found


def in_steps(logarithms: Floats) -> Integers:
    """Return logarithms as whole steps of an octave."""
    return np.rint(logarithms * OCTAVE).astype(np.int64)


def around(voxels: AnySummary, low: Floats, high: Floats) -> AnySummary:
    """Return the voxels that decide about points in a box.

    Parameters
    ----------
    low, high : (2,) float64 arrays
        The box in x and y, metres; it may be infinite.
    """
    coarsest = 2 ** (LEVELS - 1)
    side = FINEST * coarsest

    def cells(place: Floats, more: int) -> Integers:
        flat = np.nan_to_num(np.floor(place / side), posinf=2.0**40, neginf=-(2.0**40))
        return np.asarray((flat.astype(np.int64) + more) * coarsest)

    return voxels.within(cells(low, -1), cells(high, 2) - 1)
