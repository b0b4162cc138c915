"""The nearest points of one query: a heap while they are found, sorted in the end."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.decorators import compiled, inlined
from dynahull.kernels.lanes import LANES, aligned, padded
from dynahull.kernels.vectors import rank_all


class Pool(NamedTuple):
    """Points of which to keep the nearest: a heap with the farthest on top.

    Attributes
    ----------
    distance : (capacity,) float64 array
        Squared distances.
    at : (capacity,) uint32 array
        Positions in the tree.
    """

    distance: NDArray[np.float64]
    at: NDArray[np.uint32]


class Nearest(NamedTuple):
    """The nearest points of one query.

    Attributes
    ----------
    at : (capacity,) uint32 array
        Positions in the tree.
    measure : (capacity,) float64 array
        What they are sorted by.
    key, key_bits, rank, other_measure, other_at
        Room to sort them.
    """

    at: NDArray[np.uint32]
    measure: NDArray[np.float64]
    key: NDArray[np.float32]
    key_bits: NDArray[np.uint32]
    rank: NDArray[np.uint32]
    other_measure: NDArray[np.float64]
    other_at: NDArray[np.uint32]


def make_pool(size: int) -> Pool:
    """Make room for so many points."""
    return Pool(np.empty(size), np.empty(size + LANES, np.uint32))


def make_nearest(k: int) -> Nearest:
    """Make room for the neighbours of one query."""
    size = padded(k)
    key = aligned(size, np.float32)
    return Nearest(
        np.empty(size + LANES, np.uint32),
        np.empty(size),
        key,
        key.view(np.uint32),
        aligned(size, np.uint32),
        np.empty(size),
        np.empty(size, np.uint32),
    )


@compiled
def heapify(pool: Pool, k: int, rows: NDArray[np.int64]) -> None:
    """Put the first k points in the order of a heap, the farthest on top."""
    for start in range(k // 2 - 1, -1, -1):
        _sift_down(pool, k, start, pool.distance[start], pool.at[start], rows)


@compiled
def offer(pool: Pool, k: int, distance: float, at: int, rows: NDArray[np.int64]) -> None:
    """Put a point in the place of the farthest of the heap, if it is nearer."""
    if _is_beyond(pool.distance[0], pool.at[0], distance, at, rows):
        _sift_down(pool, k, 0, distance, at, rows)


@compiled
def _sift_down(
    pool: Pool, k: int, start: int, distance: float, at: int, rows: NDArray[np.int64]
) -> None:
    """Write a point into the heap at `start`, or below it where others are farther."""
    parent = start
    while 2 * parent + 1 < k:
        child = 2 * parent + 1
        if child + 1 < k and _is_beyond(
            pool.distance[child + 1], pool.at[child + 1], pool.distance[child], pool.at[child], rows
        ):
            child += 1
        if not _is_beyond(pool.distance[child], pool.at[child], distance, at, rows):
            break
        pool.distance[parent] = pool.distance[child]
        pool.at[parent] = pool.at[child]
        parent = child
    pool.distance[parent] = distance
    pool.at[parent] = at


@compiled
def keep_nearest(pool: Pool, count: int, k: int, rows: NDArray[np.int64]) -> float:
    """Drop all but the k nearest of the first `count` points; return the k-th squared distance.

    Ties go to the smaller row number.
    """
    heapify(pool, k, rows)
    for i in range(k, count):
        offer(pool, k, pool.distance[i], pool.at[i], rows)
    return pool.distance[0]


@inlined
def sort_nearest(nearest: Nearest, count: int, rows: NDArray[np.int64]) -> None:
    """Sort the first `count` points by (measure, row number).

    Each goes to the place that counting the smaller ones gives it, by measures in single
    precision made different by an index in their lowest bits; an insertion pass then settles what
    these blur by the measures themselves, and ties by the row numbers.
    """
    size = np.uint64(count)
    mask = np.uint32(1)
    while mask < size:
        mask += mask
    mask -= np.uint32(1)
    for i in range(size):
        # Neither infinite nor denormal, or the index would make it no number, or zero.
        nearest.key[i] = np.float32(max(-1e38, min(nearest.measure[i], 1e38))) + np.float32(1e-30)
    for i in range(size):
        nearest.key_bits[i] = (nearest.key_bits[i] & ~mask) | np.uint32(i)
    rank_all(nearest.key, size, nearest.rank)
    for i in range(size):
        place = np.uint64(nearest.rank[i])
        nearest.other_measure[place] = nearest.measure[i]
        nearest.other_at[place] = nearest.at[i]
    last, last_at = -np.inf, np.uint32(0)
    for i in range(size):
        measure, at = nearest.other_measure[i], nearest.other_at[i]
        j = np.uint64(i)
        if _is_beyond(last, last_at, measure, at, rows):
            while j > np.uint64(0):
                before = j - np.uint64(1)
                if not _is_beyond(nearest.measure[before], nearest.at[before], measure, at, rows):
                    break
                nearest.measure[j], nearest.at[j] = nearest.measure[before], nearest.at[before]
                j = before
        else:
            last, last_at = measure, at
        nearest.measure[j], nearest.at[j] = measure, at


@inlined
def _is_beyond(
    distance: float, at: int, other_distance: float, other_at: int, rows: NDArray[np.int64]
) -> bool:
    """Tell whether one point comes after another in the order of (distance, row number)."""
    if distance == other_distance:
        return rows[at] > rows[other_at]
    return distance > other_distance
