"""The k nearest points of the queries of a leaf, from one list of candidates.

The 32 queries of a leaf lie close together, so they share one list of candidates: the leaves near
enough to hold a neighbour of any of them. How near is known from the query in the middle, solved
first: a query at distance `e` from a point whose k-th neighbour is at distance `r` has its own
within `r + e`. Of these leaves, each query measures those near enough for itself. The k-th
distance is then found by counting, which is one pass of vector comparisons, and only the points
within it are looked at one by one.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.compiled import compiled, inlined
from dynahull.kernels.lanes import aligned, padded
from dynahull.kernels.nearest import SLACK, Nearest, heapify, offer
from dynahull.kernels.tree import (
    LEAF_SIZE,
    Tree,
    box_to_box,
    is_one_place,
    leaf_count,
    leaf_node,
    make_stack,
)
from dynahull.kernels.vectors import box_distances, count_up_to, lowest_place, places_up_to

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
    tree: Tree, leaf: int, k: int, squared_bound: float, candidates: Candidates
) -> int:
    """List the leaves within a distance of the box of `leaf`.

    Returns
    -------
    int
        How many there are; -1 where they do not fit.
    """
    leaf_box = leaf_node(tree, leaf)
    count = 0
    stack = candidates.stack
    stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, leaf_count(tree.rows.size)
    depth = 1
    while depth > 0:
        depth -= 1
        node, first, leaves = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        if box_to_box(tree.boxes, node, leaf_box) > squared_bound:
            continue
        one_place = leaves > 1 and is_one_place(tree.boxes, node)
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


@inlined
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
                    heapify(nearest, k, tree.rows)
            elif distance <= nearest.distance[0]:
                offer(nearest, k, distance, at, tree.rows)
    return k
