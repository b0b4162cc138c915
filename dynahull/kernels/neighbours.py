"""The k nearest points of every query of a leaf, exactly, in the order of (distance, row number).

The 32 queries of a leaf lie close together, so they share one list of candidates: the points of
all leaves near enough to hold a neighbour of any of them. How near is known from the query in the
middle, solved first: a query at distance `e` from a point whose k-th neighbour is at distance `r`
has its own within `r + e`. In such a list the k-th distance is found by counting, which is one
pass of vector comparisons, and only the points within it are looked at one by one.

A squared distance is `(dx dx + dy dy) + dz dz` in float64 from the original coordinates, never
contracted into fused operations, so it has the same bits on every machine. Distances of boxes are
computed by the same operations from coordinates that are no further apart, and rounding is
monotonic: a box further than some distance holds no point within it, to the last bit.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.compiled import compiled, inlined
from dynahull.kernels.tree import LEAF_SIZE, Tree, leaf_count, make_stack
from dynahull.kernels.vectors import (
    aligned,
    box_distances,
    count_up_to,
    lowest_place,
    padded,
    places_up_to,
    rank_all,
)

SLACK = 8
"""Points beyond the k-th that counting may leave in: sorting them is cheaper than counting on."""

_PROBES = 10
_HOPE = 1.25  # in squared distance
_SAFE = 1.0 + 1e-9  # covers the rounding of the triangle inequality
_TINY = 1e-290  # and the squares that underflow


class Candidates(NamedTuple):
    """The leaves around a leaf, and those of them that matter to one query.

    Attributes
    ----------
    leaf : (capacity,) int64 array
        Numbers of the leaves.
    low_x, low_y, low_z, high_x, high_y, high_z : (capacity,) float64 arrays
        Their boxes.
    gap : (capacity,) float64 array
        Squared distances of the boxes from the query.
    near : (capacity,) int64 array
        Numbers of the leaves near the query.
    distance : (capacity * LEAF_SIZE,) float64 array
        Squared distances of the points of these from the query.
    stack, stack_gap
        Room to walk the tree.
    """

    leaf: NDArray[np.int64]
    low_x: NDArray[np.float64]
    low_y: NDArray[np.float64]
    low_z: NDArray[np.float64]
    high_x: NDArray[np.float64]
    high_y: NDArray[np.float64]
    high_z: NDArray[np.float64]
    gap: NDArray[np.float64]
    near: NDArray[np.int64]
    distance: NDArray[np.float64]
    stack: NDArray[np.int64]
    stack_gap: NDArray[np.float64]


class Nearest(NamedTuple):
    """The nearest points of one query; while being found, a heap with the farthest on top.

    Attributes
    ----------
    distance : (capacity,) float64 array
        Squared distances.
    at : (capacity,) uint32 array
        Positions in the tree.
    key, key_bits, rank, other_distance, other_at
        Room to sort them.
    """

    distance: NDArray[np.float64]
    at: NDArray[np.uint32]
    key: NDArray[np.float32]
    key_bits: NDArray[np.uint32]
    rank: NDArray[np.uint32]
    other_distance: NDArray[np.float64]
    other_at: NDArray[np.uint32]


def make_candidates(k: int) -> Candidates:
    """Make room for the candidates of one leaf; where it is too little, each query walks alone."""
    size = padded(max(512, k))
    return Candidates(
        leaf=np.empty(size, np.int64),
        low_x=aligned(size),
        low_y=aligned(size),
        low_z=aligned(size),
        high_x=aligned(size),
        high_y=aligned(size),
        high_z=aligned(size),
        gap=aligned(size),
        near=np.empty(size, np.int64),
        distance=aligned(size * LEAF_SIZE),
        stack=make_stack(),
        stack_gap=np.empty(64),
    )


def make_nearest(k: int) -> Nearest:
    """Make room for the neighbours of one query."""
    size = padded(2 * k + SLACK + LEAF_SIZE)
    key = aligned(size, np.float32)
    return Nearest(
        np.empty(size),
        np.empty(size, np.uint32),
        key,
        key.view(np.uint32),
        aligned(size, np.uint32),
        np.empty(size),
        np.empty(size, np.uint32),
    )


@compiled
def gather_candidates(
    tree: Tree, leaf: int, k: int, squared_bound: float, candidates: Candidates
) -> int:
    """List the leaves within a distance of the box of `leaf`.

    Returns
    -------
    int
        How many there are; -1 where they do not fit.
    """
    leaf_node = _leaf_node(tree, leaf)
    count = 0
    stack = candidates.stack
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, leaf_count(tree.rows.size)
    depth = 1
    while depth > 0:
        depth -= 1
        node, first, leaves = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        if _box_to_box(tree.boxes, node, leaf_node) > squared_bound:
            continue
        one_place = leaves > 1 and _is_one_place(tree.boxes, node)
        if leaves > 1 and not one_place:
            left = (leaves + 1) // 2
            stack[depth, 0], stack[depth, 1], stack[depth, 2] = (
                node + 2 * left,
                first + left,
                leaves - left,
            )
            depth += 1
            stack[depth, 0], stack[depth, 1], stack[depth, 2] = node + 1, first, left
            depth += 1
            continue
        # All in one place are in the order of their rows: the first k are the nearest.
        wanted = min(leaves, leaf_count(k)) if one_place else 1
        if count + wanted > candidates.leaf.size:
            return -1
        for number in range(first, first + wanted):
            slot = np.uint64(count)
            candidates.leaf[slot] = number
            candidates.low_x[slot] = tree.boxes[node, 0]
            candidates.low_y[slot] = tree.boxes[node, 1]
            candidates.low_z[slot] = tree.boxes[node, 2]
            candidates.high_x[slot] = tree.boxes[node, 3]
            candidates.high_y[slot] = tree.boxes[node, 4]
            candidates.high_z[slot] = tree.boxes[node, 5]
            count += 1
    return count


@compiled
def search_list(
    tree: Tree,
    x: float,
    y: float,
    z: float,
    k: int,
    guess: float,
    squared_bound: float,
    candidates: Candidates,
    count: int,
    nearest: Nearest,
) -> int:
    """Find the k nearest candidates of a query.

    Parameters
    ----------
    x, y, z : float
        The query.
    guess : float
        Squared distance at which to begin counting.
    squared_bound : float
        Squared distance within which k candidates are sure to lie.
    count : int
        Number of candidate leaves.

    Returns
    -------
    int
        Points left in `nearest`: the k nearest and perhaps a few more, unsorted.
    """
    distance = candidates.distance
    # Most often the neighbours lie about as far as those of the query before. If there are k
    # within that, all points within that have been seen.
    high = min(_HOPE * guess, squared_bound)
    leaves = _measure_leaves(tree, x, y, z, high, candidates, count)
    size = leaves * np.uint64(LEAF_SIZE)
    high_count = count_up_to(distance, size, high)
    if high_count < k:
        high = squared_bound
        leaves = _measure_leaves(tree, x, y, z, high, candidates, count)
        size = leaves * np.uint64(LEAF_SIZE)
        high_count = count_up_to(distance, size, high)
    threshold, within = _count_to_threshold(distance, size, k, high, high_count)
    if within > k + SLACK + k // 2:
        return _keep_nearest(tree, k, threshold, candidates, leaves, nearest)
    filled = np.uint64(0)
    for i in range(leaves):
        out = i * np.uint64(LEAF_SIZE)
        first = np.uint64(candidates.near[i]) * np.uint64(LEAF_SIZE)
        places = places_up_to(distance, out, threshold)
        while places:
            j = lowest_place(places)
            places &= places - np.uint64(1)
            nearest.distance[filled] = distance[out + j]
            nearest.at[filled] = first + j
            filled += np.uint64(1)
    return within


@inlined
def _measure_leaves(
    tree: Tree,
    x: float,
    y: float,
    z: float,
    squared_bound: float,
    candidates: Candidates,
    count: int,
) -> np.uint64:
    """Measure the points of the leaves within a distance of a query; return how many leaves."""
    boxes = (
        candidates.low_x,
        candidates.low_y,
        candidates.low_z,
        candidates.high_x,
        candidates.high_y,
        candidates.high_z,
    )
    box_distances(boxes, np.uint64(count), (x, y, z), candidates.gap)
    selected = np.uint64(0)
    for i in range(np.uint64(count)):
        candidates.near[selected] = candidates.leaf[i]
        selected += np.uint64(candidates.gap[i] <= squared_bound)
    for i in range(selected):
        out = i * np.uint64(LEAF_SIZE)
        first = np.uint64(candidates.near[i]) * np.uint64(LEAF_SIZE)
        for j in range(np.uint64(LEAF_SIZE)):
            dx = tree.x[first + j] - x
            dy = tree.y[first + j] - y
            dz = tree.z[first + j] - z
            candidates.distance[out + j] = (dx * dx + dy * dy) + dz * dz
    return selected


@compiled
def _keep_nearest(
    tree: Tree,
    k: int,
    threshold: float,
    candidates: Candidates,
    leaves: np.uint64,
    nearest: Nearest,
) -> int:
    """Keep exactly the k nearest where many more share the k-th distance; return k."""
    kept = 0
    for i in range(leaves):
        for j in range(np.uint64(LEAF_SIZE)):
            distance = candidates.distance[i * np.uint64(LEAF_SIZE) + j]
            at = np.uint64(candidates.near[i]) * np.uint64(LEAF_SIZE) + j
            if distance > threshold:
                continue
            if kept < k:
                nearest.distance[kept], nearest.at[kept] = distance, at
                kept += 1
                if kept == k:
                    _heapify(nearest, k, tree.rows)
            elif distance <= nearest.distance[0]:
                _offer(nearest, k, distance, at, tree.rows)
    return k


@inlined
def _count_to_threshold(
    distance: NDArray[np.float64], size: np.uint64, k: int, high: float, high_count: int
) -> tuple[float, int]:
    """Find a squared distance within which lie k candidates, and few more where ties allow.

    There are `high_count` of them, at least k, within `high`.
    """
    low, low_count = 0.0, 0
    for _ in range(_PROBES):
        if high_count <= k + SLACK:
            break
        # Neighbours on a surface grow in number as the squared distance does.
        share = (k + 0.5 * SLACK - low_count) / (high_count - low_count)
        probe = low + share * (high - low)
        if not low < probe < high:
            break
        within = count_up_to(distance, size, probe)
        if within >= k:
            high, high_count = probe, within
        else:
            low, low_count = probe, within
    return high, high_count


@compiled
def search_tree(
    tree: Tree,
    x: float,
    y: float,
    z: float,
    k: int,
    start: int,
    candidates: Candidates,
    nearest: Nearest,
) -> int:
    """Find the k nearest points of a query by walking the tree, nearer boxes first.

    Begins with the points from position `start` on, which should be near. Returns k.
    """
    begin = max(0, min(start, tree.rows.size - k))
    for i in range(k):
        nearest.distance[i] = point_distance(tree, begin + i, x, y, z)
        nearest.at[i] = begin + i
    _heapify(nearest, k, tree.rows)
    stack, gap = candidates.stack, candidates.stack_gap
    stack[0, 0], stack[0, 1], stack[0, 2], gap[0] = 0, 0, leaf_count(tree.rows.size), 0.0
    depth = 1
    while depth > 0:
        depth -= 1
        node, first, leaves = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        if gap[depth] > nearest.distance[0]:
            continue
        if leaves > 1 and not _is_one_place(tree.boxes, node):
            left = (leaves + 1) // 2
            near_gap = _box_to_point(tree.boxes, node + 1, x, y, z)
            far_gap = _box_to_point(tree.boxes, node + 2 * left, x, y, z)
            far_first = 0 if near_gap > far_gap else 1
            right_at, left_at = depth + 1 - far_first, depth + far_first
            stack[right_at, 0], stack[right_at, 1] = node + 2 * left, first + left
            stack[right_at, 2], gap[right_at] = leaves - left, far_gap
            stack[left_at, 0], stack[left_at, 1] = node + 1, first
            stack[left_at, 2], gap[left_at] = left, near_gap
            depth += 2
            continue
        first_point = first * LEAF_SIZE
        end = min((first + leaves) * LEAF_SIZE, tree.rows.size)
        if leaves > 1:
            end = min(end, first_point + k)
        for i in range(first_point, end):
            distance = point_distance(tree, i, x, y, z)
            if distance <= nearest.distance[0] and not begin <= i < begin + k:
                _offer(nearest, k, distance, i, tree.rows)
    return k


@inlined
def sort_nearest(nearest: Nearest, count: int, rows: NDArray[np.int64]) -> None:
    """Sort the first `count` neighbours by (squared distance, row number).

    Each goes to the place that counting the smaller ones gives it, by distances in single
    precision made different by an index in their lowest bits; an insertion pass then settles what
    these blur by the distances themselves, and ties by the row numbers.
    """
    size = np.uint64(count)
    mask = np.uint32(1)
    while mask < size:
        mask += mask
    mask -= np.uint32(1)
    for i in range(size):
        # Neither infinite nor denormal, or the index would make it no number, or zero.
        nearest.key[i] = np.float32(min(nearest.distance[i], 1e38)) + np.float32(1e-30)
    for i in range(size):
        nearest.key_bits[i] = (nearest.key_bits[i] & ~mask) | np.uint32(i)
    rank_all(nearest.key, size, nearest.rank)
    for i in range(size):
        place = np.uint64(nearest.rank[i])
        nearest.other_distance[place] = nearest.distance[i]
        nearest.other_at[place] = nearest.at[i]
    last, last_at = -1.0, np.uint32(0)
    for i in range(size):
        distance, at = nearest.other_distance[i], nearest.other_at[i]
        j = i
        if _is_beyond(last, last_at, distance, at, rows):
            while j > np.uint64(0):
                before = j - np.uint64(1)
                if not _is_beyond(nearest.distance[before], nearest.at[before], distance, at, rows):
                    break
                nearest.distance[j], nearest.at[j] = nearest.distance[before], nearest.at[before]
                j = before
        else:
            last, last_at = distance, at
        nearest.distance[j], nearest.at[j] = distance, at


@inlined
def _is_beyond(
    distance: float, at: int, other_distance: float, other_at: int, rows: NDArray[np.int64]
) -> bool:
    """Tell whether one point comes after another in the order of (distance, row number)."""
    if distance == other_distance:
        return rows[at] > rows[other_at]
    return distance > other_distance


@compiled
def _heapify(nearest: Nearest, k: int, rows: NDArray[np.int64]) -> None:
    for start in range(k // 2 - 1, -1, -1):
        _sift_down(nearest, k, start, nearest.distance[start], nearest.at[start], rows)


@compiled
def _offer(nearest: Nearest, k: int, distance: float, at: int, rows: NDArray[np.int64]) -> None:
    """Put a point in the place of the farthest of the heap, if it is nearer."""
    if _is_beyond(nearest.distance[0], nearest.at[0], distance, at, rows):
        _sift_down(nearest, k, 0, distance, at, rows)


@compiled
def _sift_down(
    nearest: Nearest, k: int, start: int, distance: float, at: int, rows: NDArray[np.int64]
) -> None:
    """Write a point into the heap at `start`, or below it where others are farther."""
    parent = start
    while 2 * parent + 1 < k:
        child = 2 * parent + 1
        if child + 1 < k and _is_beyond(
            nearest.distance[child + 1],
            nearest.at[child + 1],
            nearest.distance[child],
            nearest.at[child],
            rows,
        ):
            child += 1
        if not _is_beyond(nearest.distance[child], nearest.at[child], distance, at, rows):
            break
        nearest.distance[parent] = nearest.distance[child]
        nearest.at[parent] = nearest.at[child]
        parent = child
    nearest.distance[parent] = distance
    nearest.at[parent] = at


@inlined
def point_distance(tree: Tree, i: int, x: float, y: float, z: float) -> float:
    """Return the squared distance of the point at a position from a place."""
    dx = tree.x[i] - x
    dy = tree.y[i] - y
    dz = tree.z[i] - z
    return (dx * dx + dy * dy) + dz * dz


@inlined
def _box_to_point(boxes: NDArray[np.float64], node: int, x: float, y: float, z: float) -> float:
    """Return the squared distance of a node's box from a place."""
    i = np.uint64(node)
    dx = max(boxes[i, 0] - x, x - boxes[i, 3], 0.0)
    dy = max(boxes[i, 1] - y, y - boxes[i, 4], 0.0)
    dz = max(boxes[i, 2] - z, z - boxes[i, 5], 0.0)
    return (dx * dx + dy * dy) + dz * dz


@inlined
def _box_to_box(boxes: NDArray[np.float64], node: int, other: int) -> float:
    """Return the squared distance of the boxes of two nodes."""
    i, j = np.uint64(node), np.uint64(other)
    dx = max(boxes[i, 0] - boxes[j, 3], boxes[j, 0] - boxes[i, 3], 0.0)
    dy = max(boxes[i, 1] - boxes[j, 4], boxes[j, 1] - boxes[i, 4], 0.0)
    dz = max(boxes[i, 2] - boxes[j, 5], boxes[j, 2] - boxes[i, 5], 0.0)
    return (dx * dx + dy * dy) + dz * dz


@inlined
def _is_one_place(boxes: NDArray[np.float64], node: int) -> bool:
    return (
        boxes[node, 0] == boxes[node, 3]
        and boxes[node, 1] == boxes[node, 4]
        and boxes[node, 2] == boxes[node, 5]
    )


@compiled
def _leaf_node(tree: Tree, leaf: int) -> int:
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
    boxes, node = tree.boxes, _leaf_node(tree, leaf)
    x = 0.5 * boxes[node, 0] + 0.5 * boxes[node, 3]
    y = 0.5 * boxes[node, 1] + 0.5 * boxes[node, 4]
    z = 0.5 * boxes[node, 2] + 0.5 * boxes[node, 5]
    best, least = leaf * LEAF_SIZE, np.inf
    for i in range(leaf * LEAF_SIZE, min((leaf + 1) * LEAF_SIZE, tree.rows.size)):
        distance = point_distance(tree, i, x, y, z)
        if distance < least:
            best, least = i, distance
    return best


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
