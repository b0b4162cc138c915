"""From points to densities without ever holding all neighbours: leaf by leaf, query by query.

These two functions are all that is compiled ahead; everything else is inlined into them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.compiled import compiled, inlined
from dynahull.kernels.frame import Neighbourhood, make_neighbourhood
from dynahull.kernels.hull import Surface, hull_volume, make_surface
from dynahull.kernels.neighbours import (
    Candidates,
    Nearest,
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


class Room(NamedTuple):
    """Room for one thread's work on neighbourhoods of at most k points."""

    candidates: Candidates
    nearest: Nearest
    points: Neighbourhood
    surface: Surface


class Results(NamedTuple):
    """What is known of every point, in the order of the input.

    Attributes
    ----------
    density : (n,) or (0,) float64 array
        k / volume; infinite where flat, NaN where no wrapping was certified. Not computed where
        empty.
    squared_reach : (n,) float64 array
        Squared distance of the k-th neighbour.
    neighbours : (n, k) or (0, 0) int64 array
        The neighbours' row numbers, in order; not written where empty.
    """

    density: NDArray[np.float64]
    squared_reach: NDArray[np.float64]
    neighbours: NDArray[np.int64]


def make_room(k: int) -> Room:
    """Make room for one thread."""
    return Room(make_candidates(k), make_nearest(k), make_neighbourhood(k), make_surface(k))


def grow(tree: Tree, stack: NDArray[np.int64]) -> None:
    """Put points into kd-tree order, in place, and measure the boxes."""
    grow_tree(tree, stack)


def solve(
    tree: Tree,
    k: int,
    first_leaf: int,
    end_leaf: int,
    queries: NDArray[np.bool_],
    room: Room,
    results: Results,
) -> None:
    """Solve the queries of some leaves.

    Parameters
    ----------
    tree : Tree
        Grown.
    k : int
        Neighbours, at most the number of points.
    first_leaf, end_leaf : int
        Which leaves.
    queries : (n,) bool array
        Which points, in the order of the input.
    room : Room
        Made for k.
    results : Results
        Written for the queries of these leaves.
    """
    x, y, z, rows, order = tree.x, tree.y, tree.z, tree.rows, tree.order
    candidates, nearest, points, surface = room.candidates, room.nearest, room.points, room.surface
    density, squared_reach, neighbours = results.density, results.squared_reach, results.neighbours
    rough = True
    for leaf in range(first_leaf, end_leaf):
        begin, end = leaf * LEAF_SIZE, min((leaf + 1) * LEAF_SIZE, rows.size)
        if not _any_query(tree, queries, begin, end):
            continue
        middle = middle_of_leaf(tree, leaf)
        search_tree(tree, x[middle], y[middle], z[middle], k, begin - k // 2, candidates, nearest)
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
                found = search_tree(tree, x[i], y[i], z[i], k, i - k // 2, candidates, nearest)
            else:
                away = point_distance(tree, i, x[middle], y[middle], z[middle])
                found = search_list(
                    tree,
                    x[i],
                    y[i],
                    z[i],
                    k,
                    guess,
                    bound_from(middle_reach, away),
                    candidates,
                    count,
                    nearest,
                )
            sort_nearest(nearest, found, rows)
            guess = nearest.distance[k - 1]
            squared_reach[at] = guess
            if neighbours.size:
                for j in range(k):
                    neighbours[at, j] = rows[nearest.at[j]]
            if density.size:
                places = _gather_places(tree, i, k, nearest, points)
                volume, rough = hull_volume(points, places, surface, rough)
                density[at] = np.inf if volume == 0.0 else k / volume


@inlined
def _gather_places(tree: Tree, query: int, k: int, nearest: Nearest, points: Neighbourhood) -> int:
    """Take the places of the k nearest points relative to the query, each place once.

    Only points at the same distance can share a place, and those are next to each other.
    """
    i = np.uint64(query)
    count = group = np.uint64(0)
    group_distance = -1.0
    for j in range(np.uint64(k)):
        near = np.uint64(nearest.at[j])
        points.dx[count] = tree.x[near] - tree.x[i]
        points.dy[count] = tree.y[near] - tree.y[i]
        points.dz[count] = tree.z[near] - tree.z[i]
        if nearest.distance[j] != group_distance:
            group_distance, group = nearest.distance[j], count
        elif _is_among(points, group, count):
            continue
        count += np.uint64(1)
    return int(count)


@inlined
def _is_among(points: Neighbourhood, begin: np.uint64, last: np.uint64) -> bool:
    """Tell whether the last place is one of those before it."""
    for i in range(begin, last):
        if (
            points.dx[i] == points.dx[last]
            and points.dy[i] == points.dy[last]
            and points.dz[i] == points.dz[last]
        ):
            return True
    return False


@compiled
def _any_query(tree: Tree, queries: NDArray[np.bool_], begin: int, end: int) -> bool:
    for i in range(begin, end):  # noqa: SIM110 (compiled code has no generators)
        if queries[np.uint64(tree.order[i])]:
            return True
    return False
