"""Expressions over vectors, from which the innermost loops are written.

A neighbourhood is a handful of vectors long. Loops that a compiler turns into vectors by itself
are unrolled for long arrays, and spend most of so short a one before and after the vectors. Those
of `dynahull.kernels.vectors` are written out for LLVM, as expressions over `Lanes`: 64 bytes of an
array at a time, which machines with shorter registers do in halves or quarters, with the same
bits.
"""

from collections.abc import Callable
from typing import Any, Self

import numpy as np
from llvmlite import ir
from numba.core import cgutils
from numpy.typing import NDArray

VECTOR_BYTES = 64
LANES = VECTOR_BYTES // 4  # of single precision

INDEX = ir.IntType(64)


def padded(count: int) -> int:
    """Return a length of arrays that holds so many numbers in whole vectors."""
    return (count + LANES - 1) // LANES * LANES


def aligned(size: int, dtype: Any = np.float64) -> NDArray[Any]:
    """Return an array of zeros whose first element begins a vector."""
    bytes_wanted = size * np.dtype(dtype).itemsize
    room = np.zeros(bytes_wanted + VECTOR_BYTES, np.uint8)
    begin = -room.ctypes.data % VECTOR_BYTES
    return room[begin : begin + bytes_wanted].view(dtype)


class Lanes:
    """The lanes of one vector, or one number in all of them, as an expression."""

    def __init__(self, builder: Any, value: Any) -> None:
        self.builder = builder
        self.value = value

    def __add__(self, other: Self) -> "Lanes":
        return Lanes(self.builder, self.builder.fadd(self.value, other.value))

    def __sub__(self, other: Self) -> "Lanes":
        return Lanes(self.builder, self.builder.fsub(self.value, other.value))

    def __mul__(self, other: Self) -> "Lanes":
        return Lanes(self.builder, self.builder.fmul(self.value, other.value))

    def __truediv__(self, other: Self) -> "Lanes":
        return Lanes(self.builder, self.builder.fdiv(self.value, other.value))

    def __lt__(self, other: Self) -> Any:
        return self.builder.fcmp_ordered("<", self.value, other.value)

    def where(self, condition: Any, other: Self) -> "Lanes":
        """Take these lanes where a condition holds, and others elsewhere."""
        return Lanes(self.builder, self.builder.select(condition, self.value, other.value))


class VectorLoop:
    """A loop over arrays of one type, `VECTOR_BYTES` at a time.

    Parameters
    ----------
    context, builder
        Of numba, where an intrinsic writes its code.
    array_type
        Numba's type of the arrays.
    """

    def __init__(self, context: Any, builder: Any, array_type: Any) -> None:
        self.context = context
        self.builder = builder
        self.array_type = array_type
        self.number = context.get_value_type(array_type.dtype)
        self.lanes = VECTOR_BYTES * 8 // array_type.dtype.bitwidth
        self.vector = ir.VectorType(self.number, self.lanes)
        self.bits = ir.IntType(array_type.dtype.bitwidth)
        self.bits_vector = ir.VectorType(self.bits, self.lanes)

    def run(self, size: Any, body: Callable[[Any], None]) -> None:
        """Write `body(index)` for the first index of every vector of arrays of a size."""
        step = INDEX(self.lanes)
        with cgutils.for_range_slice(self.builder, INDEX(0), size, step) as (index, _):
            body(index)

    def data(self, array: Any) -> Any:
        """Return the address of an array's first element."""
        return self.context.make_array(self.array_type)(self.context, self.builder, array).data

    def each_data(self, arrays: Any) -> list[Any]:
        """Return the addresses of a tuple of arrays."""
        return [self.data(array) for array in cgutils.unpack_tuple(self.builder, arrays)]

    def each_same(self, numbers: Any) -> list[Lanes]:
        """Put each number of a tuple into all lanes of a vector."""
        return [self.same(number) for number in cgutils.unpack_tuple(self.builder, numbers)]

    def load(self, data: Any, index: Any) -> Lanes:
        """Read the vector at an index."""
        address = self.builder.bitcast(self.builder.gep(data, [index]), self.vector.as_pointer())
        return Lanes(
            self.builder, self.builder.load(address, align=self.array_type.dtype.bitwidth // 8)
        )

    def store(self, lanes: Lanes, data: Any, index: Any) -> None:
        """Write the vector at an index."""
        address = self.builder.bitcast(self.builder.gep(data, [index]), self.vector.as_pointer())
        self.builder.store(lanes.value, address, align=self.array_type.dtype.bitwidth // 8)

    def same(self, value: Any) -> Lanes:
        """Put one number into all lanes, rounded to what they hold."""
        if value.type != self.number:
            value = self.builder.fptrunc(value, self.number)
        return Lanes(self.builder, self._spread(value, self.vector))

    def constant(self, value: float) -> Lanes:
        """Put a constant into all lanes."""
        return Lanes(self.builder, ir.Constant(self.vector, [value] * self.lanes))

    def indices(self, index: Any) -> Any:
        """Return the index of each lane, as integers as wide as the numbers."""
        first = self.builder.trunc(index, self.bits) if self.bits.width < 64 else index
        counting = ir.Constant(self.bits_vector, list(range(self.lanes)))
        return self.builder.add(self._spread(first, self.bits_vector), counting)

    def is_at(self, indices: Any, index: Any) -> Any:
        """Tell which lanes have an index."""
        wanted = self.builder.trunc(index, self.bits) if self.bits.width < 64 else index
        return self.builder.icmp_unsigned("==", indices, self._spread(wanted, self.bits_vector))

    def is_before(self, indices: Any, end: Any) -> Any:
        """Tell which lanes have an index below an end: the last vector may go beyond it."""
        end = self.builder.trunc(end, self.bits) if self.bits.width < 64 else end
        return self.builder.icmp_signed("<", indices, self._spread(end, self.bits_vector))

    def tagged(self, lanes: Lanes, indices: Any, tag_bits: int) -> Lanes:
        """Put the indices into the lowest bits of the numbers."""
        builder = self.builder
        keep = ir.Constant(self.bits_vector, [-(2**tag_bits)] * self.lanes)
        bits = builder.and_(builder.bitcast(lanes.value, self.bits_vector), keep)
        return Lanes(builder, builder.bitcast(builder.or_(bits, indices), self.vector))

    def reduced(self, lanes: Lanes, operation: str) -> Any:
        """Return the smallest (`fmin`) or largest (`fmax`) of the numbers, none of them NaN."""
        reduce = cgutils.get_or_insert_function(
            self.builder.module,
            ir.FunctionType(self.number, [self.vector]),
            f"llvm.vector.reduce.{operation}.v{self.lanes}f{self.bits.width}",
        )
        return self.builder.call(reduce, [lanes.value], fastmath=("nnan", "nsz"))

    def tag_of_least(self, lanes: Lanes, tag_bits: int) -> Any:
        """Return the tag of the smallest number."""
        builder = self.builder
        bits = builder.bitcast(self.reduced(lanes, "fmin"), self.bits)
        bits = builder.zext(bits, INDEX) if self.bits.width < 64 else bits
        return builder.and_(bits, INDEX(2**tag_bits - 1))

    def count(self, condition: Any) -> Any:
        """Count the lanes for which a condition holds."""
        mask = self.builder.bitcast(condition, ir.IntType(self.lanes))
        return self.builder.zext(self.builder.ctpop(mask), INDEX)

    def append(self, condition: Any, integers: Any, data: Any, filled: Any) -> Any:
        """Write the integers of the lanes for which a condition holds, side by side.

        A whole vector is written, the rest of it without meaning. Returns the next index to fill.
        """
        builder = self.builder
        compress = cgutils.get_or_insert_function(
            builder.module,
            ir.FunctionType(self.bits_vector, [self.bits_vector, condition.type, self.bits_vector]),
            f"llvm.experimental.vector.compress.v{self.lanes}i{self.bits.width}",
        )
        rest = ir.Constant(self.bits_vector, ir.Undefined)
        chosen = builder.call(compress, [integers, condition, rest])
        address = builder.bitcast(builder.gep(data, [filled]), self.bits_vector.as_pointer())
        builder.store(chosen, address, align=self.bits.width // 8)
        return builder.add(filled, self.count(condition))

    def _spread(self, value: Any, vector: Any) -> Any:
        undefined = ir.Constant(vector, ir.Undefined)
        first = self.builder.insert_element(undefined, value, ir.IntType(32)(0))
        everywhere = ir.Constant(ir.VectorType(ir.IntType(32), self.lanes), [0] * self.lanes)
        return self.builder.shuffle_vector(first, undefined, everywhere)
