"""What rays can meet: boxes, which may lie on a slope, and upright cylinders.

Two primitives are enough for floors, ramps, walls, furniture, people, machines and trees, and the
distance along a ray to either is exact.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray


class Surface(IntEnum):
    """The kind of thing a point lies on."""

    FLOOR = 0
    WALL = 1
    CEILING = 2
    FURNITURE = 3
    PERSON = 4
    MACHINE = 5
    VEHICLE = 6
    VEGETATION = 7

    @property
    def title(self) -> str:
        """The name used in files: `floor`, `wall` and so on."""
        return self.name.lower()


@dataclass(frozen=True, slots=True)
class Shapes:
    """Solid bodies.

    Attributes
    ----------
    boxes : (b, 8) float64 array
        Lower x, y, z, upper x, y, z, and the slopes along x and y: the points of a box are those
        with x and y within the bounds, and with z - slope_x x - slope_y y between lower and upper
        z. In metres.
    box_surface : (b,) uint8 array
        `Surface` of each box.
    cylinders : (c, 5) float64 array
        x and y of the axis, radius, bottom and top, in metres.
    cylinder_surface : (c,) uint8 array
        `Surface` of each cylinder.
    """

    boxes: NDArray[np.float64]
    box_surface: NDArray[np.uint8]
    cylinders: NDArray[np.float64]
    cylinder_surface: NDArray[np.uint8]

    @classmethod
    def of(
        cls,
        boxes: Sequence[Sequence[float]] = (),
        box_surface: Sequence[int] = (),
        cylinders: Sequence[Sequence[float]] = (),
        cylinder_surface: Sequence[int] = (),
    ) -> "Shapes":
        """Make shapes from rows, none among them."""
        return cls(
            np.array(boxes, dtype=np.float64).reshape(-1, 8),
            np.array(box_surface, dtype=np.uint8),
            np.array(cylinders, dtype=np.float64).reshape(-1, 5),
            np.array(cylinder_surface, dtype=np.uint8),
        )

    @classmethod
    def joined(cls, parts: Sequence["Shapes"]) -> "Shapes":
        """Put the boxes of all parts one after the other, and so their cylinders."""
        parts = [cls.of(), *parts]
        return cls(
            np.concatenate([part.boxes for part in parts]),
            np.concatenate([part.box_surface for part in parts]),
            np.concatenate([part.cylinders for part in parts]),
            np.concatenate([part.cylinder_surface for part in parts]),
        )

    def surface_of(self, index: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Return the `Surface` of shapes by number: all boxes first, then the cylinders."""
        return np.concatenate([self.box_surface, self.cylinder_surface])[index]

    def reach(self) -> float:
        """Return the greatest distance of any part from the z axis, in metres."""
        corners = np.abs(self.boxes[:, [0, 1, 3, 4]]).reshape(-1, 2, 2).max(axis=1, initial=0.0)
        away = np.hypot(self.cylinders[:, 0], self.cylinders[:, 1]) + self.cylinders[:, 2]
        return float(
            max(np.hypot(*corners.T).max(initial=0.0), away.max(initial=0.0)),
        )

    def mirrored(self, axis: int, length: float) -> "Shapes":
        """Swap left and right along x (axis 0) or y (axis 1), within 0 to `length`."""
        boxes, cylinders = self.boxes.copy(), self.cylinders.copy()
        boxes[:, axis] = length - self.boxes[:, axis + 3]
        boxes[:, axis + 3] = length - self.boxes[:, axis]
        # z - slope x, with x = length - x': what is left of the slope is added to the bounds.
        slope = self.boxes[:, axis + 6]
        boxes[:, [2, 5]] += (slope * length)[:, None]
        boxes[:, axis + 6] = -slope
        cylinders[:, axis] = length - self.cylinders[:, axis]
        return Shapes(boxes, self.box_surface, cylinders, self.cylinder_surface)
