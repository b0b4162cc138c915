"""The tree of an E57 file: how it is opened, looked into and copied.

libE57 (through pye57's bindings) reads and writes every node; what is known of E57 is from ASTM
E2807 and from libE57's headers.
"""

import errno
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib import import_module
from os import fsencode
from pathlib import Path
from typing import Any

import numpy as np

from tiling.errors import MapFormatError

DROPPED = "pointGroupingSchemes"
"""Groups of points by line, which count points that an output has no longer."""

_BLOCK = 1 << 20


def library(path: Path) -> Any:
    """Return libE57's bindings; a `MapFormatError` of a file says that they are not installed."""
    try:
        return import_module("pye57.libe57")
    except ImportError:
        expected = "pye57, which reads E57 (pip install 'dynahull-pipeline[e57]')"
        raise MapFormatError(path, expected, "it not installed") from None


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """Open a file for reading, and turn what is wrong with it into a `MapFormatError`."""
    e57 = library(path)
    try:
        image = e57.ImageFile(fsencode(path), "r")
        try:
            yield image
        finally:
            image.close()
    except (e57.E57Exception, RuntimeError, ValueError, TypeError, MemoryError) as error:
        found = _reason(error)
        raise MapFormatError(path, "a whole E57 file", found) from error


def node(any_node: Any) -> Any:
    """Return a node as what it is."""
    e57: Any = import_module("pye57.libe57")
    if not isinstance(any_node, e57.Node):
        return any_node
    # One of type E57_COMPRESSED_VECTOR is a CompressedVectorNode, and so on.
    kind = any_node.type().name.removeprefix("E57_").title().replace("_", "")
    return getattr(e57, f"{kind}Node")(any_node)


def children(parent: Any) -> Iterator[Any]:
    """Yield the nodes of a structure or a vector."""
    for number in range(parent.childCount()):
        yield node(parent.get(number))


def member(structure: Any, *names: str) -> Any:
    """Return a node below a structure, None if it is not there."""
    for name in names:
        if structure is None or not structure.isDefined(name):
            return None
        structure = node(structure.get(name))
    return structure


def number(structure: Any, *names: str) -> float | None:
    """Return the value of a number below a structure, None if it is not there."""
    found = member(structure, *names)
    if found is None:
        return None
    return float(found.scaledValue() if hasattr(found, "scaledValue") else found.value())


def copy_tree(source: Any, target: Any) -> None:
    """Copy all of an open file into one that is open for writing, but for the points themselves."""
    for each in range(source.extensionsCount()):
        target.extensionsAdd(source.extensionsPrefix(each), source.extensionsUri(each))
    _copy_children(source.root(), target.root(), target)


def _copy_children(source: Any, parent: Any, target: Any) -> None:
    for child in children(source):
        name = child.elementName()
        if name == DROPPED:
            continue
        copied = _copied(child, target)
        if hasattr(parent, "append"):
            parent.append(copied)
        else:
            parent.set(name, copied)
        if hasattr(child, "append") or hasattr(child, "set"):
            _copy_children(child, copied, target)
        elif hasattr(child, "byteCount"):
            _copy_bytes(child, copied)


def _copied(source: Any, target: Any) -> Any:
    """Return a copy of a node without what is below it; of points, one that has none."""
    e57: Any = import_module("pye57.libe57")

    def made_of(node_of_parts: Any, parts: Any) -> Any:
        _copy_children(node(node_of_parts), parts, target)
        return parts

    arguments: dict[Any, Callable[[Any], tuple[Any, ...]]] = {
        e57.StructureNode: lambda _: (),
        e57.VectorNode: lambda each: (each.allowHeteroChildren(),),
        e57.IntegerNode: lambda each: (each.value(), each.minimum(), each.maximum()),
        e57.ScaledIntegerNode: lambda each: (
            *map(int, (each.rawValue(), each.minimum(), each.maximum())),
            *map(float, (each.scale(), each.offset())),
        ),
        e57.FloatNode: lambda of: (of.value(), of.precision(), of.minimum(), of.maximum()),
        e57.StringNode: lambda each: (each.value(),),
        e57.BlobNode: lambda each: (each.byteCount(),),
        e57.CompressedVectorNode: lambda each: (
            made_of(each.prototype(), e57.StructureNode(target)),
            made_of(each.codecs(), e57.VectorNode(target, True)),
        ),
    }
    kind = type(source)
    return kind(target, *arguments[kind](source))


def _copy_bytes(source: Any, target: Any) -> None:
    size = source.byteCount()
    for start in range(0, size, _BLOCK):
        block = np.empty(min(_BLOCK, size - start), np.uint8)
        source.read(block, start, len(block))
        target.write(block, start, len(block))


@contextmanager
def write_errors(path: Path) -> Iterator[None]:
    """Turn what libE57 says when it cannot write into an `OSError`."""
    e57: Any = import_module("pye57.libe57")
    try:
        yield
    except e57.E57Exception as error:
        raise OSError(errno.EIO, f"cannot be written: {_reason(error)}", str(path)) from error


def _reason(error: Exception) -> str:
    """Return what libE57 says, without where in its code it says so."""
    return " ".join(str(error).split("****")[0].split())[:120] or type(error).__name__
