"""The grid that LAS keeps coordinates on."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

_LARGEST = 2**31 - 1


@dataclass(frozen=True, slots=True)
class Grid:
    """Coordinates as 32-bit integers: coordinate = integer * scale + offset."""

    scales: tuple[float, float, float]
    offsets: tuple[float, float, float]

    def coordinates(self, integers: NDArray[np.int32]) -> NDArray[np.float64]:
        """Return the coordinates of integers, both (n, 3)."""
        xyz = np.empty((len(integers), 3))
        # An axis at a time: rows of three are too short for NumPy's loops.
        for axis in range(3):
            np.multiply(integers[:, axis], self.scales[axis], out=xyz[:, axis])
            xyz[:, axis] += self.offsets[axis]
        return xyz

    def integers(self, xyz: NDArray[np.float64]) -> NDArray[np.int32]:
        """Return the integers nearest to coordinates that the grid reaches, both (n, 3)."""
        return np.rint(self._steps(xyz)).astype(np.int32)

    def reaches(self, xyz: NDArray[np.float64]) -> bool:
        """Tell whether the integers of coordinates, (n, 3), are no larger than 32 bits."""
        return bool((np.abs(self._steps(xyz)) <= _LARGEST).all())

    def holds(self, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which coordinates, (n, 3), come back as they were, to the last bit.

        The sign of a zero is not looked at: no difference of coordinates depends on it.
        """
        steps = np.rint(self._steps(xyz))
        reached = np.asarray((np.abs(steps) <= _LARGEST).all(axis=1))
        back = self.coordinates(np.where(reached[:, None], steps, 0).astype(np.int32))
        return np.asarray(reached & (back == xyz).all(axis=1))

    def _steps(self, xyz: NDArray[np.float64]) -> NDArray[np.float64]:
        with np.errstate(over="ignore"):
            return np.asarray((xyz - np.array(self.offsets)) / np.array(self.scales))


def integers_in_records(records: NDArray[np.uint8]) -> NDArray[np.int32]:
    """Return a view of x, y and z of contiguous raw records of LAS, (n, 3) int32, not aligned."""
    strides = (records.shape[1], 4)
    return np.ndarray((len(records), 3), dtype="<i4", buffer=records, strides=strides)
