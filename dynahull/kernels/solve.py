"""From points to densities without ever holding all neighbours: leaf by leaf, query by query.

`solve`, and the functions of `build` and `closest`, are compiled ahead; all else is inlined into
them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.decorators import compiled, inlined
from dynahull.kernels.frame import Neighbourhood, make_neighbourhood
from dynahull.kernels.hull import Surface, hull_volume, make_surface
from dynahull.kernels.nearby_leaves import (
    Candidates,
    bound_from,
    copy_candidates,
    gather_candidates,
    make_candidates,
)
from dynahull.kernels.nearest_heap import (
    Nearest,
    Pool,
    heapify,
    make_nearest,
    make_pool,
    offer,
    sort_nearest,
)
from dynahull.kernels.search import search_list
from dynahull.kernels.spread import measure_spread
from dynahull.kernels.tree import (
    LEAF_SIZE,
    Tree,
    add_nearer_half_last,
    begin_walk,
    is_one_place,
    middle_of_leaf,
    point_distance,
)

_DIRECTION = (0.6180339887498949, 0.7548776662466927, 0.2192059139)
"""Hardly ever the same component for two places of a lattice that maps are quantised on."""

_LONGEST_PAUSE = 63


class Workspace(NamedTuple):
    """Arrays for one thread's work on neighbourhoods of at most k points."""

    candidates: Candidates
    nearest: Nearest
    pool: Pool
    points: Neighbourhood
    surface: Surface


class Results(NamedTuple):
    """What is known of every point, in the order of the input.

    Attributes
    ----------
    squared_reach : (n,) float64 array
        Squared distance of the k-th neighbour.
    density : (n,) or (0,) float64 array
        k / volume; infinite where flat, NaN where no wrapping was certified. Not computed where
        empty.
    neighbours : (n, k) or (0, 0) int64 array
        The neighbours' row numbers, in order; not written where empty.
    spread : (n, SPREAD_COLUMNS) or (0, 0) float32 array
        See `dynahull.kernels.spread`; not written where empty.
    """

    squared_reach: NDArray[np.float64]
    density: NDArray[np.float64] = np.empty(0)
    neighbours: NDArray[np.int64] = np.empty((0, 0), np.int64)
    spread: NDArray[np.float32] = np.empty((0, 0), np.float32)


def make_workspace(k: int) -> Workspace:
    """Make the arrays for one thread."""
    candidates = make_candidates(k)
    return Workspace(
        candidates,
        make_nearest(k),
        make_pool(candidates.distance.size),
        make_neighbourhood(k),
        make_surface(k),
    )


def solve(
    tree: Tree,
    k: int,
    first_leaf: int,
    end_leaf: int,
    queries: NDArray[np.bool_],
    workspace: Workspace,
    results: Results,
) -> None:
    """Solve the queries of some leaves.

    Parameters
    ----------
    k : int
        Neighbours, at most the number of points.
    queries : (n,) bool array
        Which points, in the order of the input.
    workspace : Workspace
        Made for k.
    results : Results
        Written for the queries of these leaves.
    """
    candidates, nearest, pool = workspace.candidates, workspace.nearest, workspace.pool
    density, neighbours = results.density, results.neighbours
    waiting, pause = 0, 0
    for leaf in range(first_leaf, end_leaf):
        begin, end = leaf * LEAF_SIZE, min((leaf + 1) * LEAF_SIZE, tree.rows.size)
        if _count_queries(tree, queries, begin, end) == 0:
            continue
        middle = middle_of_leaf(tree, leaf)
        reach = guess = _bound_around(tree, middle, k)
        leaves, scale = _gather_around(tree, middle, middle, middle + 1, k, reach, candidates)
        # The middle comes first, for the reach that bounds those of the others.
        for i in range(begin - 1, end):
            query = middle if i < begin else i
            at = np.uint64(tree.order[query])
            if i >= begin and not queries[at]:
                continue
            if leaves < 0:
                guess = _search_around(tree, query, k, workspace)
            else:
                away = point_distance(tree, middle, tree.x[query], tree.y[query], tree.z[query])
                bound = bound_from(reach, away)
                guess = search_list(
                    tree, query, k, guess, bound, middle, scale, candidates, leaves, nearest, pool
                )
            if i < begin:
                reach = guess
                leaves, scale = _gather_around(tree, middle, begin, end, k, reach, candidates)
                continue
            results.squared_reach[at] = guess
            if neighbours.size:
                _write_neighbours(tree, i, k, nearest, neighbours)
            if density.size:
                places = _gather_places(tree, i, k, nearest, workspace.points)
                if results.spread.size:
                    measure_spread(workspace.points, places, results.spread[at])
                volume, rough = hull_volume(
                    workspace.points, places, workspace.surface, waiting == 0
                )
                waiting, pause = _pauses(waiting, pause, rough)
                density[at] = np.inf if volume == 0.0 else k / volume


@inlined
def _write_neighbours(
    tree: Tree, query: int, k: int, nearest: Nearest, neighbours: NDArray[np.int64]
) -> None:
    """Write down the row numbers of the k nearest points, in order."""
    x, y, z = tree.x[query], tree.y[query], tree.z[query]
    for j in range(np.uint64(k)):
        nearest.measure[j] = point_distance(tree, nearest.at[j], x, y, z)
    sort_nearest(nearest, k, tree.rows)
    at = np.uint64(tree.order[query])
    for j in range(k):
        neighbours[at, j] = tree.rows[nearest.at[j]]


@inlined
def _pauses(waiting: int, pause: int, rough: bool) -> tuple[int, int]:
    """Return for how many neighbourhoods to leave single precision alone, and the latest pause.

    Where it fails, on quantised maps, it fails for most. So each failure doubles the pause.
    """
    if waiting > 0:
        return waiting - 1, pause
    pause = 0 if rough else min(2 * pause + 1, _LONGEST_PAUSE)
    return pause, pause


@compiled
def _bound_around(tree: Tree, middle: int, k: int) -> float:
    """Bound the squared distance of a point's k-th neighbour by the k around it in the tree."""
    begin = max(0, min(middle - k // 2, tree.rows.size - k))
    x, y, z = tree.x[middle], tree.y[middle], tree.z[middle]
    bound = 0.0
    for i in range(np.uint64(begin), np.uint64(begin + k)):
        bound = max(bound, point_distance(tree, i, x, y, z))
    return bound


@compiled
def _search_around(tree: Tree, query: int, k: int, workspace: Workspace) -> float:
    """Walk the tree for the k nearest points of a point; return the squared distance of the k-th.

    The walk begins with the k points around it in the order of the tree, and goes on with nearer
    boxes first.
    """
    walk, pool = workspace.candidates.walk, workspace.pool
    x, y, z = tree.x[query], tree.y[query], tree.z[query]
    begin = max(0, min(query - k // 2, tree.rows.size - k))
    for i in range(k):
        pool.distance[i] = point_distance(tree, begin + i, x, y, z)
        pool.at[i] = begin + i
    heapify(pool, k, tree.rows)
    depth = begin_walk(walk, tree)
    while depth > 0:
        depth -= 1
        node, first, leaves = walk.nodes[depth, 0], walk.nodes[depth, 1], walk.nodes[depth, 2]
        if walk.gap[depth] > pool.distance[0]:
            continue
        if leaves > 1 and not is_one_place(tree.boxes, node):
            depth = add_nearer_half_last(walk, depth, tree, node, first, leaves, (x, y, z))
            continue
        first_point = first * LEAF_SIZE
        end = min((first + leaves) * LEAF_SIZE, tree.rows.size)
        if leaves > 1:
            end = min(end, first_point + k)
        for i in range(first_point, end):
            distance = point_distance(tree, i, x, y, z)
            if distance <= pool.distance[0] and not begin <= i < begin + k:
                offer(pool, k, distance, i, tree.rows)
    for j in range(np.uint64(k)):
        workspace.nearest.at[j] = pool.at[j]
    return pool.distance[0]


@compiled
def _gather_around(
    tree: Tree,
    middle: int,
    begin: int,
    end: int,
    k: int,
    squared_reach: float,
    candidates: Candidates,
) -> tuple[int, float]:
    """Take the candidates of some points, from the reach of the one in their middle.

    Returns
    -------
    leaves : int
        How many candidate leaves there are; -1 where they do not fit.
    scale : float
        Scale of their copy, which is relative to the point in the middle.
    """
    x, y, z = tree.x[middle], tree.y[middle], tree.z[middle]
    farthest = 0.0
    low_x, low_y, low_z = high_x, high_y, high_z = x, y, z
    for i in range(np.uint64(begin), np.uint64(end)):
        farthest = max(farthest, point_distance(tree, i, x, y, z))
        low_x, high_x = min(low_x, tree.x[i]), max(high_x, tree.x[i])
        low_y, high_y = min(low_y, tree.y[i]), max(high_y, tree.y[i])
        low_z, high_z = min(low_z, tree.z[i]), max(high_z, tree.z[i])
    low, high = (low_x, low_y, low_z), (high_x, high_y, high_z)
    leaves = gather_candidates(tree, low, high, k, bound_from(squared_reach, farthest), candidates)
    if leaves < 0:
        return leaves, 1.0
    return leaves, copy_candidates(tree, (x, y, z), leaves, candidates)


@inlined
def _gather_places(tree: Tree, query: int, k: int, nearest: Nearest, points: Neighbourhood) -> int:
    """Take the places of the k nearest points relative to the query, each place once.

    They come in an order that follows from the places alone: that of their components in a
    direction of no meaning, which two places hardly ever share, and ties by row number. Only
    points with the same component can share a place, and those are next to each other.
    """
    i = np.uint64(query)
    x, y, z = tree.x[i], tree.y[i], tree.z[i]
    for j in range(np.uint64(k)):
        near = np.uint64(nearest.at[j])
        nearest.measure[j] = (
            (tree.x[near] - x) * _DIRECTION[0] + (tree.y[near] - y) * _DIRECTION[1]
        ) + (tree.z[near] - z) * _DIRECTION[2]
    sort_nearest(nearest, k, tree.rows)
    dx, dy, dz = points.offset
    count = group = np.uint64(0)
    group_measure = np.inf
    for j in range(np.uint64(k)):
        near = np.uint64(nearest.at[j])
        dx[count], dy[count], dz[count] = tree.x[near] - x, tree.y[near] - y, tree.z[near] - z
        if nearest.measure[j] != group_measure:
            group_measure, group = nearest.measure[j], count
        elif _is_among(points, group, count):
            continue
        count += np.uint64(1)
    return int(count)


@inlined
def _is_among(points: Neighbourhood, begin: np.uint64, last: np.uint64) -> bool:
    """Tell whether the last place is one of those before it."""
    dx, dy, dz = points.offset
    for i in range(begin, last):
        if dx[i] == dx[last] and dy[i] == dy[last] and dz[i] == dz[last]:
            return True
    return False


@compiled
def _count_queries(tree: Tree, queries: NDArray[np.bool_], begin: int, end: int) -> int:
    """Count the queries of a leaf; this also fetches their flags from memory, all at once."""
    count = 0
    for i in range(np.uint64(begin), np.uint64(end)):
        count += queries[np.uint64(tree.order[i])]
    return count
