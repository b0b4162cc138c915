"""Rays against shapes, compiled: the exact distance to the first thing on the way.

Boxes and cylinders are convex: a ray is inside one for a single interval of its length, the
intersection of one interval for each pair of parallel faces and one for the mantle (the slab method
of Kay and Kajiya, "Ray tracing complex scenes", SIGGRAPH 1986). Things that move are elsewhere for
every firing of the sensor; a ray is taken into the frame that its target has at that moment.
Memory is a few numbers a ray, whatever the scene.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.scene import Shapes
from pipeline.simulation.tables import Columns, Floats
from tiling.compiled import compiled

_ALMOST_ZERO = 1e-30  # stands in for a direction component of 0, which cannot be divided by

_NOTHING = -1


@dataclass(frozen=True, slots=True)
class Hits(Columns):
    """What each of n rays meets first."""

    distance: Floats  # in metres; infinite where the ray meets nothing
    surface: NDArray[np.uint8]  # the `Surface` that is met; without meaning where nothing is


def first_hits(shapes: Shapes, origins: Floats, directions: Floats) -> Hits:
    """Cast rays at solid bodies that stand still.

    Parameters
    ----------
    origins : (n, 3) float64 array
        Where the rays begin, in metres. A body around a ray's origin is not seen by that ray.
    directions : (n, 3) float64 array
        Unit vectors.
    """
    starts = np.array([[0, 0], [len(shapes.boxes), len(shapes.cylinders)]])
    reach, frames = np.array([np.inf]), np.zeros((1, 1, 5))
    firings = np.zeros(len(origins), dtype=np.int64)
    return first_moving_hits(shapes, starts, reach, frames, firings, origins, directions)


def first_moving_hits(
    shapes: Shapes,
    starts: NDArray[np.int64],
    reach: Floats,
    frames: Floats,
    firings: NDArray[np.int64],
    origins: Floats,
    directions: Floats,
) -> Hits:
    """Cast rays at bodies that move.

    Parameters
    ----------
    shapes : Shapes
        The shapes of p movers, one mover after the other, each in the mover's own frame.
    starts : (p + 1, 2) int64 array
        Numbers of each mover's first box and first cylinder; the end last.
    reach : (p,) float64 array
        Greatest distance of a mover's shapes from its axis, in metres.
    frames : (f, p, 5) float64 array
        x, y, z, heading and slope (rise over distance ahead) of each mover at each of f firings.
    firings : (n,) int64 array
        The firing each ray belongs to.
    origins, directions : (n, 3) float64 arrays
        As for `first_hits`.
    """
    distance, index = _cast(
        shapes.boxes, shapes.cylinders, starts, reach, np.ascontiguousarray(frames),
        firings, origins, directions,
    )  # fmt: skip
    # `_NOTHING` is -1: the last of these.
    surface = [shapes.box_surface, shapes.cylinder_surface, np.zeros(1, np.uint8)]
    return Hits(distance, np.concatenate(surface)[index])


@compiled
def _cast(
    boxes: Floats,
    cylinders: Floats,
    starts: NDArray[np.int64],
    reach: Floats,
    frames: Floats,
    firings: NDArray[np.int64],
    origins: Floats,
    directions: Floats,
) -> tuple[Floats, NDArray[np.int64]]:
    """Return each ray's nearest distance, and the number of the shape met (boxes come first)."""
    ray = np.empty(6)
    distance, index = np.empty(len(origins)), np.empty(len(origins), np.int64)
    for number in range(len(origins)):
        dx, dy, dz = directions[number]
        level = max(dx * dx + dy * dy, _ALMOST_ZERO)
        nearest, met = np.inf, _NOTHING
        for mover in range(len(starts) - 1):
            x, y, z, heading, slope = frames[firings[number], mover]
            ox, oy = origins[number, 0] - x, origins[number, 1] - y
            if (ox * dy - oy * dx) ** 2 > reach[mover] ** 2 * level:
                continue
            cosine, sine = np.cos(heading), np.sin(heading)
            ray[0] = cosine * ox + sine * oy
            ray[1] = cosine * oy - sine * ox
            ray[2] = origins[number, 2] - z - slope * ray[0]
            ray[3] = cosine * dx + sine * dy
            ray[4] = cosine * dy - sine * dx
            ray[5] = dz - slope * ray[3]
            first, last = starts[mover, 0], starts[mover + 1, 0]
            distance_to_box, box = _nearest_box(boxes[first:last], ray)
            if distance_to_box < nearest:
                nearest, met = distance_to_box, first + box
            for cylinder in range(starts[mover, 1], starts[mover + 1, 1]):
                distance_to_cylinder = _to_cylinder(cylinders[cylinder], ray)
                if distance_to_cylinder < nearest:
                    nearest, met = distance_to_cylinder, len(boxes) + cylinder
        distance[number], index[number] = nearest, met
    return distance, index


@compiled
def _nearest_box(boxes: Floats, ray: Floats) -> tuple[float, int]:
    """Return where a ray (origin, direction) first enters a box, and which; infinity for none."""
    nearest, met = np.inf, _NOTHING
    inverse_x, inverse_y = _inverse(ray[3]), _inverse(ray[4])
    # A box on a slope is an upright one once each point is lowered by the slope under it.
    slope_x, slope_y = 0.0, 0.0
    height, inverse_z = ray[2], _inverse(ray[5])
    for number in range(len(boxes)):
        box = boxes[number]
        enter, leave = _between(ray[0], inverse_x, box[0], box[3])
        near, far = _between(ray[1], inverse_y, box[1], box[4])
        enter, leave = max(enter, near), min(leave, far)
        if enter > leave or leave < 0 or enter >= nearest:
            continue
        if box[6] != slope_x or box[7] != slope_y:
            slope_x, slope_y = box[6], box[7]
            height = ray[2] - slope_x * ray[0] - slope_y * ray[1]
            inverse_z = _inverse(ray[5] - slope_x * ray[3] - slope_y * ray[4])
        near, far = _between(height, inverse_z, box[2], box[5])
        enter, leave = max(enter, near), min(leave, far)
        if 0 < enter <= leave and enter < nearest:
            nearest, met = enter, number
    return nearest, met


@compiled
def _to_cylinder(cylinder: Floats, ray: Floats) -> float:
    """Return where a ray enters a cylinder, infinity where it does not.

    The mantle is met where ``|o + t d - c|^2 = r^2`` in the xy plane, a quadratic in t.
    """
    x, y = ray[0] - cylinder[0], ray[1] - cylinder[1]
    a = max(ray[3] ** 2 + ray[4] ** 2, _ALMOST_ZERO)
    half_b = x * ray[3] + y * ray[4]
    discriminant = half_b**2 - a * (x * x + y * y - cylinder[2] ** 2)
    if discriminant < 0:
        return np.inf
    root = np.sqrt(discriminant)
    near, far = _between(ray[2], _inverse(ray[5]), cylinder[3], cylinder[4])
    enter, leave = max(near, (-half_b - root) / a), min(far, (-half_b + root) / a)
    return enter if 0 < enter <= leave else np.inf


@compiled
def _between(origin: float, inverse: float, lower: float, upper: float) -> tuple[float, float]:
    """Return where a ray is between two planes across one axis."""
    first, second = (lower - origin) * inverse, (upper - origin) * inverse
    return (first, second) if first <= second else (second, first)


@compiled
def _inverse(direction: float) -> float:
    """Return 1 over a component of a direction, finite for 0 too."""
    return 1.0 / (direction if abs(direction) >= _ALMOST_ZERO else _ALMOST_ZERO)
