"""What rays can meet, axis-aligned boxes and upright cylinders, and at which exact distance.

Both bodies are convex: a ray is inside one for a single interval of its length, the intersection
of one interval for each pair of parallel faces and one for the mantle (the slab method of Kay and
Kajiya, "Ray tracing complex scenes", SIGGRAPH 1986).
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

Interval: TypeAlias = tuple[NDArray[np.float64], NDArray[np.float64]]
"""Distances at which each of n rays enters and leaves each of m bodies, two (n, m) arrays; a ray
that misses a body leaves it before it enters."""

_ALMOST_ZERO = 1e-30  # stands in for a direction component of 0, which cannot be divided by


class Surface(IntEnum):
    """The kind of thing a point lies on."""

    FLOOR = 0
    WALL = 1
    CEILING = 2
    FURNITURE = 3
    PERSON = 4

    @property
    def title(self) -> str:
        """The name used in files: `floor`, `wall` and so on."""
        return self.name.lower()


MOVING_SURFACES = (Surface.PERSON,)
"""The kinds of thing that move: a map without ghosts has no point on them."""


@dataclass(frozen=True, slots=True)
class Boxes:
    """Solid boxes with faces along the axes.

    Attributes
    ----------
    lower, upper : (m, 3) float64 array
        Opposite corners, in metres.
    surface : (m,) uint8 array
        `Surface` of each box.
    """

    lower: NDArray[np.float64]
    upper: NDArray[np.float64]
    surface: NDArray[np.uint8]

    def intersect(self, origins: NDArray[np.float64], directions: NDArray[np.float64]) -> Interval:
        """Return where each ray enters and leaves each box."""
        enter, leave = _between_planes(
            origins[:, 0], directions[:, 0], self.lower[:, 0], self.upper[:, 0]
        )
        for axis in (1, 2):
            near, far = _between_planes(
                origins[:, axis], directions[:, axis], self.lower[:, axis], self.upper[:, axis]
            )
            np.maximum(enter, near, out=enter)
            np.minimum(leave, far, out=leave)
        return enter, leave


@dataclass(frozen=True, slots=True)
class Cylinders:
    """Solid upright cylinders, which may stand elsewhere for each ray.

    Attributes
    ----------
    centre : (1, m, 2) or (n, m, 2) float64 array
        x and y of the axes, in metres: the same for all rays, or for each of n rays.
    radius, bottom, top : (m,) float64 array
        In metres.
    surface : (m,) uint8 array
        `Surface` of each cylinder.
    """

    centre: NDArray[np.float64]
    radius: NDArray[np.float64]
    bottom: NDArray[np.float64]
    top: NDArray[np.float64]
    surface: NDArray[np.uint8]

    def intersect(self, origins: NDArray[np.float64], directions: NDArray[np.float64]) -> Interval:
        """Return where each ray enters and leaves each cylinder.

        The mantle is met where ``|o + t d - c|^2 = r^2`` in the xy plane, a quadratic in t.
        """
        enter, leave = _between_planes(origins[:, 2], directions[:, 2], self.bottom, self.top)
        x = origins[:, None, 0] - self.centre[..., 0]
        y = origins[:, None, 1] - self.centre[..., 1]
        along_x, along_y = directions[:, None, 0], directions[:, None, 1]
        a = np.maximum(along_x**2 + along_y**2, _ALMOST_ZERO)
        half_b = x * along_x + y * along_y
        c = x**2 + y**2 - self.radius**2
        discriminant = half_b**2 - a * c
        missed = discriminant < 0
        root = np.sqrt(np.where(missed, 0.0, discriminant))
        np.maximum(enter, np.where(missed, np.inf, (-half_b - root) / a), out=enter)
        np.minimum(leave, np.where(missed, -np.inf, (-half_b + root) / a), out=leave)
        return enter, leave


@dataclass(frozen=True, slots=True)
class Hits:
    """What each of n rays meets first.

    Attributes
    ----------
    distance : (n,) float64 array
        In metres; infinite where the ray meets nothing.
    surface : (n,) uint8 array
        `Surface` that is met; without meaning where `distance` is infinite.
    """

    distance: NDArray[np.float64]
    surface: NDArray[np.uint8]

    def nearer(self, other: Self) -> "Hits":
        """Return the nearer hit of each ray."""
        behind = other.distance < self.distance
        return Hits(
            np.where(behind, other.distance, self.distance),
            np.where(behind, other.surface, self.surface),
        )


def first_hits(
    bodies: Boxes | Cylinders, origins: NDArray[np.float64], directions: NDArray[np.float64]
) -> Hits:
    """Cast rays at solid bodies.

    Parameters
    ----------
    bodies : Boxes or Cylinders
        Any number of them, none among them.
    origins : (n, 3) float64 array
        Where the rays begin, in metres. A body around a ray's origin is not seen by that ray.
    directions : (n, 3) float64 array
        Unit vectors.

    Returns
    -------
    Hits
    """
    if len(bodies.surface) == 0:
        return Hits(np.full(len(origins), np.inf), np.zeros(len(origins), dtype=np.uint8))
    enter, leave = bodies.intersect(origins, directions)
    distance = np.where((enter <= leave) & (enter > 0), enter, np.inf)
    first = distance.argmin(axis=1)
    return Hits(distance[np.arange(len(origins)), first], bodies.surface[first])


def _between_planes(
    origin: NDArray[np.float64],
    direction: NDArray[np.float64],
    lower: NDArray[np.float64],
    upper: NDArray[np.float64],
) -> Interval:
    """Return where n rays are between m pairs of planes across one axis."""
    nonzero = np.where(np.abs(direction) < _ALMOST_ZERO, _ALMOST_ZERO, direction)[:, None]
    to_lower = (lower - origin[:, None]) / nonzero
    to_upper = (upper - origin[:, None]) / nonzero
    return np.minimum(to_lower, to_upper), np.maximum(to_lower, to_upper)
