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
    Walk,
    add_nearer_half_last,
    begin_walk,
    is_one_place,
    point_distance,
)

NO_RANK = np.iinfo(np.int64).max
"""The rank of no point: any point that is no farther takes the place of it."""


def find(
    tree: Tree,
    places: NDArray[np.float64],
    first: int,
    end: int,
    walk: Walk,
    squared: NDArray[np.float64],
    rank: NDArray[np.int64],
) -> None:
    """Look for a nearer point of some of the places, by walking the tree, nearer boxes first.

    Parameters
    ----------
    tree : Tree
        Its row numbers are the points' ranks.
    places : (m, 3) float64 array
        Those from `first` to `end` look.
    squared : (m,) float64 array
        Squared distance of the nearest point so far, or within which one is looked for.
    rank : (m,) int64 array
        Its rank; `NO_RANK` as long as there is none. The smaller of equally near points counts.
    """
    for place in range(first, end):
        x, y, z = places[place, 0], places[place, 1], places[place, 2]
        nearest, least = squared[place], rank[place]
        depth = begin_walk(walk, tree)
        while depth > 0:
            depth -= 1
            if walk.gap[depth] > nearest:
                continue
            node, begin, leaves = walk.nodes[depth, 0], walk.nodes[depth, 1], walk.nodes[depth, 2]
            one_place = leaves > 1 and is_one_place(tree.boxes, node)
            if leaves > 1 and not one_place:
                depth = add_nearer_half_last(walk, depth, tree, node, begin, leaves, (x, y, z))
                continue
            start = begin * LEAF_SIZE
            # All in one place are in the order of their ranks.
            stop = start + 1 if one_place else min(start + LEAF_SIZE, tree.rows.size)
            for i in range(np.uint64(start), np.uint64(stop)):
                distance = point_distance(tree, i, x, y, z)
                if distance < nearest or (distance == nearest and tree.rows[i] < least):
                    nearest, least = distance, tree.rows[i]
        squared[place], rank[place] = nearest, least
