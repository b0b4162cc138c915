"""The innermost loops, written as vector instructions; see `dynahull.kernels.lanes`.

Each is an intrinsic of numba: called from compiled code, it writes its loop there.
"""

from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from dynahull.kernels.lanes import INDEX, Lanes, VectorLoop

INDEX_BITS, ROUGH_INDEX_BITS = 14, 7
"""Lowest bits of a double, and of a single, that tell a point's index where the least is sought."""


@intrinsic
def depths_below(context: Any, axes: Any, size: Any, plane: Any, depths: Any) -> Any:
    """Measure how deep points lie below a plane, and count those at most `least` deep.

    Parameters
    ----------
    axes : tuple of three float32 or float64 arrays
        Coordinates of `size` points.
    plane : tuple of five floats
        The normal, its product with a point of the plane, and `least`.
    depths : float array
        Overwritten.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0][0])
        data, size = loop.each_data(arguments[0]), arguments[1]
        *normal, height, least = loop.each_same(arguments[2])
        depths = loop.data(arguments[3])
        counted = cgutils.alloca_once_value(builder, INDEX(0))

        def body(index: Any) -> None:
            depth = height - _product(normal, [loop.load(array, index) for array in data])
            loop.store(depth, depths, index)
            inside = loop.is_before(loop.indices(index), size)
            # Counted are those not known to be deeper.
            shallow = builder.and_(builder.not_(least < depth), inside)
            builder.store(builder.add(builder.load(counted), loop.count(shallow)), counted)

        loop.run(size, body)
        return builder.load(counted)

    return types.int64(axes, size, plane, depths), generate


def _product(vector: list[Lanes], places: list[Lanes]) -> Lanes:
    """Return the scalar product of a vector and the places of points."""
    x, y, z = (one * other for one, other in zip(vector, places, strict=True))
    return x + y + z


@intrinsic
def point_met(context: Any, axes: Any, depths: Any, size: Any, i: Any, j: Any, inward: Any) -> Any:
    """Return the point that a plane meets when it is turned over the edge from `i` to `j`.

    Of each point, the depth below the plane is known, and its distance from the edge along the
    plane is computed to the same scale; the point met has the largest angle, so the smallest
    cotangent; the first of equals.

    Parameters
    ----------
    axes : tuple of three float32 or float64 arrays
        Coordinates of `size` points, in [-1, 1].
    inward : tuple of four floats
        The direction in the plane away from the edge, and its product with a point of the edge.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0][0])
        tag_bits = INDEX_BITS if loop.bits.width == 64 else ROUGH_INDEX_BITS
        data, depths = loop.each_data(arguments[0]), loop.data(arguments[1])
        size, i, j = arguments[2:5]
        *inward, margin = loop.each_same(arguments[5])
        least_depth, far = loop.constant(1e-30), loop.constant(1e36)
        best = cgutils.alloca_once_value(builder, far.value)

        def body(index: Any) -> None:
            distance = _product(inward, [loop.load(array, index) for array in data]) - margin
            depth = loop.load(depths, index)
            cotangent = distance / depth.where(least_depth < depth, least_depth)
            indices = loop.indices(index)
            of_edge = builder.or_(loop.is_at(indices, i), loop.is_at(indices, j))
            met = builder.and_(loop.is_before(indices, size), builder.not_(of_edge))
            cotangent = loop.tagged(cotangent.where(met, far), indices, tag_bits)
            so_far = Lanes(builder, builder.load(best))
            builder.store(cotangent.where(cotangent < so_far, so_far).value, best)

        loop.run(size, body)
        return loop.tag_of_least(Lanes(builder, builder.load(best)), tag_bits)

    return types.uint64(axes, depths, size, i, j, inward), generate


@intrinsic
def turns(context: Any, axes: Any, size: Any, plane: Any, inward: Any, other_inward: Any) -> Any:
    """Count the points surely below a plane, and find those met turning it over two edges.

    Each point's depth below the plane and its distance from an edge along the plane are computed
    to one scale; the point met has the largest angle, so the smallest cotangent. Only points
    surely below are met.

    Parameters
    ----------
    axes : tuple of three float32 or float64 arrays
        Coordinates in [-1, 1]; the first is NaN from `size` to the end of the last vector.
    plane : tuple of five floats
        The normal, its product with a point of the plane, and the depth beyond which a point is
        surely below.
    inward, other_inward : tuples of four floats
        For each edge the direction in the plane away from it, and its product with a point of it.

    Returns
    -------
    tuple of three integers
        The count, and the two points; these mean nothing where the count is zero.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0][0])
        tag_bits = INDEX_BITS if loop.bits.width == 64 else ROUGH_INDEX_BITS
        data = loop.each_data(arguments[0])
        *normal, height, least = loop.each_same(arguments[2])
        edges = [loop.each_same(argument) for argument in arguments[3:5]]
        far, one = loop.constant(1e36), loop.constant(1.0)
        counted = cgutils.alloca_once_value(builder, INDEX(0))
        builder.store(INDEX(0), counted)
        best = [cgutils.alloca_once_value(builder, far.value) for _ in edges]
        for least_yet in best:
            builder.store(far.value, least_yet)

        def body(index: Any) -> None:
            places = [loop.load(array, index) for array in data]
            depth = height - _product(normal, places)
            below = least < depth
            builder.store(builder.add(builder.load(counted), loop.count(below)), counted)
            reciprocal = one / depth
            indices = loop.indices(index)
            for (*direction, margin), least_yet in zip(edges, best, strict=True):
                distance = _product(direction, places) - margin
                cotangent = (distance * reciprocal).where(below, far)
                cotangent = loop.tagged(cotangent, indices, tag_bits)
                so_far = Lanes(builder, builder.load(least_yet))
                builder.store(cotangent.where(cotangent < so_far, so_far).value, least_yet)

        loop.run(arguments[1], body)
        met = [loop.tag_of_least(Lanes(builder, builder.load(each)), tag_bits) for each in best]
        return context.make_tuple(builder, signature.return_type, [builder.load(counted), *met])

    result = types.Tuple((types.int64, types.uint64, types.uint64))
    return result(axes, size, plane, inward, other_inward), generate


@intrinsic
def rank_all(context: Any, values: Any, size: Any, ranks: Any) -> Any:
    """Count for each of the first values how many of them are smaller.

    Both arrays are as long as whole vectors: float32 values, and uint32 ranks, overwritten.
    """

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0])
        values, size, ranks = loop.data(arguments[0]), arguments[1], arguments[2]
        ranks = context.make_array(signature.args[2])(context, builder, ranks).data
        zeros = ir.Constant(loop.bits_vector, [0] * loop.lanes)
        ones = ir.Constant(loop.bits_vector, [1] * loop.lanes)

        def body(index: Any) -> None:
            ranked = loop.load(values, index)
            counted = cgutils.alloca_once_value(builder, zeros)
            builder.store(zeros, counted)
            with cgutils.for_range(builder, size) as inner:
                other = loop.same(builder.load(builder.gep(values, [inner.index])))
                so_far = builder.load(counted)
                more = builder.add(so_far, ones)
                builder.store(builder.select(other < ranked, more, so_far), counted)
            address = builder.bitcast(builder.gep(ranks, [index]), loop.bits_vector.as_pointer())
            builder.store(builder.load(counted), address, align=4)

        loop.run(size, body)
        return context.get_dummy_value()

    return types.void(values, size, ranks), generate


@intrinsic
def places_up_to(context: Any, values: Any, begin: Any, limit: Any) -> Any:
    """Return which of 32 values are up to and including a limit: the first in the lowest bit."""
    return types.uint64(values, begin, limit), _places(lambda value, limit: limit < value)


@intrinsic
def places_from(context: Any, values: Any, begin: Any, limit: Any) -> Any:
    """Return which of 32 values are at least a limit: the first in the lowest bit."""
    return types.uint64(values, begin, limit), _places(lambda value, limit: value < limit)


def _places(is_out: Callable[[Lanes, Lanes], Any]) -> Callable[..., Any]:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0])
        data, begin, limit = loop.data(arguments[0]), arguments[1], loop.same(arguments[2])
        places = INDEX(0)
        for first in range(0, 32, loop.lanes):
            values = loop.load(data, builder.add(begin, INDEX(first)))
            inside = builder.bitcast(builder.not_(is_out(values, limit)), ir.IntType(loop.lanes))
            inside = builder.shl(builder.zext(inside, INDEX), INDEX(first))
            places = builder.or_(places, inside)
        return places

    return generate


@intrinsic
def lowest_place(context: Any, places: Any) -> Any:
    """Return the place of the lowest bit of an integer that is not zero."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.cttz(arguments[0], ir.IntType(1)(1))

    return types.uint64(types.uint64), generate


@intrinsic
def largest(context: Any, values: Any, size: Any) -> Any:
    """Return the largest of the first values; there is one at least, and none is NaN."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0])
        data = loop.data(arguments[0])
        return _extreme(loop, data, arguments[1], "fmax")

    return values.dtype(values, size), generate


@intrinsic
def extremes(context: Any, values: Any, begin: Any, end: Any) -> Any:
    """Return the smallest and the largest of a range of values, not empty, none of them NaN."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        loop = VectorLoop(context, builder, signature.args[0])
        begin, end = arguments[1:]
        data, size = builder.gep(loop.data(arguments[0]), [begin]), builder.sub(end, begin)
        both = [_extreme(loop, data, size, operation) for operation in ("fmin", "fmax")]
        return context.make_tuple(builder, signature.return_type, both)

    return types.UniTuple(values.dtype, 2)(values, begin, end), generate


def _extreme(loop: VectorLoop, data: Any, size: Any, operation: str) -> Any:
    builder = loop.builder
    first = loop.same(builder.load(data))
    best = cgutils.alloca_once_value(builder, first.value)
    builder.store(first.value, best)

    def body(index: Any) -> None:
        inside = loop.is_before(loop.indices(index), size)
        values = loop.load(data, index).where(inside, first)
        so_far = Lanes(builder, builder.load(best))
        better = values < so_far if operation == "fmin" else so_far < values
        builder.store(values.where(better, so_far).value, best)

    loop.run(size, body)
    return loop.reduced(Lanes(builder, builder.load(best)), operation)
