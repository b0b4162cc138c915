"""Name and units in the well-known text of a coordinate reference system, OGC 1 and 2, and Esri's.

Text is looked into as far as these need. What makes no sense has none, and stops no map.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from tiling.formats.units import DEGREE, Unit, Units, length

_TOKEN = re.compile(r'"(?:[^"]|"")*"|[\[\](),]|[^\s,\[\]()"]+')
_DEEPEST = 32

_COMPOUND = {"COMPD_CS", "COMPOUNDCRS"}
_BOUND = {"BOUNDCRS", "SOURCECRS"}
_VERTICAL = {"VERT_CS", "VERTCS", "VERTCRS", "VERTICALCRS"}
_LINEAR = {"PROJCS", "PROJCRS", "PROJECTEDCRS", "GEOCCS", "LOCAL_CS", "ENGCRS", "ENGINEERINGCRS"}
_GEODETIC = {"GEOGCS", "GEOGCRS", "GEOGRAPHICCRS", "GEODCRS", "GEODETICCRS"}
_ANGLES = ("degree", "radian", "grad", "gon", "minute", "second")


@dataclass(slots=True)
class _Node:
    """A keyword with what is in its brackets."""

    keyword: str
    values: list[str] = field(default_factory=list)
    nodes: list["_Node"] = field(default_factory=list)

    def of(self, keywords: set[str]) -> list["_Node"]:
        return [node for node in self.nodes if node.keyword in keywords]


def name_in_wkt(text: str) -> str | None:
    """Return the code of the outermost authority, or the name of the outermost system."""
    for node in _parsed(text)[:1]:
        for authority in reversed(node.of({"AUTHORITY", "ID"})):
            if len(authority.values) > 1:
                return ":".join(authority.values[:2])
        return node.values[0] if node.values else None
    return None


def units_in_wkt(text: str) -> Units | None:
    """Return the units of the outermost system, None where there are none to be found."""
    horizontal, vertical = None, None
    for node in _systems(_parsed(text)):
        if node.keyword in _VERTICAL:
            vertical = vertical or _unit_of(node, 0)
        elif horizontal is None:
            horizontal, height = _horizontal(node)
            vertical = vertical or height
    return Units(horizontal, vertical) if horizontal or vertical else None


def _systems(nodes: list[_Node]) -> Iterator[_Node]:
    """Yield the single systems of which one is made, each before those within it."""
    for node in nodes:
        if node.keyword in _COMPOUND | _BOUND:
            yield from _systems(node.nodes)
        elif node.keyword in _LINEAR | _GEODETIC | _VERTICAL:
            yield node
            yield from node.of(_VERTICAL)  # Esri's, within the projected one


def _horizontal(node: _Node) -> tuple[Unit | None, Unit | None]:
    """Return the units of the first and of the third axis of a system."""
    kinds = [value.lower() for cs in node.of({"CS"}) for value in cs.values[:1]]
    if node.keyword in _GEODETIC and "cartesian" not in kinds:
        return DEGREE, None
    return _unit_of(node, 0), _unit_of(node, 2)


def _unit_of(node: _Node, axis: int) -> Unit | None:
    """Return the unit of an axis: its own, or that of all."""
    axes = node.of({"AXIS"})
    own = _units(axes[axis]) if axis < len(axes) else []
    found = [*own, *(_units(node) if axis == 0 else [])]
    return found[0] if found else None


def _units(node: _Node) -> list[Unit]:
    found = []
    for unit in node.of({"UNIT", "LENGTHUNIT", "ANGLEUNIT"}):
        name = unit.values[0] if unit.values else ""
        if unit.keyword == "ANGLEUNIT" or any(word in name.lower() for word in _ANGLES):
            found.append(DEGREE)
            continue
        try:
            metres = float(unit.values[1])
        except (IndexError, ValueError):
            metres = 0.0
        known = length(name, metres)
        found += [known] if known else []
    return found


def _parsed(text: str) -> list[_Node]:
    """Return the outermost nodes; those that are not closed are left out."""
    outside = _Node("")
    open_nodes, word = [outside], ""
    for match in _TOKEN.finditer(text):
        token = match.group()
        if token in "[(":
            if len(open_nodes) > _DEEPEST:
                return []
            open_nodes.append(_Node(word.upper()))
            word = ""
        elif token in "]),":
            if word:
                open_nodes[-1].values.append(word)
                word = ""
            if token != "," and len(open_nodes) > 1:
                closed = open_nodes.pop()
                open_nodes[-1].nodes.append(closed)
        else:
            word = token[1:-1].replace('""', '"') if token.startswith('"') else token
    return outside.nodes
