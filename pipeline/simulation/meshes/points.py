"""Points of scans and maps, and the voxel filter that SLAM systems thin them with."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.simulate import Returns


@dataclass(frozen=True, slots=True)
class Points:
    """n points.

    Attributes
    ----------
    xyz : (n, 3) float64 array
        In the map's frame.
    moved : (n,) bool array
        Whether each lies on something that changes its place during the recording.
    known : (n,) bool array
        Whether that can be told honestly.
    surface : (n,) uint8 array
        `Surface` of each.
    intensity : (n,) float32 array
    scan : (n,) int32 array
    time : (n,) float64 array
    """

    xyz: NDArray[np.float64]
    moved: NDArray[np.bool_]
    known: NDArray[np.bool_]
    surface: NDArray[np.uint8]
    intensity: NDArray[np.float32]
    scan: NDArray[np.int32]
    time: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.xyz)

    def take(self, which: NDArray[np.bool_] | NDArray[np.int64]) -> "Points":
        """Return some of the points."""
        return Points(*(getattr(self, field.name)[which] for field in fields(self)))

    @classmethod
    def joined(cls, parts: Sequence["Points"]) -> "Points":
        """Put points one after the other."""
        return cls(
            *(
                np.concatenate([getattr(part, field.name) for part in parts])
                for field in fields(cls)
            )
        )

    @classmethod
    def of_scan(cls, returns: Returns, number: int) -> "Points":
        """Return the points of a scan, all of known truth unless it says otherwise."""
        count = len(returns)
        known = np.ones(count, dtype=np.bool_) if returns.known is None else returns.known
        return cls(
            returns.xyz, returns.moving, known, returns.surface, returns.intensity,
            np.full(count, number, dtype=np.int32), returns.time,
        )  # fmt: skip

    def returns(self) -> Returns:
        """Return them as files take them."""
        return Returns(
            self.xyz, self.intensity, self.time, self.surface, self.moved, known=self.known
        )

    def filtered(self, size: float) -> "Points":
        """Put the centroid of its points in each voxel, as PCL's `VoxelGrid` does.

        Parameters
        ----------
        size : float
            In metres; 0 leaves all as it is.

        Returns
        -------
        Points
            What most points of a voxel are, in the order of their first points.
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
        kept.moved[:] = np.bincount(voxel, self.moved) / count > 0.5
        kept.known[:] = np.bincount(voxel, self.known) / count > 0.5
        return kept.take(np.argsort(first, kind="stable"))
