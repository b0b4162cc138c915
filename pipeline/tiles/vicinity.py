"""Where points lie that some others may reach: a coarse map that leaves out no such place."""

import numpy as np
from numpy.typing import NDArray

from dynahull.compilation import compiled

_MOST_CELLS = 1_000
"""Cells along each axis: a million together, a byte each."""


class Vicinity:
    """The surroundings, seen from above, of some points.

    A raster of square cells at least as wide as the farthest reach: all cells that hold one of the
    points, and those around these. So it holds every place within reach of a point, and some more.

    Parameters
    ----------
    xyz : (n, 3) float64 array
        The points, at least one.
    reach : (n,) float64 array
        How far from each, metres.

    Attributes
    ----------
    low, high : (2,) float64 arrays
        The box of the surroundings.
    """

    def __init__(self, xyz: NDArray[np.float64], reach: NDArray[np.float64]) -> None:
        flat = xyz[:, :2]
        extent = flat.max(axis=0) - flat.min(axis=0)
        # Wider than the reach, and than what coordinates tell apart, by more than the rounding of a
        # place can move it: so never two cells away.
        rounding = float(np.spacing(np.abs(flat).max()))
        self._cell = max(
            float(reach.max()) * 1.001, float(extent.max()) / _MOST_CELLS, 1e4 * rounding
        )
        self.low = flat.min(axis=0) - 2 * self._cell
        cells = ((flat - self.low) / self._cell).astype(np.int64)
        shape = cells.max(axis=0) + 3
        self.high = self.low + shape * self._cell
        self._marked = np.zeros(shape, np.bool_)
        for step_x in (-1, 0, 1):
            for step_y in (-1, 0, 1):
                self._marked[cells[:, 0] + step_x, cells[:, 1] + step_y] = True

    def holds(self, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which of other points lie there, (m,) bool."""
        found = np.empty(len(xyz), np.bool_)
        _look_up(xyz, self.low[0], self.low[1], self._cell, self._marked, found)
        return found

    def meets(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
        """Tell whether a box, which may be infinite, meets it."""
        first = np.maximum((low - self.low) / self._cell, 0)
        last = np.minimum((high - self.low) / self._cell, np.array(self._marked.shape))
        if (first > last).any():
            return False
        # A cell more on either side, for the rounding of the box's place.
        from_x, from_y = np.maximum(first.astype(np.int64) - 1, 0)
        to_x, to_y = last.astype(np.int64) + 2
        return bool(self._marked[from_x:to_x, from_y:to_y].any())


@compiled
def _look_up(
    xyz: NDArray[np.float64],
    low_x: float,
    low_y: float,
    cell: float,
    marked: NDArray[np.bool_],
    found: NDArray[np.bool_],
) -> None:
    """Tell of each point whether its cell is marked."""
    size_x, size_y = marked.shape
    for point in range(len(xyz)):
        place_x, place_y = (xyz[point, 0] - low_x) / cell, (xyz[point, 1] - low_y) / cell
        inside = 0 <= place_x < size_x and 0 <= place_y < size_y
        found[point] = inside and marked[int(place_x), int(place_y)]
