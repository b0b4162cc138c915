"""From points to densities without ever holding all neighbours: leaf by leaf, query by query.

These two functions are all that is compiled ahead; everything else is inlined into them.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dynahull.kernels.candidates import (
    Candidates,
    bound_from,
    gather_candidates,
    make_candidates,
    search_list,
)
from dynahull.kernels.compiled import compiled, inlined
from dynahull.kernels.frame import Neighbourhood, make_neighbourhood
from dynahull.kernels.growth import Growth, grow_tree
from dynahull.kernels.hull import Surface, hull_volume, make_surface
from dynahull.kernels.nearest import Nearest, keep_nearest, make_nearest, sort_nearest
from dynahull.kernels.tree import LEAF_SIZE, Tree, middle_of_leaf, point_distance
from dynahull.kernels.walk import search_tree

_DIRECTION = (0.6180339887498949, 0.7548776662466927, 0.2192059139)
"""Hardly ever the same component for two places of a lattice that maps are quantised on."""

_LONGEST_PAUSE = 63


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


def grow(tree: Tree, rows: NDArray[np.int64], growth: Growth) -> None:
    """Put points into kd-tree order, in place, and measure the boxes."""
    grow_tree(tree, rows, growth)


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
    nearest, points, surface = room.nearest, room.points, room.surface
    density, neighbours = results.density, results.neighbours
    waiting, pause = 0, 0
    for leaf in range(first_leaf, end_leaf):
        begin, end = leaf * LEAF_SIZE, min((leaf + 1) * LEAF_SIZE, tree.rows.size)
        if not _any_query(tree, queries, begin, end):
            continue
        middle = middle_of_leaf(tree, leaf)
        reach = _reach_of_middle(tree, leaf, middle, k, room)
        leaves = _gather_around(tree, leaf, middle, k, reach, room.candidates)
        guess = reach
        for i in range(begin, end):
            at = np.uint64(tree.order[i])
            if not queries[at]:
                continue
            x, y, z = tree.x[i], tree.y[i], tree.z[i]
            if leaves < 0:
                _search_around(tree, i, k, room)
                found = k
            else:
                bound = bound_from(reach, point_distance(tree, middle, x, y, z))
                found = search_list(
                    tree, x, y, z, k, guess, bound, room.candidates, leaves, nearest
                )
            guess = keep_nearest(nearest, found, k, tree.rows)
            results.squared_reach[at] = guess
            if neighbours.size:
                for j in range(np.uint64(k)):
                    nearest.measure[j] = nearest.distance[j]
                sort_nearest(nearest, k, tree.rows)
                for j in range(k):
                    neighbours[at, j] = tree.rows[nearest.at[j]]
            if density.size:
                places = _gather_places(tree, i, k, nearest, points)
                volume, rough = hull_volume(points, places, surface, waiting == 0)
                waiting, pause = _pauses(waiting, pause, rough)
                density[at] = np.inf if volume == 0.0 else k / volume


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
def _reach_of_middle(tree: Tree, leaf: int, middle: int, k: int, room: Room) -> float:
    """Return the squared distance of the k-th neighbour of the point in the middle of a leaf.

    It lies within the farthest of the k points around it in the order of the tree.
    """
    x, y, z = tree.x[middle], tree.y[middle], tree.z[middle]
    begin = max(0, min(middle - k // 2, tree.rows.size - k))
    bound = 0.0
    for i in range(np.uint64(begin), np.uint64(begin + k)):
        bound = max(bound, point_distance(tree, i, x, y, z))
    leaves = gather_candidates(tree, leaf, k, bound, room.candidates)
    if leaves < 0:
        return _search_around(tree, middle, k, room)
    found = search_list(tree, x, y, z, k, bound, bound, room.candidates, leaves, room.nearest)
    return keep_nearest(room.nearest, found, k, tree.rows)


@compiled
def _search_around(tree: Tree, i: int, k: int, room: Room) -> float:
    """Walk the tree for the k nearest points of a point; return the squared distance of the k-th.

    The walk begins with the k points around it in the order of the tree.
    """
    x, y, z = tree.x[i], tree.y[i], tree.z[i]
    search_tree(tree, x, y, z, k, i - k // 2, room.candidates, room.nearest)
    return room.nearest.distance[0]


@compiled
def _gather_around(
    tree: Tree, leaf: int, middle: int, k: int, squared_reach: float, candidates: Candidates
) -> int:
    """List the candidates of a leaf from the reach of the point in its middle."""
    farthest = 0.0
    for i in range(leaf * LEAF_SIZE, min((leaf + 1) * LEAF_SIZE, tree.rows.size)):
        away = point_distance(tree, i, tree.x[middle], tree.y[middle], tree.z[middle])
        farthest = max(farthest, away)
    return gather_candidates(tree, leaf, k, bound_from(squared_reach, farthest), candidates)


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
    count = group = np.uint64(0)
    group_measure = np.inf
    for j in range(np.uint64(k)):
        near = np.uint64(nearest.at[j])
        points.dx[count] = tree.x[near] - x
        points.dy[count] = tree.y[near] - y
        points.dz[count] = tree.z[near] - z
        if nearest.measure[j] != group_measure:
            group_measure, group = nearest.measure[j], count
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
