"""Putting points into kd-tree order.

At every node the points are split at a multiple of the leaf size next to their median, by selection
with partitions. No branch depends on a single comparison, since half of these branches would be
mispredicted.
"""

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.decorators import compiled, inlined
from dynahull.kernels.tree import LEAF_SIZE, Tree, Walk, add_halves, begin_walk
from dynahull.kernels.vectors import extremes, lowest_place, places_from, places_up_to


def build(tree: Tree, rows: NDArray[np.int64], walk: Walk) -> None:
    """Put the points of `tree` into kd-tree order, in place, and fill in row numbers and boxes.

    Each node is split where its box is longest. A node whose points all share one place is put in
    the order of the row numbers instead, so that the nearest of them, by the tie rule, are its
    first ones. `rows` are the row numbers in the order of the input.
    """
    point_count = tree.rows.size
    depth = begin_walk(walk, tree)
    random = np.uint64(0x9E3779B97F4A7C15)
    while depth > 0:
        depth -= 1
        node, first, leaves = walk.nodes[depth, 0], walk.nodes[depth, 1], walk.nodes[depth, 2]
        begin = first * LEAF_SIZE
        end = min((first + leaves) * LEAF_SIZE, point_count)
        axis, extent = _measure(tree, node, begin, end)
        if extent == 0.0:
            _sort_by_row(tree, rows, begin, end)
        if leaves == 1:
            continue
        if extent > 0.0:
            middle = begin + (leaves + 1) // 2 * LEAF_SIZE
            random = _split(tree, axis, begin, end, middle, random)
        depth = add_halves(walk, depth, node, first, leaves)
    for i in range(np.uint64(point_count)):
        tree.rows[i] = rows[np.uint64(tree.order[i])]


@compiled
def _measure(tree: Tree, node: int, begin: int, end: int) -> tuple[int, float]:
    """Fill in the box of a node; return its longest axis and the extent there."""
    longest, extent = 0, -1.0
    for axis in range(3):
        values = tree.x if axis == 0 else (tree.y if axis == 1 else tree.z)
        low, high = extremes(values, np.uint64(begin), np.uint64(end))
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

    Selection by partitioning at random values. Returns the state of their generator.
    """
    values = tree.x if axis == 0 else (tree.y if axis == 1 else tree.z)
    low, high = begin, end
    while high - low > 1:
        random ^= random << np.uint64(13)
        random ^= random >> np.uint64(7)
        random ^= random << np.uint64(17)
        pivot = values[low + np.int64((random >> np.uint64(33)) % np.uint64(high - low))]
        lower_end, upper_begin = _partition(tree, values, low, high, pivot)
        if middle < lower_end:
            high = lower_end
        elif middle > upper_begin:
            low = upper_begin
        else:
            break
    return random


@compiled
def _partition(
    tree: Tree, values: NDArray[np.float64], low: int, high: int, pivot: float
) -> tuple[int, int]:
    """Bring values up to a pivot, one of them, before those from it on (Hoare's partition).

    Values equal to the pivot share themselves out over both sides, so that they never make
    selection quadratic. Those on the wrong side are found 32 at a time, by vector comparisons: a
    branch on each would be mispredicted half the time.

    Returns
    -------
    lower_end, upper_begin : int
        Where the first side ends and the second begins; between them lie values equal to the pivot.
    """
    i, j = low, high
    block = 32
    on_left = on_right = np.uint64(0)
    while j - i >= 2 * block:
        if not on_left:
            on_left = places_from(values, np.uint64(i), pivot)
        if not on_right:
            on_right = places_up_to(values, np.uint64(j - block), pivot)
        while on_left and on_right:
            left = np.uint64(i) + lowest_place(on_left)
            right = np.uint64(j - block) + lowest_place(on_right)
            _swap(tree, left, right)
            on_left &= on_left - np.uint64(1)
            on_right &= on_right - np.uint64(1)
        if not on_left:
            i += block
        if not on_right:
            j -= block
    j -= 1
    while i <= j:
        while i <= j and values[i] < pivot:
            i += 1
        while i <= j and pivot < values[j]:
            j -= 1
        if i <= j:
            _swap(tree, i, j)
            i += 1
            j -= 1
    return j + 1, i


@inlined
def _swap(tree: Tree, i: int, j: int) -> None:
    tree.x[i], tree.x[j] = tree.x[j], tree.x[i]
    tree.y[i], tree.y[j] = tree.y[j], tree.y[i]
    tree.z[i], tree.z[j] = tree.z[j], tree.z[i]
    tree.order[i], tree.order[j] = tree.order[j], tree.order[i]


@compiled
def _sort_by_row(tree: Tree, rows: NDArray[np.int64], begin: int, end: int) -> None:
    """Put points that share one place in the order of their row numbers (heap sort)."""
    order, size = tree.order, end - begin
    for start in range(size // 2 - 1, -1, -1):
        _sift_down(order, rows, begin, start, size)
    for last in range(size - 1, 0, -1):
        order[begin], order[begin + last] = order[begin + last], order[begin]
        _sift_down(order, rows, begin, 0, last)


@compiled
def _sift_down(
    order: NDArray[np.uint32], rows: NDArray[np.int64], begin: int, start: int, size: int
) -> None:
    parent = start
    while 2 * parent + 1 < size:
        child = 2 * parent + 1
        if child + 1 < size and rows[order[begin + child + 1]] > rows[order[begin + child]]:
            child += 1
        if rows[order[begin + child]] <= rows[order[begin + parent]]:
            return
        order[begin + child], order[begin + parent] = order[begin + parent], order[begin + child]
        parent = child
