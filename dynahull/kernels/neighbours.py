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
from numba import njit
from numpy.typing import NDArray

from dynahull.kernels.tree import LEAF_SIZE, Tree, leaf_count

SLACK = 8
"""Points beyond the k-th that counting may leave in: sorting them is cheaper than counting on."""

_PROBES = 10
_SAFE = 1.0 + 1e-9  # covers the rounding of the triangle inequality
_TINY = 1e-290  # and the squares that underflow


class Candidates(NamedTuple):
    """The points of the leaves around a leaf.

    Attributes
    ----------
    x, y, z : (capacity,) float64 arrays
        Coordinates, gathered.
    at : (capacity,) uint32 array
        Positions in the tree.
    distance : (capacity,) float64 array
        Squared distances from the present query.
    """

    x: NDArray[np.float64]
    y: NDArray[np.float64]
    z: NDArray[np.float64]
    at: NDArray[np.uint32]
    distance: NDArray[np.float64]


class Nearest(NamedTuple):
    """The nearest points of one query; while being found, a heap with the farthest on top.

    Attributes
    ----------
    distance : (capacity,) float64 array
        Squared distances.
    at : (capacity,) uint32 array
        Positions in the tree.
    key, rank, other_distance, other_at
        Room to sort them.
    """

    distance: NDArray[np.float64]
    at: NDArray[np.uint32]
    key: NDArray[np.int64]
    rank: NDArray[np.int64]
    other_distance: NDArray[np.float64]
    other_at: NDArray[np.uint32]


@njit(nogil=True)
def candidate_capacity(k: int) -> int:
    """Return how many candidates a leaf may share; where there are more, each query walks."""
    return max(4096, 32 * k)


@njit(nogil=True)
def make_candidates(k: int) -> Candidates:
    """Allocate the candidates of one leaf."""
    size = candidate_capacity(k) + LEAF_SIZE
    return Candidates(
        np.empty(size), np.empty(size), np.empty(size), np.empty(size, np.uint32), np.empty(size)
    )


@njit(nogil=True)
def make_nearest(k: int) -> Nearest:
    """Allocate the neighbours of one query."""
    size = 2 * k + SLACK
    return Nearest(
        np.empty(size),
        np.empty(size, np.uint32),
        np.empty(size, np.int64),
        np.empty(size, np.int64),
        np.empty(size),
        np.empty(size, np.uint32),
    )


@njit(nogil=True)
def gather_candidates(
    tree: Tree, leaf: int, k: int, squared_bound: float, candidates: Candidates
) -> int:
    """List the points of all leaves within a distance of the box of `leaf`.

    Returns
    -------
    int
        How many there are; -1 where they do not fit.
    """
    box = np.empty(6)
    box[:] = tree.boxes[_leaf_node(tree, leaf)]
    capacity = candidate_capacity(k)
    count = 0
    stack = np.empty((64, 3), np.int64)
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, leaf_count(tree.x.size)
    depth = 1
    while depth > 0:
        depth -= 1
        node, first, leaves = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        if _box_distance(tree.boxes, node, box) > squared_bound:
            continue
        if leaves > 1 and not _is_one_place(tree.boxes, node):
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
        begin = first * LEAF_SIZE
        end = min((first + leaves) * LEAF_SIZE, tree.x.size)
        if leaves > 1:
            # All in one place, in the order of their rows: the first k are the nearest.
            end = min(end, begin + k)
        if count + (end - begin) > capacity:
            return -1
        shift = np.uint64(count)
        for i in range(np.uint64(begin), np.uint64(end)):
            slot = shift + (i - np.uint64(begin))
            candidates.x[slot] = tree.x[i]
            candidates.y[slot] = tree.y[i]
            candidates.z[slot] = tree.z[i]
            candidates.at[slot] = i
        count += end - begin
    return count


@njit(nogil=True)
def search_list(
    x: float,
    y: float,
    z: float,
    k: int,
    guess: float,
    squared_bound: float,
    candidates: Candidates,
    count: int,
    rows: NDArray[np.int64],
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
        Number of candidates.

    Returns
    -------
    int
        Points left in `nearest`: the k nearest and perhaps a few more, unsorted.
    """
    size = np.uint64(count)
    distance = candidates.distance
    for i in range(size):
        dx = candidates.x[i] - x
        dy = candidates.y[i] - y
        dz = candidates.z[i] - z
        distance[i] = (dx * dx + dy * dy) + dz * dz
    threshold, within = _count_to_threshold(distance, size, k, guess, squared_bound)
    if within > k + SLACK + k // 2:
        for i in range(size):
            if i < np.uint64(k):
                nearest.distance[i] = distance[i]
                nearest.at[i] = candidates.at[i]
                if i == np.uint64(k - 1):
                    _heapify(nearest, k, rows)
            elif distance[i] <= nearest.distance[0]:
                _offer(nearest, k, distance[i], candidates.at[i], rows)
        return k
    filled = np.uint64(0)
    for i in range(size):
        nearest.distance[filled] = distance[i]
        nearest.at[filled] = candidates.at[i]
        filled += np.uint64(distance[i] <= threshold)
        if filled == np.uint64(within):
            break
    return within


@njit(nogil=True)
def _count_to_threshold(
    distance: NDArray[np.float64], size: np.uint64, k: int, guess: float, squared_bound: float
) -> tuple[float, int]:
    """Find a squared distance within which lie k candidates, and few more where ties allow."""
    low, low_count = 0.0, 0
    high, high_count = squared_bound, 0
    probe = min(guess, squared_bound)
    for _ in range(_PROBES):
        within = _count_within(distance, size, probe)
        if within >= k:
            high, high_count = probe, within
            if within <= k + SLACK:
                break
        else:
            low, low_count = probe, within
        # Neighbours of a surface grow in number as the squared distance does.
        if high_count:
            share = (k + 0.5 * SLACK - low_count) / (high_count - low_count)
            probe = low + min(share, 0.9) * (high - low)
        else:
            probe = min(low * (k + 0.5 * SLACK) / max(low_count, 1), high)
            probe = high if probe <= low else probe
        if not low < probe < high and high_count:
            break
    if high_count == 0:
        high_count = _count_within(distance, size, high)
    return high, high_count


@njit(nogil=True)
def _count_within(distance: NDArray[np.float64], size: np.uint64, threshold: float) -> int:
    within = 0
    for i in range(size):
        within += 1 if distance[i] <= threshold else 0
    return within


@njit(nogil=True)
def search_tree(
    tree: Tree, x: float, y: float, z: float, k: int, start: int, nearest: Nearest
) -> int:
    """Find the k nearest points of a query by walking the tree, nearer boxes first.

    Begins with the points from position `start` on, which should be near. Returns k.
    """
    box = np.array([x, y, z, x, y, z])
    begin = max(0, min(start, tree.x.size - k))
    for i in range(k):
        nearest.distance[i] = point_distance(tree, begin + i, x, y, z)
        nearest.at[i] = begin + i
    _heapify(nearest, k, tree.rows)
    stack = np.empty((64, 3), np.int64)
    gap = np.empty(64)
    stack[0, 0], stack[0, 1], stack[0, 2], gap[0] = 0, 0, leaf_count(tree.x.size), 0.0
    depth = 1
    while depth > 0:
        depth -= 1
        node, first, leaves = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        if gap[depth] > nearest.distance[0]:
            continue
        if leaves > 1 and not _is_one_place(tree.boxes, node):
            left = (leaves + 1) // 2
            near_gap = _box_distance(tree.boxes, node + 1, box)
            far_gap = _box_distance(tree.boxes, node + 2 * left, box)
            far_first = 0 if near_gap > far_gap else 1
            right_at, left_at = depth + 1 - far_first, depth + far_first
            stack[right_at, 0], stack[right_at, 1] = node + 2 * left, first + left
            stack[right_at, 2], gap[right_at] = leaves - left, far_gap
            stack[left_at, 0], stack[left_at, 1] = node + 1, first
            stack[left_at, 2], gap[left_at] = left, near_gap
            depth += 2
            continue
        first_point = first * LEAF_SIZE
        end = min((first + leaves) * LEAF_SIZE, tree.x.size)
        if leaves > 1:
            end = min(end, first_point + k)
        for i in range(first_point, end):
            distance = point_distance(tree, i, x, y, z)
            if distance <= nearest.distance[0] and not begin <= i < begin + k:
                _offer(nearest, k, distance, i, tree.rows)
    return k


@njit(nogil=True)
def sort_nearest(nearest: Nearest, count: int, rows: NDArray[np.int64]) -> None:
    """Sort the first `count` neighbours by (squared distance, row number).

    Each goes to the place that counting the smaller ones gives it, by keys made different by an
    index in their lowest bits; an insertion pass then settles what those bits blur, and ties.
    """
    size = np.uint64(count)
    bits = nearest.distance.view(np.int64)
    for i in range(size):
        nearest.key[i] = (bits[i] & ~np.int64(0xFFFFF)) | np.int64(i)
    for i in range(size):
        key = nearest.key[i]
        smaller = 0
        for j in range(size):
            smaller += 1 if nearest.key[j] < key else 0
        nearest.rank[i] = smaller
    for i in range(size):
        place = np.uint64(nearest.rank[i])
        nearest.other_distance[place] = nearest.distance[i]
        nearest.other_at[place] = nearest.at[i]
    for i in range(count):
        distance, at = nearest.other_distance[i], nearest.other_at[i]
        j = i
        while j > 0 and _is_beyond(nearest.distance[j - 1], nearest.at[j - 1], distance, at, rows):
            nearest.distance[j] = nearest.distance[j - 1]
            nearest.at[j] = nearest.at[j - 1]
            j -= 1
        nearest.distance[j] = distance
        nearest.at[j] = at


@njit(nogil=True)
def _is_beyond(
    distance: float, at: int, other_distance: float, other_at: int, rows: NDArray[np.int64]
) -> bool:
    """Tell whether one point comes after another in the order of (distance, row number)."""
    if distance == other_distance:
        return rows[at] > rows[other_at]
    return distance > other_distance


@njit(nogil=True)
def _heapify(nearest: Nearest, k: int, rows: NDArray[np.int64]) -> None:
    for start in range(k // 2 - 1, -1, -1):
        _sift_down(nearest, k, start, nearest.distance[start], nearest.at[start], rows)


@njit(nogil=True)
def _offer(nearest: Nearest, k: int, distance: float, at: int, rows: NDArray[np.int64]) -> None:
    """Put a point in the place of the farthest of the heap, if it is nearer."""
    if _is_beyond(nearest.distance[0], nearest.at[0], distance, at, rows):
        _sift_down(nearest, k, 0, distance, at, rows)


@njit(nogil=True)
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


@njit(nogil=True)
def point_distance(tree: Tree, i: int, x: float, y: float, z: float) -> float:
    """Return the squared distance of the point at a position from a place."""
    dx = tree.x[i] - x
    dy = tree.y[i] - y
    dz = tree.z[i] - z
    return (dx * dx + dy * dy) + dz * dz


@njit(nogil=True)
def _box_distance(boxes: NDArray[np.float64], node: int, box: NDArray[np.float64]) -> float:
    """Return the squared distance of a node's box from another box."""
    i = np.uint64(node)
    dx = max(boxes[i, 0] - box[3], box[0] - boxes[i, 3], 0.0)
    dy = max(boxes[i, 1] - box[4], box[1] - boxes[i, 4], 0.0)
    dz = max(boxes[i, 2] - box[5], box[2] - boxes[i, 5], 0.0)
    return (dx * dx + dy * dy) + dz * dz


@njit(nogil=True)
def _is_one_place(boxes: NDArray[np.float64], node: int) -> bool:
    return (
        boxes[node, 0] == boxes[node, 3]
        and boxes[node, 1] == boxes[node, 4]
        and boxes[node, 2] == boxes[node, 5]
    )


@njit(nogil=True)
def _leaf_node(tree: Tree, leaf: int) -> int:
    """Return the number of a leaf's node."""
    node, first, leaves = 0, 0, leaf_count(tree.x.size)
    while leaves > 1:
        left = (leaves + 1) // 2
        if leaf < first + left:
            node, leaves = node + 1, left
        else:
            node, first, leaves = node + 2 * left, first + left, leaves - left
    return node


@njit(nogil=True)
def middle_of_leaf(tree: Tree, leaf: int) -> int:
    """Return the position of the point of a leaf that is nearest to the middle of its box."""
    boxes, node = tree.boxes, _leaf_node(tree, leaf)
    x = 0.5 * boxes[node, 0] + 0.5 * boxes[node, 3]
    y = 0.5 * boxes[node, 1] + 0.5 * boxes[node, 4]
    z = 0.5 * boxes[node, 2] + 0.5 * boxes[node, 5]
    best, least = leaf * LEAF_SIZE, np.inf
    for i in range(leaf * LEAF_SIZE, min((leaf + 1) * LEAF_SIZE, tree.x.size)):
        distance = point_distance(tree, i, x, y, z)
        if distance < least:
            best, least = i, distance
    return best


@njit(nogil=True)
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
