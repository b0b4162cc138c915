"""The tiles of a run, coloured by the time they took, with the state each is in."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.report_page.svg import Axis, frame, picture

MOST_TILES = 50_000
"""Tiles that are drawn; more would not be told apart."""

_NAMED_TILES = 2_000
"""Tiles that are drawn one by one, each with its numbers."""

_SHADES = 6


@dataclass(frozen=True, slots=True)
class TileWork:
    """What the tiles of a run took.

    Attributes
    ----------
    low, high : (T, 2) float64 arrays
        Cores, metres.
    points : (T,) int64 array
        In each core.
    seconds : (T,) float64 array
        Of all tasks about the tile, on its worker.
    resumed : (T,) bool array
        Whether the densities were found by an earlier run, which did not end.
    overfull : (T,) bool array
        Whether a tile holds more points than wanted, being a single column of the lattice.
    """

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    points: NDArray[np.int64]
    seconds: NDArray[np.float64]
    resumed: NDArray[np.bool_]
    overfull: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.points)

    def states(self) -> list[str]:
        """Return the state of each tile in a few words."""
        words = np.where(self.resumed, "kept from an interrupted run", "done in this run")
        full = np.where(self.overfull, ", more points than tiling.max_points", "")
        return [one + other for one, other in zip(words.tolist(), full.tolist(), strict=True)]


def tile_chart(work: TileWork) -> str:
    """Draw the cores of the tiles seen from above."""
    low, high = np.nan_to_num(work.low), np.nan_to_num(work.high)
    least, most = low.min(axis=0), high.max(axis=0)
    width, height = np.maximum(most - least, 1e-9).tolist()
    scale = min(400 / width, 340 / height)
    x = Axis(least[0], most[0], 70, 70 + width * scale)
    bottom = 12 + height * scale
    y = Axis(least[1], most[1], bottom, 12)
    shades = _shades(work.seconds)
    draw = _one_by_one if len(work) <= _NAMED_TILES else _by_shade
    written = lambda value: f"{value:,.10g}"  # noqa: E731
    parts = [frame(x, y, ("x, m", "y, m"), (written, written))]
    parts += draw(work, x, y, shades)
    return picture(490, int(bottom) + 46, "Tiles, coloured by the time they took", parts)


def shade_limits(seconds: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the seconds at the ends of the shades, (7,)."""
    return np.linspace(0, max(float(seconds.max(initial=0)), 1e-3), _SHADES + 1)


def _shades(seconds: NDArray[np.float64]) -> NDArray[np.intp]:
    found = np.searchsorted(shade_limits(seconds), seconds, side="left") - 1
    return np.clip(found, 0, _SHADES - 1)


def _one_by_one(work: TileWork, x: Axis, y: Axis, shades: NDArray[np.intp]) -> list[str]:
    parts = []
    for tile, state in enumerate(work.states()):
        left, right = x.at(work.low[tile, 0]), x.at(work.high[tile, 0])
        bottom, top = y.at(work.low[tile, 1]), y.at(work.high[tile, 1])
        kinds = f"tile shade{shades[tile]}"
        kinds += " resumed" if work.resumed[tile] else ""
        kinds += " overfull" if work.overfull[tile] else ""
        parts.append(
            f'<rect x="{left}" y="{top}" width="{max(right - left, 0.5):.1f}" '
            f'height="{max(bottom - top, 0.5):.1f}" class="{kinds}"><title>tile {tile}: '
            f"{work.points[tile]:,} points, {work.seconds[tile]:.2f} s, {state}</title></rect>"
        )
    return parts


def _by_shade(work: TileWork, x: Axis, y: Axis, shades: NDArray[np.intp]) -> list[str]:
    parts = []
    for shade in range(_SHADES):
        path = []
        for tile in np.flatnonzero(shades == shade).tolist():
            left, right = x.at(work.low[tile, 0]), x.at(work.high[tile, 0])
            bottom, top = y.at(work.low[tile, 1]), y.at(work.high[tile, 1])
            path.append(f"M{left} {bottom}V{top}H{right}V{bottom}z")
        parts.append(f'<path d="{"".join(path)}" class="tile shade{shade}"/>')
    return parts
