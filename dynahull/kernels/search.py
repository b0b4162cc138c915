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

The innermost loops are intrinsics of numba (`dynahull.kernels.lanes`): called from compiled code,
each writes its loop of vector instructions there.
"""

from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from dynahull.kernels.decorators import inlined
from dynahull.kernels.lanes import INDEX, VectorLoop
from dynahull.kernels.nearby_leaves import Candidates
from dynahull.kernels.nearest_heap import Nearest, Pool, keep_nearest
from dynahull.kernels.tree import LEAF_SIZE, Tree, point_distance


@intrinsic
def count_up_to(context: Any, values: Any, size: Any, limit: Any) -> Any:
    """Count the values up to and including a limit, among the first `size`: whole vectors."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0])
        data = loop.data(arguments[0])
        limit = loop.same(arguments[2])
        counted = cgutils.alloca_once_value(builder, INDEX(0))

        def body(index: Any) -> None:
            beyond = loop.count(limit < loop.load(data, index))
            more = builder.sub(INDEX(loop.lanes), beyond)
            builder.store(builder.add(builder.load(counted), more), counted)

        loop.run(arguments[1], body)
        return builder.load(counted)

    return types.int64(values, size, limit), generate


@intrinsic
def boxes_within(
    context: Any, boxes: Any, size: Any, place: Any, squared_distance: Any, result: Any
) -> Any:
    """List the boxes within a distance of a place; return how many.

    Parameters
    ----------
    boxes : tuple of six float32 arrays
        Lowest x, y, z and highest x, y, z, as long as whole vectors.
    result : uint32 array
        Overwritten; a vector longer than the boxes.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0][0])
        sides, place = loop.each_data(arguments[0]), loop.each_same(arguments[2])
        size, limit = arguments[1], loop.same(arguments[3])
        result = context.make_array(signature.args[4])(context, builder, arguments[4]).data
        nothing = loop.constant(0.0)
        filled = cgutils.alloca_once_value(builder, INDEX(0))
        builder.store(INDEX(0), filled)

        def body(index: Any) -> None:
            squares = []
            for low, value, high in zip(sides[:3], place, sides[3:], strict=True):
                below, above = loop.load(low, index) - value, value - loop.load(high, index)
                outside = above.where(below < above, below)
                gap = outside.where(nothing < outside, nothing)
                squares.append(gap * gap)
            indices = loop.indices(index)
            beyond = limit < (squares[0] + squares[1]) + squares[2]
            within = builder.and_(builder.not_(beyond), loop.is_before(indices, size))
            builder.store(loop.append(within, indices, result, builder.load(filled)), filled)

        loop.run(size, body)
        return builder.load(filled)

    return types.uint64(boxes, size, place, squared_distance, result), generate


@intrinsic
def measure_leaf(
    context: Any, axes: Any, first: Any, place: Any, limits: Any, distances: Any, out: Any
) -> Any:
    """Compute the squared distances of 32 points from a place; count those up to two limits.

    Parameters
    ----------
    axes : tuple of three float32 arrays
        Coordinates; the 32 begin at `first`.
    distances : float32 array
        Overwritten from `out` on.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[4])
        data, place = loop.each_data(arguments[0]), loop.each_same(arguments[2])
        limits = loop.each_same(arguments[3])
        distances = loop.data(arguments[4])
        counts = [INDEX(0), INDEX(0)]
        for begin in range(0, 32, loop.lanes):
            index = builder.add(arguments[1], INDEX(begin))
            dx, dy, dz = (
                loop.load(axis, index) - value for axis, value in zip(data, place, strict=True)
            )
            distance = (dx * dx + dy * dy) + dz * dz
            loop.store(distance, distances, builder.add(arguments[5], INDEX(begin)))
            for i, limit in enumerate(limits):
                within = builder.not_(limit < distance)
                counts[i] = builder.add(counts[i], loop.count(within))
        return context.make_tuple(builder, signature.return_type, counts)

    result = types.UniTuple(types.int64, 2)
    return result(axes, first, place, limits, distances, out), generate


@intrinsic
def share_out(
    context: Any,
    distances: Any,
    begin: Any,
    limits: Any,
    first: Any,
    lists: Any,
    filled: Any,
) -> Any:
    """Append the positions of the nearer of 32 points to one list, of the next to another.

    Parameters
    ----------
    distances : float32 array
        Those of the 32 begin at `begin`; their positions at `first`.
    limits : tuple of two floats
        Those up to the first go to the first list, others up to the second to the second.
    lists : tuple of two uint32 arrays
        A vector longer than what they are to hold; they are `filled` up to two indices, and
        returned is up to which they are now.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0])
        distances, begin, first = loop.data(arguments[0]), arguments[1], arguments[3]
        low, high = loop.each_same(arguments[2])
        lists = [
            context.make_array(kind)(context, builder, array).data
            for kind, array in zip(
                signature.args[4], cgutils.unpack_tuple(builder, arguments[4]), strict=True
            )
        ]
        filled = cgutils.unpack_tuple(builder, arguments[5])
        for offset in range(0, 32, loop.lanes):
            distance = loop.load(distances, builder.add(begin, INDEX(offset)))
            positions = loop.indices(builder.add(first, INDEX(offset)))
            beyond = low < distance
            nearer = builder.not_(beyond)
            others = builder.and_(beyond, builder.not_(high < distance))
            for i, condition in enumerate((nearer, others)):
                filled[i] = loop.append(condition, positions, lists[i], filled[i])
        return context.make_tuple(builder, signature.return_type, filled)

    result = types.UniTuple(types.uint64, 2)
    return result(distances, begin, limits, first, lists, filled), generate


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
    query, middle : int
        Positions in the tree: of the query, and of the point that candidates are relative to.
    guess : float
        Squared distance at which to begin counting.
    squared_bound : float
        Squared distance within which k candidates are sure to lie.
    scale : float
        Of the candidates, `count` leaves.
    nearest : Nearest
        `at` is overwritten, in no order.
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
    leaves, low_count, high_count = _measure_within(candidates, count, place, low, high)
    if high_count < k:
        low, high = high, limit
        leaves, low_count, high_count = _measure_within(candidates, count, place, low, high)
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
def _measure_within(
    candidates: Candidates,
    count: int,
    place: tuple[np.float32, np.float32, np.float32],
    low: np.float32,
    high: np.float32,
) -> tuple[np.uint64, int, int]:
    """Measure the points of the leaves within the larger of two distances of a query.

    Returns how many leaves these are, and how many of their points are within each distance.
    """
    limit = high + _allowance(high)
    leaves = boxes_within(candidates.boxes, np.uint64(count), place, limit, candidates.near)
    low_count = high_count = 0
    for i in range(leaves):
        within_low, within_high = measure_leaf(
            candidates.points,
            np.uint64(candidates.near[i]) * np.uint64(LEAF_SIZE),
            place,
            (low, high),
            candidates.distance,
            i * np.uint64(LEAF_SIZE),
        )
        low_count += within_low
        high_count += within_high
    return leaves, low_count, high_count


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
