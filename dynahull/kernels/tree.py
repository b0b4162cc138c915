"""Points in kd-tree order: leaves of exactly 32 consecutive points, and the box of every node.

The tree is never stored: a node is a range of leaves. The left half of a node of `m` leaves holds
the first `(m + 1) // 2` of them, and nodes are numbered in preorder, so the left child of node `i`
is `i + 1` and the right child `i + 2 * ((m + 1) // 2)`. Only the last leaf may hold fewer points.

A squared distance is `(dx dx + dy dy) + dz dz` in float64 from the original coordinates, never
contracted into fused operations, so it has the same bits on every machine. Distances of boxes are
computed by the same operations from coordinates that are no further apart, and rounding is
monotonic: a box further than some distance holds no point within it, to the last bit.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.decorators import compiled, inlined
from dynahull.kernels.lanes import aligned

Place = tuple[float, float, float]

LEAF_SIZE = 32
"""Points in a leaf: four vectors of eight doubles."""


class Walk(NamedTuple):
    """Room to walk a tree: the nodes still to be looked at, the next one last.

    Attributes
    ----------
    nodes : (64, 3) int64 array
        Node, first leaf, number of leaves; a row for each level and one more.
    gap : (64,) float64 array
        Their squared distances from a place.
    """

    nodes: NDArray[np.int64]
    gap: NDArray[np.float64]


def make_walk() -> Walk:
    """Make room to walk a tree."""
    return Walk(np.empty((64, 3), np.int64), np.empty(64))


class Tree(NamedTuple):
    """Points in kd-tree order.

    Attributes
    ----------
    x, y, z : (leaves * LEAF_SIZE,) float64 arrays
        The original coordinates, reordered; infinite where the last leaf has no point.
    rows : (n,) int64 array
        Row numbers, reordered.
    order : (n,) uint32 array
        Position in the input of each reordered point.
    boxes : (nodes, 6) float64 array
        Lowest x, y, z and highest x, y, z of the points of each node, in preorder.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    rows: NDArray[np.int64]
    order: NDArray[np.uint32]
    boxes: NDArray[np.float64]


def make_tree(points: NDArray[np.float64]) -> Tree:
    """Copy points, to be put into order by `dynahull.kernels.build.build_tree`."""
    count = len(points)
    leaves = -(-count // LEAF_SIZE)
    columns = [aligned(leaves * LEAF_SIZE) for _ in range(3)]
    for axis, column in enumerate(columns):
        column[:count] = points[:, axis]
        column[count:] = np.inf
    order = np.arange(count, dtype=np.uint32)
    boxes = np.empty((2 * leaves - 1, 6))
    return Tree(columns[0], columns[1], columns[2], np.empty(count, np.int64), order, boxes)


@inlined
def leaf_count(point_count: int) -> int:
    """Return the number of leaves of a tree over so many points."""
    return (point_count + LEAF_SIZE - 1) // LEAF_SIZE


@inlined
def point_distance(tree: Tree, i: int, x: float, y: float, z: float) -> float:
    """Return the squared distance of the point at a position from a place."""
    dx = tree.x[i] - x
    dy = tree.y[i] - y
    dz = tree.z[i] - z
    return (dx * dx + dy * dy) + dz * dz


@inlined
def box_to_point(boxes: NDArray[np.float64], node: int, x: float, y: float, z: float) -> float:
    """Return the squared distance of a node's box from a place."""
    i = np.uint64(node)
    dx = max(boxes[i, 0] - x, x - boxes[i, 3], 0.0)
    dy = max(boxes[i, 1] - y, y - boxes[i, 4], 0.0)
    dz = max(boxes[i, 2] - z, z - boxes[i, 5], 0.0)
    return (dx * dx + dy * dy) + dz * dz


@inlined
def box_to_box(
    boxes: NDArray[np.float64],
    node: int,
    low: Place,
    high: Place,
) -> float:
    """Return the squared distance of a node's box from another."""
    i = np.uint64(node)
    dx = max(boxes[i, 0] - high[0], low[0] - boxes[i, 3], 0.0)
    dy = max(boxes[i, 1] - high[1], low[1] - boxes[i, 4], 0.0)
    dz = max(boxes[i, 2] - high[2], low[2] - boxes[i, 5], 0.0)
    return (dx * dx + dy * dy) + dz * dz


@inlined
def is_one_place(boxes: NDArray[np.float64], node: int) -> bool:
    """Tell whether all points of a node share one place."""
    return (
        boxes[node, 0] == boxes[node, 3]
        and boxes[node, 1] == boxes[node, 4]
        and boxes[node, 2] == boxes[node, 5]
    )


@inlined
def begin_walk(walk: Walk, tree: Tree) -> int:
    """Begin a walk with the root; return how many nodes are to be looked at."""
    walk.nodes[0, 0], walk.nodes[0, 1], walk.nodes[0, 2] = 0, 0, leaf_count(tree.rows.size)
    walk.gap[0] = 0.0
    return 1


@inlined
def add_halves(walk: Walk, count: int, node: int, first: int, leaves: int) -> int:
    """Add both halves of a node to those to be looked at, the left one next; return how many."""
    nodes, left = walk.nodes, (leaves + 1) // 2
    nodes[count, 0], nodes[count, 1], nodes[count, 2] = node + 2 * left, first + left, leaves - left
    nodes[count + 1, 0], nodes[count + 1, 1], nodes[count + 1, 2] = node + 1, first, left
    return count + 2


@inlined
def add_nearer_half_last(
    walk: Walk, count: int, tree: Tree, node: int, first: int, leaves: int, place: Place
) -> int:
    """Add both halves of a node, the one nearer to a place next; return how many there are."""
    nodes, gap, left = walk.nodes, walk.gap, (leaves + 1) // 2
    x, y, z = place
    left_gap = box_to_point(tree.boxes, node + 1, x, y, z)
    right_gap = box_to_point(tree.boxes, node + 2 * left, x, y, z)
    right_last = 1 if left_gap > right_gap else 0
    right_at, left_at = count + right_last, count + 1 - right_last
    nodes[right_at, 0], nodes[right_at, 1] = node + 2 * left, first + left
    nodes[right_at, 2], gap[right_at] = leaves - left, right_gap
    nodes[left_at, 0], nodes[left_at, 1] = node + 1, first
    nodes[left_at, 2], gap[left_at] = left, left_gap
    return count + 2


@compiled
def leaf_node(tree: Tree, leaf: int) -> int:
    """Return the number of a leaf's node."""
    node, first, leaves = 0, 0, leaf_count(tree.rows.size)
    while leaves > 1:
        left = (leaves + 1) // 2
        if leaf < first + left:
            node, leaves = node + 1, left
        else:
            node, first, leaves = node + 2 * left, first + left, leaves - left
    return node


@compiled
def middle_of_leaf(tree: Tree, leaf: int) -> int:
    """Return the position of the point of a leaf that is nearest to the middle of its box."""
    boxes, node = tree.boxes, leaf_node(tree, leaf)
    x = 0.5 * boxes[node, 0] + 0.5 * boxes[node, 3]
    y = 0.5 * boxes[node, 1] + 0.5 * boxes[node, 4]
    z = 0.5 * boxes[node, 2] + 0.5 * boxes[node, 5]
    best, least = leaf * LEAF_SIZE, np.inf
    for i in range(leaf * LEAF_SIZE, min((leaf + 1) * LEAF_SIZE, tree.rows.size)):
        distance = point_distance(tree, i, x, y, z)
        if distance < least:
            best, least = i, distance
    return best
