"""Points of scans and maps, and the voxel filter that SLAM systems thin them with."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Points:
    """n points, free of motion distortion, as after perfect deskewing.

    Attributes
    ----------
    xyz : (n, 3) float64 array
        In the map's frame, placed by the estimated pose, in metres.
    intensity : (n,) float32 array
        Calibrated reflectivity, 0 to 255.
    time : (n,) float64 array
        In seconds.
    surface : (n,) uint8 array
        `Surface` each point lies on.
    moving : (n,) bool array
        Whether each lies on something that changes its place: a ghost.
    known : (n,) bool array
        Whether that can be told honestly.
    scan : (n,) int32 array
        The scan that saw the point.
    """

    xyz: NDArray[np.float64]
    intensity: NDArray[np.float32]
    time: NDArray[np.float64]
    surface: NDArray[np.uint8]
    moving: NDArray[np.bool_]
    known: NDArray[np.bool_]
    scan: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.xyz)

    def take(self, which: NDArray[np.bool_] | NDArray[np.int64] | slice) -> "Points":
        """Return some of the points."""
        return Points(*(getattr(self, field.name)[which] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence["Points"]) -> "Points":
        """Put points one after the other."""
        names = [field.name for field in fields(cls)]
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

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
