"""What is never removed, whatever the method says: points of some classes, or in some areas."""

from collections.abc import Sequence
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, model_validator

Corner = tuple[float, float]


class Area(BaseModel, extra="forbid", frozen=True):
    """A polygon seen from above, between two heights; metres, as the map's coordinates."""

    rings: tuple[tuple[Corner, ...], ...]
    """What lies within an odd number of them is in the area: the second ring is a hole."""
    low: float | None = None
    high: float | None = None
    """z; None for no limit."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if not self.rings or any(len(ring) < 3 for ring in self.rings):
            raise ValueError("an area has rings of at least three corners")
        if not np.isfinite([corner for ring in self.rings for corner in ring]).all():
            raise ValueError("corners of an area are finite numbers")
        if self.low is not None and self.high is not None and not self.low <= self.high:
            raise ValueError(f"low ({self.low:g}) is above high ({self.high:g})")
        return self

    @classmethod
    def box(cls, low: Sequence[float], high: Sequence[float]) -> "Area":
        """Return the box between two opposite corners, (x, y) or (x, y, z)."""
        (x0, y0), (x1, y1) = low[:2], high[:2]
        heights = {}
        if len(low) > 2:
            heights["low"], heights["high"] = sorted((low[2], high[2]))
        return cls(rings=(((x0, y0), (x1, y0), (x1, y1), (x0, y1)),), **heights)

    def reaches(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
        """Tell whether its bounds meet a box, two corners (3,)."""
        corners = np.concatenate([np.array(ring) for ring in self.rings])
        own_low = [*corners.min(axis=0), -np.inf if self.low is None else self.low]
        own_high = [*corners.max(axis=0), np.inf if self.high is None else self.high]
        return bool((high >= own_low).all() and (low <= own_high).all())

    def holds(self, xyz: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Tell which points lie in it, (n,), by the even-odd rule."""
        corners = np.concatenate([np.array(ring) for ring in self.rings])
        flat = xyz[:, :2]
        near = ((flat >= corners.min(axis=0)) & (flat <= corners.max(axis=0))).all(axis=1)
        if self.low is not None:
            near &= xyz[:, 2] >= self.low
        if self.high is not None:
            near &= xyz[:, 2] <= self.high
        rows = np.flatnonzero(near)
        rows = rows[np.argsort(flat[rows, 1])]
        inside = np.zeros(len(rows), np.bool_)
        heights = flat[rows, 1]
        for ring in self.rings:
            span = [min(corner[1] for corner in ring), max(corner[1] for corner in ring)]
            beside = slice(*np.searchsorted(heights, span))  # of many rings, each looks at few
            x, y = flat[rows[beside]].T
            for (x0, y0), (x1, y1) in zip(ring, (*ring[1:], ring[0]), strict=True):
                if y0 != y1:
                    crosses = (y < y0) != (y < y1)
                    inside[beside] ^= crosses & (x < x0 + (y - y0) * ((x1 - x0) / (y1 - y0)))
        near[rows] = inside
        return np.asarray(near)


def protected_points(
    xyz: NDArray[np.float64],
    classes: NDArray[np.uint8] | None,
    protected_classes: Sequence[int],
    areas: Sequence[Area],
) -> NDArray[np.bool_]:
    """Tell which points are never removed, (n,).

    Parameters
    ----------
    xyz : (n, 3) float64 array
        Metres.
    classes : (n,) uint8 array or None
        ASPRS classes, where there are any.
    """
    protected = np.zeros(len(xyz), np.bool_)
    if classes is not None and protected_classes:
        protected |= np.isin(classes, protected_classes)
    for area in areas:
        protected |= area.holds(xyz)
    return protected
