"""What every method is given: a map, and the scans and poses that made it."""

from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

__all__ = ["Scan", "Scene"]


class Scan(NamedTuple):
    """One scan of a scene.

    Attributes
    ----------
    rows : (n,) int array
        Which points of the map it gave.
    points : (n, 3) float64 array
        In the map's frame, metres.
    pose : (3, 4) float64 array
        From the sensor's frame to the map's, as a SLAM system estimated it.
    """

    rows: NDArray[np.intp]
    points: NDArray[np.float64]
    pose: NDArray[np.float64]

    @property
    def origin(self) -> NDArray[np.float64]:
        """Where the sensor was, (3,), in the map's frame."""
        return self.pose[:, 3]

    def in_sensor_frame(self) -> NDArray[np.float64]:
        """Return the points as the sensor saw them, (n, 3)."""
        return (self.points - self.pose[:, 3]) @ self.pose[:, :3]


@dataclass(frozen=True, slots=True)
class Scene:
    """A map, the truth about its points, and the scans it was made of.

    Attributes
    ----------
    name : str
        `indoor, seed 0`.
    group : str
        Scenes of the same group share a table, which has the means over them.
    xyz : (N, 3) float64 array
        The map, metres.
    labels : (N,) int8 array
        `pipeline.evaluation.truth.Truth`; only known points are scored.
    scan : (N,) int32 array
        The scan that saw each point.
    poses : (S, 3, 4) float64 array
        Of each scan, from the sensor's frame to the map's.
    ring_spacing : float
        Degrees between two rings of the sensor: range images need to know.
    """

    name: str
    group: str
    xyz: NDArray[np.float64]
    labels: NDArray[np.int8]
    scan: NDArray[np.int32]
    poses: NDArray[np.float64]
    ring_spacing: float

    def __len__(self) -> int:
        return len(self.xyz)

    def scans(self) -> Iterator[Scan]:
        """Yield the scans that have points, in their order."""
        order = np.argsort(self.scan, kind="stable")
        ends = np.cumsum(np.bincount(self.scan, minlength=len(self.poses)))
        for pose, rows in zip(self.poses, np.split(order, ends[:-1]), strict=True):
            if len(rows):
                yield Scan(rows, self.xyz[rows], pose)

    def digest(self) -> str:
        """Return a hash of all that a method is given, and of the labels."""
        told = blake2b(f"{self.name} {self.ring_spacing}".encode(), digest_size=16)
        for array in (self.xyz, self.labels, self.scan, self.poses):
            told.update(np.ascontiguousarray(array).data)
        return told.hexdigest()

    def write(self, path: Path) -> None:
        """Write the scene for `read`."""
        np.savez(
            path,
            name=self.name,
            group=self.group,
            xyz=self.xyz,
            labels=self.labels,
            scan=self.scan,
            poses=self.poses,
            ring_spacing=self.ring_spacing,
        )

    @classmethod
    def read(cls, path: Path) -> "Scene":
        """Read what `write` wrote."""
        with np.load(path) as arrays:
            return cls(
                name=str(arrays["name"]),
                group=str(arrays["group"]),
                xyz=arrays["xyz"],
                labels=arrays["labels"],
                scan=arrays["scan"],
                poses=arrays["poses"],
                ring_spacing=float(arrays["ring_spacing"]),
            )
