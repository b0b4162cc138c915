"""Tables of arrays: points of scans and maps, and the voxel filter that SLAM thins them with."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Random = np.random.Generator


@dataclass(frozen=True, slots=True)
class Columns:
    """A table: arrays of one length, which say different things about the same."""

    def __len__(self) -> int:
        return len(getattr(self, fields(self)[0].name))

    def take(self, which: NDArray[Any] | slice) -> Self:
        """Return some of the rows."""
        return type(self)(*(getattr(self, field.name)[which] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence[Self]) -> Self:
        """Put tables one after the other."""
        names = [field.name for field in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def replaced(self, other: Self, where: NDArray[np.bool_]) -> Self:
        """Return these rows, but those of another table where told."""
        both = ((getattr(other, field.name), getattr(self, field.name)) for field in fields(self))
        return type(self)(*(np.where(where, *pair) for pair in both))


@dataclass(frozen=True, slots=True)
class Points(Columns):
    """n points, free of motion distortion, as after perfect deskewing."""

    xyz: Floats  # (n, 3), in the map's frame, placed by the estimated pose, in metres
    intensity: NDArray[np.float32]  # calibrated reflectivity, 0 to 255
    time: Floats  # in seconds
    surface: NDArray[np.uint8]  # the `Surface` it lies on
    moving: NDArray[np.bool_]  # whether it lies on something that changes its place: a ghost
    known: NDArray[np.bool_]  # whether that can be told honestly
    scan: NDArray[np.int32]  # the scan that saw the point

    def filtered(self, size: float) -> "Points":
        """Put the centroid of its points in each voxel, as PCL's `VoxelGrid` does.

        It is what most points of the voxel are, and stands where the first of them did. The size is
        in metres; 0 leaves all as it is.
        """
        if not size or not len(self):
            return self
        cell = np.floor(self.xyz / size).astype(np.int64)
        cell -= cell.min(axis=0)
        sides = cell.max(axis=0) + 1
        key = (cell[:, 0] * sides[1] + cell[:, 1]) * sides[2] + cell[:, 2]
        _, first, voxel = np.unique(key, return_index=True, return_inverse=True)
        count = np.bincount(voxel)
        kept = self.take(first)
        for axis in range(3):
            kept.xyz[:, axis] = np.bincount(voxel, self.xyz[:, axis]) / count
        kept.moving[:] = np.bincount(voxel, self.moving) / count > 0.5
        kept.known[:] = np.bincount(voxel, self.known) / count > 0.5
        return kept.take(np.argsort(first, kind="stable"))
