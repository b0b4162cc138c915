"""The stage: all that stands still, and where one can go, gathered while a scene is built."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from typing import TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pipeline.simulation.meshes.mesh import Mesh, Rows, boxes
from pipeline.simulation.scene import Surface
from pipeline.simulation.tables import Floats, Random

T = TypeVar("T")

At: TypeAlias = tuple[float, float, float, float]  # where something stands: x, y, z and its yaw
Thing: TypeAlias = Callable[["Stage", At], None]  # what puts something somewhere
Height: TypeAlias = Callable[[Floats, Floats], Floats]  # the height of a floor at some x and y


class Matter(IntEnum):
    """What a ray does that meets a triangle."""

    SOLID = 0
    GLASS = 1
    MIRROR = 2


@dataclass(frozen=True, slots=True)
class Body:
    """Triangles of one matter, with what each of them is made of."""

    mesh: Mesh
    surface: NDArray[np.uint8]  # (t,), the `Surface` of each triangle
    albedo: NDArray[np.float32]  # (t,), share of light that each triangle returns


@dataclass(frozen=True, slots=True)
class Floor:
    """A rectangle that one can walk on, its height aside: x0, y0, x1, y1."""

    bounds: tuple[float, float, float, float]
    height: Height


@dataclass(frozen=True, slots=True)
class Seat:
    """A seat: where it is, the height of the floor, where one looks, its height above the floor."""

    x: float
    y: float
    z: float
    yaw: float
    height: float = 0.45


@dataclass(frozen=True, slots=True)
class Door:
    """A door that opens and closes: its hinge, the direction of the closed leaf, width, height."""

    x: float
    y: float
    z: float
    yaw: float
    width: float = 0.9
    height: float = 2.05


@dataclass(frozen=True, slots=True)
class Lane:
    """A way for wheels: (n, 3) corners on the ground, and what drives there."""

    line: Floats
    kinds: tuple[str, ...]
    speed: tuple[float, float]
    closed: bool = False


def level(height: float) -> Height:
    """Return a floor that is flat."""
    return lambda x, y: np.full(np.shape(x), height)


@dataclass(slots=True)
class Stage:
    """A scene while it is built, and afterwards."""

    random: Random  # furnishes it
    floors: list[Floor] = field(default_factory=list)  # walked on, if nothing stands there
    links: list[Floats] = field(default_factory=list)  # (n, 3) ways that join floors: stairs
    seats: list[Seat] = field(default_factory=list)
    doors: list[Door] = field(default_factory=list)
    lanes: list[Lane] = field(default_factory=list)
    queue: Floats | None = None  # (n, 3), its slots, the counter first
    robot_lane: Lane | None = None  # of the sensor; without one it goes where people go
    _parts: list[tuple[Mesh, Surface, float, Matter]] = field(default_factory=list)

    def mesh(
        self,
        mesh: Mesh,
        surface: Surface = Surface.FURNITURE,
        at: At | None = None,
        albedo: float | None = None,
        matter: Matter = Matter.SOLID,
    ) -> None:
        """Add triangles of one kind; their albedo is drawn if it is not given."""
        if albedo is None:
            albedo = float(self.random.uniform(0.12, 0.8))
        self._parts.append((mesh.placed(*at) if at else mesh, surface, albedo, matter))

    def boxes(
        self,
        rows: Rows,
        surface: Surface = Surface.FURNITURE,
        at: At = (0.0, 0.0, 0.0, 0.0),
        matter: Matter = Matter.SOLID,
    ) -> None:
        """Add boxes, each given by its middle and lengths."""
        self.mesh(boxes(rows), surface, at, matter=matter)

    def block(
        self,
        low: ArrayLike,
        high: ArrayLike,
        surface: Surface,
        albedo: float | None = None,
        matter: Matter = Matter.SOLID,
    ) -> None:
        """Add one box from its lowest to its highest corner."""
        lower, upper = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        row = np.concatenate([(lower + upper) / 2, upper - lower])
        self.mesh(boxes(row), surface, None, albedo, matter)

    def pick(self, things: Sequence[T]) -> T:
        """Draw one of some things."""
        return things[int(self.random.integers(len(things)))]

    def body(self, matter: Matter) -> Body:
        """Return all triangles of one matter."""
        parts = [part for part in self._parts if part[3] is matter]
        sizes = [len(mesh.triangles) for mesh, *_ in parts]
        surfaces = np.array([surface for _, surface, *_ in parts], dtype=np.uint8)
        albedos = np.array([albedo for _, _, albedo, _ in parts], dtype=np.float32)
        return Body(
            Mesh.joined([mesh for mesh, *_ in parts]),
            np.repeat(surfaces, sizes),
            np.repeat(albedos, sizes),
        )
