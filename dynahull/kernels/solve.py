"""From points to densities without ever holding all neighbours: leaf by leaf, query by query.

These two functions are all that is compiled ahead; everything else is inlined into them.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from dynahull.kernels.frame import make_neighbourhood
from dynahull.kernels.hull import hull_volume, make_surface
from dynahull.kernels.neighbours import (
    bound_from,
    gather_candidates,
    make_candidates,
    make_nearest,
    middle_of_leaf,
    point_distance,
    search_list,
    search_tree,
    sort_nearest,
)
from dynahull.kernels.tree import LEAF_SIZE, Tree, grow_tree

_POINT_ARRAYS = "float64[::1], float64[::1], float64[::1], int64[::1], uint32[::1], float64[:,::1]"

GROW_SIGNATURE = f"void({_POINT_ARRAYS})"
SOLVE_SIGNATURE = (
    f"void({_POINT_ARRAYS}, int64, int64, int64, boolean[::1], "
    "float64[::1], float64[::1], int64[:,::1])"
)


def grow(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    rows: NDArray[np.int64],
    order: NDArray[np.uint32],
    boxes: NDArray[np.float64],
) -> None:
    """Put points into kd-tree order, in place; see `dynahull.kernels.tree.Tree`."""
    grow_tree(Tree(x, y, z, rows, order, boxes))


def solve(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    z: NDArray[np.float64],
    rows: NDArray[np.int64],
    order: NDArray[np.uint32],
    boxes: NDArray[np.float64],
    k: int,
    first_leaf: int,
    end_leaf: int,
    queries: NDArray[np.bool_],
    density: NDArray[np.float64],
    squared_reach: NDArray[np.float64],
    neighbours: NDArray[np.int64],
) -> None:
    """Solve the queries of some leaves.

    Parameters
    ----------
    x, y, z, rows, order, boxes
        The tree; see `dynahull.kernels.tree.Tree`.
    k : int
        Neighbours, at most the number of points.
    first_leaf, end_leaf : int
        Which leaves.
    queries : (n,) bool array
        Which points, in the order of the input as are all results.
    density : (n,) or (0,) float64 array
        Set to k / volume; infinite where flat, NaN where no wrapping was certified. Not computed
        where empty.
    squared_reach : (n,) float64 array
        Set to the squared distance of the k-th neighbour.
    neighbours : (n, k) or (0, 0) int64 array
        Set to the neighbours' row numbers, in order; not where empty.
    """
    tree = Tree(x, y, z, rows, order, boxes)
    candidates, nearest = make_candidates(k), make_nearest(k)
    points, surface = make_neighbourhood(k), make_surface(k)
    for leaf in range(first_leaf, end_leaf):
        begin, end = leaf * LEAF_SIZE, min((leaf + 1) * LEAF_SIZE, x.size)
        if not _any_query(tree, queries, begin, end):
            continue
        middle = middle_of_leaf(tree, leaf)
        search_tree(tree, x[middle], y[middle], z[middle], k, begin - k // 2, nearest)
        middle_reach = nearest.distance[0]
        farthest = 0.0
        for i in range(begin, end):
            farthest = max(farthest, point_distance(tree, i, x[middle], y[middle], z[middle]))
        count = gather_candidates(tree, leaf, k, bound_from(middle_reach, farthest), candidates)
        guess = middle_reach
        for i in range(begin, end):
            at = np.uint64(order[i])
            if not queries[at]:
                continue
            if count < 0:
                found = search_tree(tree, x[i], y[i], z[i], k, i - k // 2, nearest)
            else:
                away = point_distance(tree, i, x[middle], y[middle], z[middle])
                found = search_list(
                    x[i],
                    y[i],
                    z[i],
                    k,
                    guess,
                    bound_from(middle_reach, away),
                    candidates,
                    count,
                    rows,
                    nearest,
                )
            sort_nearest(nearest, found, rows)
            guess = nearest.distance[k - 1]
            squared_reach[at] = guess
            if neighbours.size:
                for j in range(k):
                    neighbours[at, j] = rows[nearest.at[j]]
            if density.size:
                for j in range(np.uint64(k)):
                    near = np.uint64(nearest.at[j])
                    points.dx[j] = x[near] - x[i]
                    points.dy[j] = y[near] - y[i]
                    points.dz[j] = z[near] - z[i]
                volume = hull_volume(points, k, surface)
                density[at] = np.inf if volume == 0.0 else k / volume


@njit(nogil=True)
def _any_query(tree: Tree, queries: NDArray[np.bool_], begin: int, end: int) -> bool:
    for i in range(begin, end):  # noqa: SIM110 (compiled code has no generators)
        if queries[np.uint64(tree.order[i])]:
            return True
    return False
