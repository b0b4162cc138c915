"""Triangle meshes: boxes, tubes, sheets and leaves, made many at a time.

All lengths are in metres. A shape is made about the origin, z up, and then put in its place.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.simulation.tables import Floats, Random

Rows: TypeAlias = ArrayLike | Sequence[Any]  # a table of numbers, in whatever lists it was written

_BOX_CORNERS = np.array(list(product((-0.5, 0.5), repeat=3)))
_BOX_TRIANGLES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
# A tube's ends are rounded: rings before and behind its ends, in radii, and how wide they are.
_TUBE_BEYOND = np.array([-0.65, 0.0, 0.0, 0.65])
_TUBE_WIDTH = np.array([0.72, 1.0, 1.0, 0.72])


@dataclass(frozen=True, slots=True)
class Mesh:
    """Triangles."""

    vertices: Floats  # (v, 3)
    triangles: NDArray[np.int64]  # (t, 3), numbers of vertices

    @classmethod
    def joined(cls, parts: Sequence["Mesh"]) -> "Mesh":
        """Put meshes one after the other."""
        if not parts:
            return cls(np.empty((0, 3)), np.empty((0, 3), dtype=np.int64))
        starts = np.cumsum([0] + [len(part.vertices) for part in parts[:-1]])
        triangles = [part.triangles + start for part, start in zip(parts, starts, strict=True)]
        return cls(np.concatenate([part.vertices for part in parts]), np.concatenate(triangles))

    def placed(self, x: float, y: float, z: float = 0.0, yaw: float = 0.0) -> "Mesh":
        """Turn about z, counter-clockwise, then shift."""
        cosine, sine = np.cos(yaw), np.sin(yaw)
        turn = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
        return Mesh(self.vertices @ turn + np.array([x, y, z]), self.triangles)


def corners(x: float, y: float) -> list[tuple[float, float]]:
    """Return the corners of a rectangle about the origin."""
    return list(product((-x, x), (-y, y)))


def boxes(rows: Rows) -> Mesh:
    """Make upright boxes from rows of the middle's x, y, z and the lengths along x, y and z."""
    table = np.asarray(rows, dtype=np.float64).reshape(-1, 6)
    vertices = table[:, None, :3] + _BOX_CORNERS * table[:, None, 3:]
    triangles = _BOX_TRIANGLES + 8 * np.arange(len(table))[:, None, None]
    return Mesh(vertices.reshape(-1, 3), triangles.reshape(-1, 3))


def tube_triangles(tubes: int, sides: int) -> NDArray[np.int64]:
    """Return the triangles of tubes whose vertices `tube_vertices` made."""
    side = np.arange(sides)
    after = (side + 1) % sides
    parts: list[Sequence[ArrayLike]] = []
    for low, high in ((0, sides), (sides, 2 * sides), (2 * sides, 3 * sides)):
        parts.append((low + side, low + after, high + after))
        parts.append((low + side, high + after, high + side))
    parts.append((after, side, 4 * sides))
    parts.append((3 * sides + side, 3 * sides + after, 4 * sides + 1))
    starts = (4 * sides + 2) * np.arange(tubes)
    return (_triangles(*parts) + starts[:, None, None]).reshape(-1, 3)


def _triangles(*parts: Sequence[ArrayLike]) -> NDArray[np.int64]:
    """Return triangles, (t, 3), whose first, second and third vertices are given."""
    return np.concatenate([np.stack(np.broadcast_arrays(*part), axis=1) for part in parts])


def tube_vertices(
    ends: Floats,
    radii: Floats,
    sides: int,
    across: Floats | None = None,
    depth: Floats | None = None,
) -> Floats:
    """Return the vertices of tapered tubes with rounded ends.

    Parameters
    ----------
    ends : (n, 2, 3) float64 array
        Where each tube begins and ends.
    radii : (n, 2) float64 array
        Its radius there.
    across : (n, 3) float64 array, optional
        The direction in which the radius holds; any, if not given.
    depth : (n,) float64 array, optional
        How wide a tube is at right angles to that, by the radius.

    Returns
    -------
    (n, 4 sides + 2, 3) float64 array
    """
    axis = ends[:, 1] - ends[:, 0]
    length = np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-6)
    axis = axis / length
    if across is None:
        across = np.where(np.abs(axis[:, :1]) < 0.9, [[1.0, 0.0, 0.0]], [[0.0, 1.0, 0.0]])
    aside = across - axis * np.sum(across * axis, axis=1, keepdims=True)
    aside /= np.maximum(np.linalg.norm(aside, axis=1, keepdims=True), 1e-9)
    ahead = np.cross(axis, aside)
    if depth is not None:
        ahead = ahead * depth[:, None]
    angle = 2 * np.pi * np.arange(sides) / sides
    rim = np.cos(angle)[:, None] * aside[:, None] + np.sin(angle)[:, None] * ahead[:, None]
    of_ring = radii[:, [0, 0, 1, 1]]
    middle = ends[:, [0, 0, 1, 1]] + (of_ring * _TUBE_BEYOND)[..., None] * axis[:, None]
    rings = middle[:, :, None] + (of_ring * _TUBE_WIDTH)[..., None, None] * rim[:, None]
    poles = ends + (radii * np.array([-1.0, 1.0]))[..., None] * axis[:, None]
    return np.concatenate([rings.reshape(len(ends), -1, 3), poles], axis=1)


def tubes(ends: Rows, radii: Rows, sides: int = 6) -> Mesh:
    """Make tapered tubes with rounded ends, all of one radius or each of two."""
    pairs = np.asarray(ends, dtype=np.float64).reshape(-1, 2, 3)
    widths = np.broadcast_to(np.asarray(radii, dtype=np.float64), (len(pairs), 2))
    vertices = tube_vertices(pairs, widths, sides)
    return Mesh(vertices.reshape(-1, 3), tube_triangles(len(pairs), sides))


def sheet(grid: Floats) -> Mesh:
    """Make a surface through a grid of (n, m, 3) points."""
    rows, columns = grid.shape[:2]
    number = np.arange(rows * columns).reshape(rows, columns)
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    c, d = number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    return Mesh(grid.reshape(-1, 3).astype(np.float64), _triangles((a, b, c), (a, c, d)))


def extruded(profile: ArrayLike, width: float) -> Mesh:
    """Make a body from its side view: (n, 2) corners x, z of a star-shaped outline about its mean.

    The body reaches from -width/2 to width/2 along y.
    """
    outline = np.asarray(profile, dtype=np.float64)
    count, hub = len(outline), outline.mean(axis=0)
    x, z = np.concatenate([outline, outline, [hub, hub]]).T
    y = np.repeat([-width / 2, width / 2, -width / 2, width / 2], [count, count, 1, 1])
    here = np.arange(count)
    after = (here + 1) % count
    triangles = _triangles(
        (here, after, after + count),
        (here, after + count, here + count),
        (here, after, 2 * count),
        (here + count, after + count, 2 * count + 1),
    )
    return Mesh(np.column_stack([x, y, z]), triangles)


def leaves(random: Random, count: int, reach: ArrayLike, size: float, hollow: float = 0.5) -> Mesh:
    """Make small triangles, of edges about `size` long, in an ellipsoid of half axes `reach`.

    With `hollow` 0 they fill it evenly; towards 1 they gather at its surface.
    """
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    out = random.random((count, 1)) ** (1 / 3) * (1 - hollow) + hollow
    middle = direction * out * np.asarray(reach, dtype=np.float64)
    corners = middle[:, None] + random.normal(scale=size * 0.6, size=(count, 3, 3))
    return Mesh(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
