"""The nearest point of places that are not points of the tree, each place with a bound of its own.

What is known of a place is the squared distance of the nearest point met so far, and the rank of
that point. Several trees are asked one after the other, in any order, and the answer is that of one
tree over all their points: to the last bit, as distances of boxes never exceed those of their
points.
"""

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.tree import (
    LEAF_SIZE,
    Tree,
    box_to_point,
    is_one_place,
    leaf_count,
    point_distance,
)

NO_RANK = np.iinfo(np.int64).max
"""The rank of no point: any point that is no farther takes the place of it."""


def find(
    tree: Tree,
    places: NDArray[np.float64],
    first: int,
    end: int,
    stack: NDArray[np.int64],
    gap: NDArray[np.float64],
    squared: NDArray[np.float64],
    rank: NDArray[np.int64],
) -> None:
    """Look for a nearer point of some of the places, by walking the tree, nearer boxes first.

    Parameters
    ----------
    tree : Tree
        Its row numbers are the points' ranks.
    places : (m, 3) float64 array
    first, end : int
        The places to look from.
    stack : (levels, 3) int64 array
        A `make_stack`; and `gap`, (levels,) float64, beside it.
    squared : (m,) float64 array
        Squared distance of the nearest point so far, or within which one is looked for.
    rank : (m,) int64 array
        Its rank; `NO_RANK` as long as there is none. The smaller of equally near points counts.
    """
    for place in range(first, end):
        x, y, z = places[place, 0], places[place, 1], places[place, 2]
        nearest, least = squared[place], rank[place]
        stack[0, 0], stack[0, 1], stack[0, 2] = 0, 0, leaf_count(tree.rows.size)
        gap[0] = box_to_point(tree.boxes, 0, x, y, z)
        depth = 1
        while depth > 0:
            depth -= 1
            if gap[depth] > nearest:
                continue
            node, begin, leaves = stack[depth, 0], stack[depth, 1], stack[depth, 2]
            one_place = leaves > 1 and is_one_place(tree.boxes, node)
            if leaves > 1 and not one_place:
                left = (leaves + 1) // 2
                near_gap = box_to_point(tree.boxes, node + 1, x, y, z)
                far_gap = box_to_point(tree.boxes, node + 2 * left, x, y, z)
                far_first = 0 if near_gap > far_gap else 1
                right_at, left_at = depth + 1 - far_first, depth + far_first
                stack[right_at, 0], stack[right_at, 1] = node + 2 * left, begin + left
                stack[right_at, 2], gap[right_at] = leaves - left, far_gap
                stack[left_at, 0], stack[left_at, 1] = node + 1, begin
                stack[left_at, 2], gap[left_at] = left, near_gap
                depth += 2
                continue
            start = begin * LEAF_SIZE
            # All in one place are in the order of their ranks.
            stop = start + 1 if one_place else min(start + LEAF_SIZE, tree.rows.size)
            for i in range(np.uint64(start), np.uint64(stop)):
                distance = point_distance(tree, i, x, y, z)
                if distance < nearest or (distance == nearest and tree.rows[i] < least):
                    nearest, least = distance, tree.rows[i]
        squared[place], rank[place] = nearest, least
