"""Building scenes: walls with doors and panes, and pieces of furniture, from boxes and cylinders.

All lengths are in metres.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from pipeline.simulation.scene import Shapes, Surface

HEIGHT = 3.0
WALL_THICKNESS = 0.2
DOOR_HEIGHT = 2.1

Span = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Opening:
    """A hole in a wall: a door, or a pane that rays pass."""

    start: float
    end: float
    bottom: float
    top: float
    glazed: bool


def door(start: float) -> Opening:
    """Return an open door, 1 m wide."""
    return Opening(start, start + 1.0, 0.0, DOOR_HEIGHT, glazed=False)


def passage(start: float, end: float) -> Opening:
    """Return a wide way through without a door."""
    return Opening(start, end, 0.0, 2.5, glazed=False)


def window(start: float, end: float) -> Opening:
    """Return a window over a parapet."""
    return Opening(start, end, 0.9, 2.3, glazed=True)


def glass_wall(start: float, end: float) -> Opening:
    """Return a pane from the floor almost to the ceiling."""
    return Opening(start, end, 0.1, 2.7, glazed=True)


@dataclass(slots=True)
class Builder:
    """Gathers the solid bodies of a scene; heights are above the floor it stands on at present."""

    glass: bool = True
    base: float = 0.0
    slope: float = 0.0
    boxes: list[tuple[float, ...]] = field(default_factory=list)
    box_surfaces: list[Surface] = field(default_factory=list)
    cylinders: list[tuple[float, ...]] = field(default_factory=list)
    cylinder_surfaces: list[Surface] = field(default_factory=list)

    def shapes(self) -> Shapes:
        """Return all that was built."""
        return Shapes.of(self.boxes, self.box_surfaces, self.cylinders, self.cylinder_surfaces)

    @contextmanager
    def on(self, base: float, slope: float = 0.0) -> Iterator[None]:
        """Build on a floor that is `base` high at x = 0 and rises by `slope` along x."""
        before = self.base, self.slope
        self.base, self.slope = base, slope
        yield
        self.base, self.slope = before

    def box(self, x: Span, y: Span, z: Span, surface: Surface = Surface.FURNITURE) -> None:
        """Add a box from its bounds along each axis."""
        lower, upper = self.base + z[0], self.base + z[1]
        self.boxes.append((x[0], y[0], lower, x[1], y[1], upper, self.slope, 0.0))
        self.box_surfaces.append(surface)

    def cylinder(
        self,
        x: float,
        y: float,
        radius: float,
        top: float,
        surface: Surface = Surface.FURNITURE,
        bottom: float = 0.0,
    ) -> None:
        """Add an upright cylinder, which stands on the floor if not told otherwise."""
        floor = self.base + self.slope * x
        self.cylinders.append((x, y, radius, floor + bottom, floor + top))
        self.cylinder_surfaces.append(surface)

    def floor(self, x: Span, y: Span) -> None:
        """Add a floor."""
        self.box(x, y, (-0.3, 0.0), Surface.FLOOR)

    def ceiling(self, x: Span, y: Span, height: float = HEIGHT) -> None:
        """Add a ceiling, 0.2 m thick."""
        self.box(x, y, (height, height + 0.2), Surface.CEILING)

    def wall(
        self,
        along: str,
        at: float,
        start: float,
        end: float,
        openings: tuple[Opening, ...] = (),
        height: float = HEIGHT,
    ) -> None:
        """Add a wall along "x" or "y" whose middle line is at `at`, with openings in order."""
        across = (at - WALL_THICKNESS / 2, at + WALL_THICKNESS / 2)

        def piece(first: float, last: float, bottom: float, top: float) -> None:
            if first < last and bottom < top:
                x, y = ((first, last), across) if along == "x" else (across, (first, last))
                self.box(x, y, (bottom, top), Surface.WALL)

        position = start
        for opening in openings:
            if opening.glazed and not self.glass:
                continue
            piece(position, opening.start, 0.0, height)
            piece(opening.start, opening.end, 0.0, opening.bottom)
            piece(opening.start, opening.end, opening.top, height)
            position = opening.end
        piece(position, end, 0.0, height)

    def pillar(self, x: float, y: float, height: float = HEIGHT) -> None:
        """Add a round pillar from the floor to the ceiling."""
        self.cylinder(x, y, 0.3, height, Surface.WALL)

    def cabinet(self, x: Span, y: Span, top: float) -> None:
        """Add a closed piece of furniture that stands on the floor."""
        self.box(x, y, (0.0, top))

    def table(self, x: float, y: float, length: float = 1.6, depth: float = 0.8) -> None:
        """Add a table about (x, y): a thin top on four legs."""
        half_x, half_y, leg = length / 2, depth / 2, 0.05
        self.box((x - half_x, x + half_x), (y - half_y, y + half_y), (0.72, 0.75))
        for left in (x - half_x, x + half_x - leg):
            for front in (y - half_y, y + half_y - leg):
                self.box((left, left + leg), (front, front + leg), (0.0, 0.72))

    def chair(self, x: float, y: float, back: float) -> None:
        """Add a chair about (x, y): a seat on one foot, its back at y + `back`."""
        self.box((x - 0.22, x + 0.22), (y - 0.22, y + 0.22), (0.42, 0.47))
        self.cylinder(x, y, 0.06, 0.42)
        self.box((x - 0.22, x + 0.22), (y + back - 0.02, y + back + 0.02), (0.47, 0.95))

    def desk(self, x: float, y: float) -> None:
        """Add a table with a screen on it and a chair to its south, 1.6 by 1.7 about (x, y)."""
        self.table(x, y + 0.45)
        self.box((x - 0.3, x + 0.3), (y + 0.55, y + 0.6), (0.8, 1.2))
        self.chair(x, y - 0.4, back=-0.2)

    def seats(self, x: float, y: float) -> None:
        """Add a small table between four chairs, 1.2 by 2.1 about (x, y)."""
        self.table(x, y, length=1.2)
        for side in (-1, 1):
            for left in (-0.3, 0.3):
                self.chair(x + left, y + side * 0.6, back=side * 0.2)

    def meeting_table(self, x: float, y: float) -> None:
        """Add a long table between six chairs, 4 by 2.8 about (x, y)."""
        self.table(x, y, length=4.0, depth=1.4)
        for side in (-1, 1):
            for left in (-1.3, 0.0, 1.3):
                self.chair(x + left, y + side * 1.0, back=side * 0.2)

    def plant(self, x: float, y: float) -> None:
        """Add a plant in a pot, 0.7 by 0.7 about (x, y)."""
        self.cylinder(x, y, 0.18, 0.4)
        self.cylinder(x, y, 0.3, 1.5, Surface.VEGETATION, bottom=0.4)
