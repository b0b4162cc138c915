"""The innermost loops of the search, written as vector instructions; see `dynahull.kernels.lanes`.

Each is an intrinsic of numba: called from compiled code, it writes its loop there.
"""

from typing import Any

from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from dynahull.kernels.lanes import INDEX, VectorLoop


@intrinsic
def count_up_to(context: Any, values: Any, size: Any, limit: Any) -> Any:
    """Count the values up to and including a limit, among the first ones.

    Parameters
    ----------
    values : float array
    size : uint64
        How many, as many as fill whole vectors.
    """

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
    size : uint64
        How many.
    result : uint32 array
        Overwritten; a vector longer than the boxes.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0][0])
        sides = [loop.data(array) for array in cgutils.unpack_tuple(builder, arguments[0])]
        place = [loop.same(number) for number in cgutils.unpack_tuple(builder, arguments[2])]
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
        Coordinates.
    first : uint64
        Index of the first of the 32.
    distances : float32 array
        Overwritten.
    out : uint64
        From where on.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[4])
        data = [loop.data(array) for array in cgutils.unpack_tuple(builder, arguments[0])]
        place = [loop.same(number) for number in cgutils.unpack_tuple(builder, arguments[2])]
        limits = [loop.same(number) for number in cgutils.unpack_tuple(builder, arguments[3])]
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
    begin : uint64
        Index of the first of the 32.
    limits : tuple of two floats
        Those up to the first go to the first list, others up to the second to the second.
    first : uint64
        Position of the first point; the others follow.
    lists : tuple of two uint32 arrays
        A vector longer than what they are to hold.
    filled : tuple of two uint64
        How much of them is filled.

    Returns
    -------
    tuple of two uint64
        How much is filled now.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0])
        distances, begin, first = loop.data(arguments[0]), arguments[1], arguments[3]
        low, high = (loop.same(number) for number in cgutils.unpack_tuple(builder, arguments[2]))
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
