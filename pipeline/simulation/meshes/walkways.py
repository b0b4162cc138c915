"""Where one can walk: a lattice over the floors, without what stands there, and ways through it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.spatial import cKDTree

from pipeline.simulation.meshes.raycasting import Caster
from pipeline.simulation.meshes.stage import Floor, Stage
from pipeline.simulation.tables import Floats, Random

_HEIGHTS = (0.4, 0.95, 1.5)
CLEARANCE = 0.34
_UNDERFOOT = 0.1  # metres from a node to the ground that carries it
_STEPS = ((1, 0), (0, 1), (1, 1), (1, -1))


@dataclass(frozen=True, slots=True)
class Walkways:
    """Nodes that can be reached from each other."""

    nodes: Floats  # (n, 3), on the ground
    room: Floats  # (n,), metres to the nearest thing
    graph: csr_matrix  # lengths between neighbours, longer where it is narrow

    @classmethod
    def of(cls, stage: Stage, caster: Caster, spacing: float = 0.35) -> "Walkways":
        """Lay the lattice, and keep its largest part that hangs together."""
        nodes, rooms, pairs, start = [], [], [], 0
        for floor in stage.floors:
            free, around, joined = _lattice(floor, caster, spacing)
            nodes.append(free)
            rooms.append(around)
            pairs.append(joined + start)
            start += len(free)
        for line in stage.links:
            tree = cKDTree(np.concatenate(nodes))
            first, last = (int(tree.query(end)[1]) for end in line[[0, -1]])
            chain = np.concatenate([[first], start + np.arange(len(line)), [last]])
            nodes.append(line)
            rooms.append(np.full(len(line), CLEARANCE + 0.1))
            pairs.append(np.stack([chain[:-1], chain[1:]], axis=1))
            start += len(line)
        places, room, ends = np.concatenate(nodes), np.concatenate(rooms), np.concatenate(pairs)
        length = np.linalg.norm(places[ends[:, 0]] - places[ends[:, 1]], axis=1)
        narrow = np.minimum(room[ends].min(axis=1), 1.2)
        cost = length * (1 + 0.5 * (1.2 - narrow))
        graph = csr_matrix((cost, (ends[:, 0], ends[:, 1])), shape=(len(places), len(places)))
        graph = graph + graph.T
        _, part = connected_components(graph, directed=False)
        kept = np.flatnonzero(part == np.bincount(part).argmax())
        return cls(places[kept], room[kept], graph[kept][:, kept].tocsr())

    def nearest(self, places: Floats) -> NDArray[np.int64]:
        """Return the node nearest to each place."""
        return np.atleast_1d(cKDTree(self.nodes).query(np.atleast_2d(places))[1]).astype(np.int64)

    def draw(self, random: Random, count: int, room: float = 0.0) -> NDArray[np.int64]:
        """Draw nodes, those with so much room if there are any."""
        wide = np.flatnonzero(self.room >= room)
        return random.choice(wide if len(wide) else len(self.nodes), count)

    def guide(self, goals: NDArray[np.int64]) -> "Guide":
        """Find the shortest ways from everywhere to some nodes."""
        goals = np.unique(goals)
        _, before = dijkstra(self.graph, directed=False, indices=goals, return_predecessors=True)
        return Guide(self, {int(goal): row for goal, row in zip(goals, before, strict=True)})


def _lattice(
    floor: Floor, caster: Caster, spacing: float
) -> tuple[Floats, Floats, NDArray[np.int64]]:
    """Return free places of a floor, their room, and pairs of neighbours."""
    x0, y0, x1, y1 = floor.bounds
    shape = (max(2, int((x1 - x0) / spacing)), max(2, int((y1 - y0) / spacing)))
    along = np.linspace(x0 + 0.2, x1 - 0.2, shape[0])
    across = np.linspace(y0 + 0.2, y1 - 0.2, shape[1])
    x, y = np.meshgrid(along, across, indexing="ij")
    places = np.stack([x, y, floor.height(x, y)], axis=-1).reshape(-1, 3)
    room = np.min([caster.clearance(places + np.array([0, 0, up])) for up in _HEIGHTS], axis=0)
    free = (room >= CLEARANCE) & (caster.clearance(places) < _UNDERFOOT)
    number = np.where(free, np.cumsum(free) - 1, -1).reshape(shape)
    pairs = []
    for dx, dy in _STEPS:
        low, high = max(0, -dy), shape[1] - max(0, dy)
        here = number[: shape[0] - dx, low:high].ravel()
        there = number[dx:, low + dy : high + dy].ravel()
        both = (here >= 0) & (there >= 0)
        pairs.append(np.stack([here[both], there[both]], axis=1))
    return places[free], room[free], np.concatenate(pairs)


@dataclass(frozen=True, slots=True)
class Guide:
    """Ways to some goals."""

    walkways: Walkways
    before: dict[int, NDArray[np.int32]]

    def way(self, start: int, goal: int, aside: float = 0.0) -> Floats:
        """Return a smooth way, kept aside of the shortest one as far as there is room: (m, 3)."""
        step, chain = int(start), [int(start)]
        row = self.before[int(goal)]
        while step != goal and row[step] >= 0:
            step = int(row[step])
            chain.append(step)
        line = self.walkways.nodes[chain]
        if len(line) < 4:
            return line
        room = self.walkways.room[chain]
        smooth = uniform_filter1d(line, 5, axis=0, mode="nearest")
        ahead = np.gradient(smooth[:, :2], axis=0)
        ahead /= np.maximum(np.linalg.norm(ahead, axis=1, keepdims=True), 1e-9)
        fade = np.minimum(np.arange(len(line)), np.arange(len(line))[::-1]) / 4
        off = np.sign(aside) * np.minimum(abs(aside), np.maximum(0, room - CLEARANCE))
        smooth[:, :2] += (off * np.minimum(fade, 1))[:, None] * ahead[:, ::-1] * [-1, 1]
        smooth[[0, -1]] = line[[0, -1]]
        return uniform_filter1d(smooth, 3, axis=0, mode="nearest")
