"""The leaves around a place, and a copy of their points relative to it in single precision.

The 32 queries of a leaf lie close together, so they share one list of candidates: the leaves near
enough to hold a neighbour of any of them. How near is known from the query in the middle, solved
first: a query at distance `e` from a point whose k-th neighbour is at distance `r` has its own
within `r + e`.

Relative to the middle, and divided by the extent of the list, coordinates keep 24 bits wherever
the map is. A vector holds twice as many of them as of the original ones, and they lie side by side.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.decorators import compiled, inlined
from dynahull.kernels.lanes import LANES, aligned, padded
from dynahull.kernels.tree import (
    LEAF_SIZE,
    Place,
    Tree,
    Walk,
    add_halves,
    begin_walk,
    box_to_box,
    is_one_place,
    leaf_count,
    make_walk,
)

_SAFE = 1.0 + 1e-9  # covers the rounding of the triangle inequality
_TINY = 1e-290  # and the squares that underflow
_LARGEST_SCALE = 1e150  # squares that underflow stay far below single precision

_Singles = NDArray[np.float32]


class Candidates(NamedTuple):
    """The leaves around a place, and those of them that matter to one query.

    Attributes
    ----------
    leaf, node : (capacity,) int64 arrays
        Numbers of the leaves, and of the nodes that have their boxes.
    boxes : six (capacity,) float32 arrays
        Lowest x, y, z and highest x, y, z of each, relative and scaled.
    points : three (capacity * LEAF_SIZE,) float32 arrays
        x, y and z of their points, relative and scaled.
    near : (capacity,) uint32 array
        Which of the leaves are near the query.
    distance : (capacity * LEAF_SIZE,) float32 array
        Squared distances of the points of these from the query.
    walk : Walk
    """

    leaf: NDArray[np.int64]
    node: NDArray[np.int64]
    boxes: tuple[_Singles, _Singles, _Singles, _Singles, _Singles, _Singles]
    points: tuple[_Singles, _Singles, _Singles]
    near: NDArray[np.uint32]
    distance: NDArray[np.float32]
    walk: Walk


def make_candidates(k: int) -> Candidates:
    """Make room for the candidates of one leaf; where it is too little, each query walks alone."""
    size = padded(max(512, k))
    low_x, low_y, low_z, high_x, high_y, high_z = (aligned(size, np.float32) for _ in range(6))
    x, y, z, distance = (aligned(size * LEAF_SIZE, np.float32) for _ in range(4))
    return Candidates(
        leaf=np.empty(size, np.int64),
        node=np.empty(size, np.int64),
        boxes=(low_x, low_y, low_z, high_x, high_y, high_z),
        points=(x, y, z),
        near=np.empty(size + LANES, np.uint32),
        distance=distance,
        walk=make_walk(),
    )


@inlined
def bound_from(squared_reach: float, squared_distance: float) -> float:
    """Bound the squared distance of the k-th neighbour of a point from that of another point.

    Parameters
    ----------
    squared_reach : float
        Squared distance of the other point's k-th neighbour.
    squared_distance : float
        Squared distance of the two points.
    """
    reach = np.sqrt(squared_reach) + np.sqrt(squared_distance)
    return reach * reach * _SAFE + _TINY


@compiled
def gather_candidates(
    tree: Tree, low: Place, high: Place, k: int, squared_bound: float, candidates: Candidates
) -> int:
    """List the leaves within a distance of a box.

    Returns
    -------
    int
        How many there are; -1 where they do not fit.
    """
    count = 0
    walk = candidates.walk
    depth = begin_walk(walk, tree)
    while depth > 0:
        depth -= 1
        node, first, leaves = walk.nodes[depth, 0], walk.nodes[depth, 1], walk.nodes[depth, 2]
        if box_to_box(tree.boxes, node, low, high) > squared_bound:
            continue
        one_place = leaves > 1 and is_one_place(tree.boxes, node)
        if leaves > 1 and not one_place:
            depth = add_halves(walk, depth, node, first, leaves)
            continue
        # All in one place are in the order of their rows: the first k are the nearest.
        wanted = min(leaves, leaf_count(k)) if one_place else 1
        if count + wanted > candidates.leaf.size:
            return -1
        for number in range(first, first + wanted):
            candidates.leaf[np.uint64(count)] = number
            candidates.node[np.uint64(count)] = node
            count += 1
    return count


@compiled
def copy_candidates(tree: Tree, middle: Place, count: int, candidates: Candidates) -> float:
    """Copy the points and boxes of the listed leaves relative to a place; return their scale.

    All coordinates come to lie in [-1, 1].
    """
    x, y, z = middle
    boxes = tree.boxes
    low_x, low_y, low_z, high_x, high_y, high_z = candidates.boxes
    points_x, points_y, points_z = candidates.points
    extent = 0.0
    for i in range(np.uint64(count)):
        node = np.uint64(candidates.node[i])
        extent = max(extent, x - boxes[node, 0], y - boxes[node, 1], z - boxes[node, 2])
        extent = max(extent, boxes[node, 3] - x, boxes[node, 4] - y, boxes[node, 5] - z)
    scale = min(1.0 / extent, _LARGEST_SCALE)
    for i in range(np.uint64(count)):
        node = np.uint64(candidates.node[i])
        low_x[i] = np.float32((boxes[node, 0] - x) * scale)
        low_y[i] = np.float32((boxes[node, 1] - y) * scale)
        low_z[i] = np.float32((boxes[node, 2] - z) * scale)
        high_x[i] = np.float32((boxes[node, 3] - x) * scale)
        high_y[i] = np.float32((boxes[node, 4] - y) * scale)
        high_z[i] = np.float32((boxes[node, 5] - z) * scale)
        first = np.uint64(candidates.leaf[i]) * np.uint64(LEAF_SIZE)
        out = i * np.uint64(LEAF_SIZE)
        for j in range(np.uint64(LEAF_SIZE)):
            points_x[out + j] = np.float32((tree.x[first + j] - x) * scale)
            points_y[out + j] = np.float32((tree.y[first + j] - y) * scale)
            points_z[out + j] = np.float32((tree.z[first + j] - z) * scale)
    return scale
