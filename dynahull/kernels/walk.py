"""The k nearest points of one query, by walking the tree."""

from dynahull.kernels.candidates import Candidates
from dynahull.kernels.compiled import compiled
from dynahull.kernels.nearest import Pool, heapify, offer
from dynahull.kernels.tree import (
    LEAF_SIZE,
    Tree,
    box_to_point,
    is_one_place,
    leaf_count,
    point_distance,
)


@compiled
def search_tree(
    tree: Tree,
    x: float,
    y: float,
    z: float,
    k: int,
    start: int,
    candidates: Candidates,
    pool: Pool,
) -> int:
    """Find the k nearest points of a query by walking the tree, nearer boxes first.

    Begins with the points from position `start` on, which should be near. Returns k.
    """
    begin = max(0, min(start, tree.rows.size - k))
    for i in range(k):
        pool.distance[i] = point_distance(tree, begin + i, x, y, z)
        pool.at[i] = begin + i
    heapify(pool, k, tree.rows)
    stack, gap = candidates.stack, candidates.stack_gap
    stack[0, 0], stack[0, 1], stack[0, 2], gap[0] = 0, 0, leaf_count(tree.rows.size), 0.0
    depth = 1
    while depth > 0:
        depth -= 1
        node, first, leaves = stack[depth, 0], stack[depth, 1], stack[depth, 2]
        if gap[depth] > pool.distance[0]:
            continue
        if leaves > 1 and not is_one_place(tree.boxes, node):
            left = (leaves + 1) // 2
            near_gap = box_to_point(tree.boxes, node + 1, x, y, z)
            far_gap = box_to_point(tree.boxes, node + 2 * left, x, y, z)
            far_first = 0 if near_gap > far_gap else 1
            right_at, left_at = depth + 1 - far_first, depth + far_first
            stack[right_at, 0], stack[right_at, 1] = node + 2 * left, first + left
            stack[right_at, 2], gap[right_at] = leaves - left, far_gap
            stack[left_at, 0], stack[left_at, 1] = node + 1, first
            stack[left_at, 2], gap[left_at] = left, near_gap
            depth += 2
            continue
        first_point = first * LEAF_SIZE
        end = min((first + leaves) * LEAF_SIZE, tree.rows.size)
        if leaves > 1:
            end = min(end, first_point + k)
        for i in range(first_point, end):
            distance = point_distance(tree, i, x, y, z)
            if distance <= pool.distance[0] and not begin <= i < begin + k:
                offer(pool, k, distance, i, tree.rows)
    return k
