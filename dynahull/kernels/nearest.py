"""The nearest points of one query: a heap while they are found, sorted in the end."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.compiled import compiled, inlined
from dynahull.kernels.lanes import aligned, padded
from dynahull.kernels.tree import LEAF_SIZE
from dynahull.kernels.vectors import rank_all

SLACK = 8
"""Points beyond the k-th that counting may leave in: sorting them is cheaper than counting on."""


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
def heapify(nearest: Nearest, k: int, rows: NDArray[np.int64]) -> None:
    """Put the first k points in the order of a heap, the farthest on top."""
    for start in range(k // 2 - 1, -1, -1):
        _sift_down(nearest, k, start, nearest.distance[start], nearest.at[start], rows)


@compiled
def offer(nearest: Nearest, k: int, distance: float, at: int, rows: NDArray[np.int64]) -> None:
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
        j = np.uint64(i)
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
