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

from dynahull.kernels.compiled import compiled, inlined
from dynahull.kernels.lanes import aligned

LEAF_SIZE = 32
"""Points in a leaf: four vectors of eight doubles."""


def make_stack() -> NDArray[np.int64]:
    """Make room to walk a tree: (node, first leaf, leaves) for each level and one more."""
    return np.empty((64, 3), np.int64)


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


def make_tree(points: NDArray[np.float64], rows: NDArray[np.int64]) -> Tree:
    """Copy points and row numbers, to be put into order by `grow_tree`."""
    count = len(points)
    leaves = -(-count // LEAF_SIZE)
    columns = [aligned(leaves * LEAF_SIZE) for _ in range(3)]
    for axis, column in enumerate(columns):
        column[:count] = points[:, axis]
        column[count:] = np.inf
    order = np.arange(count, dtype=np.uint32)
    boxes = np.empty((2 * leaves - 1, 6))
    return Tree(columns[0], columns[1], columns[2], rows.astype(np.int64), order, boxes)


@inlined
def leaf_count(point_count: int) -> int:
    """Return the number of leaves of a tree over so many points."""
    return (point_count + LEAF_SIZE - 1) // LEAF_SIZE


@compiled
def grow_tree(tree: Tree, stack: NDArray[np.int64]) -> None:
    """Put the points of `tree` into kd-tree order, in place, and fill in the boxes.

    Each node is split where its box is longest. A node whose points all share one place is put in
    the order of the row numbers instead, so that the nearest of them, by the tie rule, are its
    first ones. `stack` is a `make_stack`.
    """
    point_count = tree.rows.size
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, leaf_count(point_count)
    depth = 1
    random = np.uint64(0x9E3779B97F4A7C15)
    while depth > 0:
        depth -= 1
        node, first, leaves = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        begin = first * LEAF_SIZE
        end = min((first + leaves) * LEAF_SIZE, point_count)
        axis, extent = _measure(tree, node, begin, end)
        if extent == 0.0:
            _sort_by_row(tree, begin, end)
        if leaves == 1:
            continue
        left = (leaves + 1) // 2
        if extent > 0.0:
            random = _split(tree, axis, begin, end, begin + left * LEAF_SIZE, random)
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = (
            node + 2 * left,
            first + left,
            leaves - left,
        )
        depth += 1
        stack[depth, 0], stack[depth, 1], stack[depth, 2] = node + 1, first, left
        depth += 1


@compiled
def _measure(tree: Tree, node: int, begin: int, end: int) -> tuple[int, float]:
    """Fill in the box of a node; return its longest axis and the extent there."""
    longest, extent = 0, -1.0
    for axis in range(3):
        values = tree.x if axis == 0 else (tree.y if axis == 1 else tree.z)
        low = high = values[begin]
        for i in range(begin + 1, end):
            value = values[i]
            low = value if value < low else low
            high = value if value > high else high
        tree.boxes[node, axis] = low
        tree.boxes[node, 3 + axis] = high
        if high - low > extent:
            longest, extent = axis, high - low
    return longest, extent


@compiled
def _split(
    tree: Tree, axis: int, begin: int, end: int, middle: int, random: np.uint64
) -> np.uint64:
    """Reorder a range so that no point before `middle` lies beyond one from there on.

    Hoare's selection with random pivots: both scans stop at values equal to the pivot, so that
    equal values share themselves out and never make it quadratic. Returns the generator's state.
    """
    values = tree.x if axis == 0 else (tree.y if axis == 1 else tree.z)
    low, high = begin, end - 1
    while low < high:
        random ^= random << np.uint64(13)
        random ^= random >> np.uint64(7)
        random ^= random << np.uint64(17)
        pivot = _median(
            values[low + np.int64((random >> np.uint64(33)) % np.uint64(high - low + 1))],
            values[(low + high) // 2],
            values[low + np.int64((random & np.uint64(0x7FFFFFFF)) % np.uint64(high - low + 1))],
        )
        i, j = low, high
        while i <= j:
            while values[i] < pivot:
                i += 1
            while pivot < values[j]:
                j -= 1
            if i <= j:
                _swap(tree, i, j)
                i += 1
                j -= 1
        if middle <= j:
            high = j
        elif middle >= i:
            low = i
        else:
            break
    return random


@inlined
def _median(a: float, b: float, c: float) -> float:
    return max(min(a, b), min(max(a, b), c))


@inlined
def _swap(tree: Tree, i: int, j: int) -> None:
    tree.x[i], tree.x[j] = tree.x[j], tree.x[i]
    tree.y[i], tree.y[j] = tree.y[j], tree.y[i]
    tree.z[i], tree.z[j] = tree.z[j], tree.z[i]
    tree.rows[i], tree.rows[j] = tree.rows[j], tree.rows[i]
    tree.order[i], tree.order[j] = tree.order[j], tree.order[i]


@compiled
def _sort_by_row(tree: Tree, begin: int, end: int) -> None:
    """Put points that share one place in the order of their row numbers (heap sort)."""
    size = end - begin
    for start in range(size // 2 - 1, -1, -1):
        _sift_down(tree, begin, start, size)
    for last in range(size - 1, 0, -1):
        _swap_rows(tree, begin, begin + last)
        _sift_down(tree, begin, 0, last)


@compiled
def _sift_down(tree: Tree, begin: int, start: int, size: int) -> None:
    parent = start
    while 2 * parent + 1 < size:
        child = 2 * parent + 1
        if child + 1 < size and tree.rows[begin + child + 1] > tree.rows[begin + child]:
            child += 1
        if tree.rows[begin + child] <= tree.rows[begin + parent]:
            return
        _swap_rows(tree, begin + child, begin + parent)
        parent = child


@inlined
def _swap_rows(tree: Tree, i: int, j: int) -> None:
    tree.rows[i], tree.rows[j] = tree.rows[j], tree.rows[i]
    tree.order[i], tree.order[j] = tree.order[j], tree.order[i]


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
def box_to_box(boxes: NDArray[np.float64], node: int, other: int) -> float:
    """Return the squared distance of the boxes of two nodes."""
    i, j = np.uint64(node), np.uint64(other)
    dx = max(boxes[i, 0] - boxes[j, 3], boxes[j, 0] - boxes[i, 3], 0.0)
    dy = max(boxes[i, 1] - boxes[j, 4], boxes[j, 1] - boxes[i, 4], 0.0)
    dz = max(boxes[i, 2] - boxes[j, 5], boxes[j, 2] - boxes[i, 5], 0.0)
    return (dx * dx + dy * dy) + dz * dz


@inlined
def is_one_place(boxes: NDArray[np.float64], node: int) -> bool:
    """Tell whether all points of a node share one place."""
    return (
        boxes[node, 0] == boxes[node, 3]
        and boxes[node, 1] == boxes[node, 4]
        and boxes[node, 2] == boxes[node, 5]
    )


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
