"""Structures in Thrift's compact protocol, which Parquet files describe themselves in.

The protocol is that of https://github.com/apache/thrift/blob/master/doc/specs/
thrift-compact-protocol.md. Nothing is allocated by a size that is only claimed.
"""

from typing import Any

Structure = dict[int, Any]
"""Fields by their numbers; a structure is a dictionary again, a list a list, a text bytes."""

_TRUE, _FALSE, _BYTE, _DOUBLE, _TEXT, _LIST, _SET, _MAP, _STRUCT = 1, 2, 3, 7, 8, 9, 10, 11, 12
_INTEGERS = (4, 5, 6)
_DEEPEST = 24
_MOST_BITS = 70


class ThriftError(ValueError):
    """Bytes are no such structure; `is_short` where they may only be too few."""

    def __init__(self, message: str, is_short: bool = False) -> None:
        super().__init__(message)
        self.is_short = is_short


def read_structure(data: bytes) -> tuple[Structure, int]:
    """Read the structure that some bytes begin with; return it and its size.

    Raises
    ------
    ThriftError
        When there is none, or its end is not there.
    """
    reader = _Reader(data)
    return reader.structure(_DEEPEST), reader.at


class _Reader:
    """Reads values one after the other."""

    def __init__(self, data: bytes) -> None:
        self.at = 0
        self._data = data

    def structure(self, depth: int) -> Structure:
        if not depth:
            raise ThriftError("structures too deep within each other")
        fields: Structure = {}
        number = 0
        while (head := self._byte()) != 0:
            number = number + (head >> 4) if head >> 4 else self._integer()
            kind = head & 15
            if kind in (_TRUE, _FALSE):
                fields[number] = kind == _TRUE
            else:
                fields[number] = self._value(kind, depth - 1)
        return fields

    def _value(self, kind: int, depth: int) -> Any:
        if kind in _INTEGERS:
            return self._integer()
        if kind in (_BYTE, _TRUE, _FALSE):
            return self._byte()
        if kind in (_DOUBLE, _TEXT):
            return self._take(8 if kind == _DOUBLE else self._count())
        if kind in (_LIST, _SET):
            return self._list(depth)
        if kind not in (_MAP, _STRUCT):
            raise ThriftError(f"a value of the unknown type {kind}")
        return self._map(depth) if kind == _MAP else self.structure(depth)

    def _list(self, depth: int) -> list[Any]:
        if not depth:
            raise ThriftError("lists too deep within each other")
        head = self._byte()
        size = head >> 4 if head >> 4 < 15 else self._count()
        return [self._value(head & 15, depth - 1) for _ in range(size)]

    def _map(self, depth: int) -> list[tuple[Any, Any]]:
        size = self._count()
        if not size or not depth:
            return []
        kinds = self._byte()
        key, value = kinds >> 4, kinds & 15
        return [(self._value(key, depth - 1), self._value(value, depth - 1)) for _ in range(size)]

    def _byte(self) -> int:
        if self.at >= len(self._data):
            raise ThriftError("their end", is_short=True)
        self.at += 1
        return self._data[self.at - 1]

    def _take(self, size: int) -> bytes:
        if self.at + size > len(self._data):
            raise ThriftError("their end", is_short=True)
        self.at += size
        return self._data[self.at - size : self.at]

    def _count(self) -> int:
        """Read a number without a sign."""
        value = shift = 0
        while True:
            byte = self._byte()
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                return value
            if shift > _MOST_BITS:
                raise ThriftError("a number of too many bytes")

    def _integer(self) -> int:
        """Read a number whose sign is its last bit."""
        value = self._count()
        return (value >> 1) ^ -(value & 1)
