"""The k nearest of a list of candidates: single precision finds them, double decides.

Each query measures the points of the leaves near enough for itself, in single precision, and the
k-th distance is enclosed by counting, which is one pass of vector comparisons. Points nearer than
that by more than rounding can be wrong are neighbours; only the few others about as far are
measured in double precision, from the original coordinates, and those are what decides.

*What rounding can do.* Coordinates relative to the middle are at most 1, so rounded by at most
2^-25, and differences of two of them are off by 2^-24 and their own rounding. With D the true
squared distance, the computed one is off by at most 2^-24 (3.5 sqrt(D) + 5 D) + 2^-46. A value
widened by `_allowance`, four times as much, is not reached by what is nearer than it twice over.
Boxes are treated as the points are, and rounding is monotonic, so the distance of a box is never
larger than those of its points.
"""

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.candidates import Candidates
from dynahull.kernels.compiled import inlined
from dynahull.kernels.measuring import boxes_within, count_up_to, measure_leaf, share_out
from dynahull.kernels.nearest import Nearest, Pool, keep_nearest
from dynahull.kernels.tree import LEAF_SIZE, Tree, point_distance

_PROBES = 12
_HOPE, _FEAR = np.float32(1.25), np.float32(0.9)  # in squared distance
_BAND = 24


@inlined
def search_list(
    tree: Tree,
    query: int,
    k: int,
    guess: float,
    squared_bound: float,
    middle: int,
    scale: float,
    candidates: Candidates,
    count: int,
    nearest: Nearest,
    pool: Pool,
) -> float:
    """Find the k nearest candidates of a query; return the squared distance of the k-th.

    Parameters
    ----------
    query : int
        Position in the tree.
    guess : float
        Squared distance at which to begin counting.
    squared_bound : float
        Squared distance within which k candidates are sure to lie.
    middle : int
        Position of the point that the candidates are relative to.
    scale : float
        Their scale.
    count : int
        Number of candidate leaves.
    nearest : Nearest
        `at` is overwritten, in no order.
    pool : Pool
        Overwritten.
    """
    x, y, z = tree.x[query], tree.y[query], tree.z[query]
    place = (
        np.float32((x - tree.x[middle]) * scale),
        np.float32((y - tree.y[middle]) * scale),
        np.float32((z - tree.z[middle]) * scale),
    )
    distance = candidates.distance
    # Most often the neighbours lie about as far as those of the query before. If there are k
    # within that, all points within that have been seen.
    limit = np.float32(squared_bound * scale * scale)
    limit += _allowance(limit)
    guessed = np.float32(guess * scale * scale)
    low, high = _FEAR * guessed, min(_HOPE * guessed, limit)
    leaves = _select_leaves(candidates, count, place, high + _allowance(high))
    low_count, high_count = _measure_leaves(candidates, leaves, place, low, high)
    if high_count < k:
        low, high = high, limit
        leaves = _select_leaves(candidates, count, place, high + _allowance(high))
        low_count, high_count = _measure_leaves(candidates, leaves, place, low, high)
    if low_count >= k:
        low, low_count, high, high_count = np.float32(0.0), 0, low, low_count
    size = leaves * np.uint64(LEAF_SIZE)
    low, high = _enclose(distance, size, k, low, low_count, high, high_count)
    limits = low - _allowance(low), high + _allowance(high)
    sure = pooled = np.uint64(0)
    for i in range(leaves):
        sure, pooled = share_out(
            distance,
            i * np.uint64(LEAF_SIZE),
            limits,
            np.uint64(candidates.leaf[candidates.near[i]]) * np.uint64(LEAF_SIZE),
            (nearest.at, pool.at),
            (sure, pooled),
        )
    for i in range(pooled):
        pool.distance[i] = point_distance(tree, pool.at[i], x, y, z)
    wanted = k - np.int64(sure)
    reach = keep_nearest(pool, np.int64(pooled), wanted, tree.rows)
    for i in range(np.uint64(wanted)):
        nearest.at[sure + i] = pool.at[i]
    return reach


@inlined
def _allowance(squared_distance: np.float32) -> np.float32:
    """Return more than four times what rounding can do to a squared distance."""
    root = np.sqrt(squared_distance)
    return np.float32(2.0**-20) * (root + np.float32(1.5) * squared_distance) + np.float32(2.0**-42)


@inlined
def _select_leaves(
    candidates: Candidates,
    count: int,
    place: tuple[np.float32, np.float32, np.float32],
    limit: np.float32,
) -> np.uint64:
    """List the leaves within a distance of a query; return how many."""
    boxes = (
        candidates.low_x,
        candidates.low_y,
        candidates.low_z,
        candidates.high_x,
        candidates.high_y,
        candidates.high_z,
    )
    return boxes_within(boxes, np.uint64(count), place, limit, candidates.near)


@inlined
def _measure_leaves(
    candidates: Candidates,
    leaves: np.uint64,
    place: tuple[np.float32, np.float32, np.float32],
    low: np.float32,
    high: np.float32,
) -> tuple[int, int]:
    """Measure the points of the listed leaves; count those within two distances."""
    low_count = high_count = 0
    for i in range(leaves):
        within_low, within_high = measure_leaf(
            (candidates.x, candidates.y, candidates.z),
            np.uint64(candidates.near[i]) * np.uint64(LEAF_SIZE),
            place,
            (low, high),
            candidates.distance,
            i * np.uint64(LEAF_SIZE),
        )
        low_count += within_low
        high_count += within_high
    return low_count, high_count


@inlined
def _enclose(
    distance: NDArray[np.float32],
    size: np.uint64,
    k: int,
    low: np.float32,
    low_count: int,
    high: np.float32,
    high_count: int,
) -> tuple[np.float32, np.float32]:
    """Enclose the k-th squared distance between two with few others.

    There are `low_count`, less than k, within `low`, and `high_count`, at least k, within `high`.
    """
    for _ in range(_PROBES):
        if high_count - low_count <= _BAND:
            break
        # Neighbours on a surface grow in number as the squared distance does.
        aim = k + _BAND // 4 if high_count > k + _BAND // 2 else k - _BAND // 4
        share = np.float32(aim - low_count) / np.float32(high_count - low_count)
        probe = low + share * (high - low)
        if not low < probe < high:
            break
        within = count_up_to(distance, size, probe)
        if within >= k:
            high, high_count = probe, within
        else:
            low, low_count = probe, within
    return low, high
