"""Draw the pictures of docs/ground.md and docs/results/ground.md: what is called ground, in green.

Run `python -m benchmarks.ground_pictures [--data FOLDER] [--out FOLDER]`.
"""

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from matplotlib.axes import Axes

from benchmarks.building import simulate_building
from benchmarks.ground import DEFAULT, ROOT, Booleans, Floats, load
from dynahull.ground.methods import ground_mask

MAPS = {
    "corridor": (29.0, 30.6),
    "lobby_a": (1.8, -0.8),
    "lobby_b": (3.2, -0.8),
    "room_static_sensor": (1.6, -0.1),
    "street_64beam_labelled": (12.7, 5.1),
}
"""Where the sections are laid: x and y, metres."""


def draw(points: Floats, ground: Booleans, place: tuple[float, float], path: Path) -> None:
    """Draw a top view and two sections 1.5 m thick."""
    figure, axes = plt.subplots(1, 3, figsize=(13, 3.6), layout="constrained")
    scatter(axes[0], points, ground, 0, 1)
    axes[0].set_aspect("equal")
    for axis, across in ((axes[1], 1), (axes[2], 0)):
        near = np.abs(points[:, across] - place[across]) < 0.75
        scatter(axis, points[near], ground[near], 1 - across, 2)
        axis.set_title(f"{'xy'[across]} = {place[across]:.1f} m, 1.5 m thick", fontsize=8)
    figure.savefig(path, dpi=75, pil_kwargs={"optimize": True})
    plt.close(figure)


def scatter(axis: Axes, points: Floats, ground: Booleans, across: int, up: int) -> None:
    """Draw at most 40,000 points, the ground last."""
    chosen = np.random.default_rng(0).permutation(len(points))[:40_000]
    for mask, colour in ((~ground[chosen], "0.65"), (ground[chosen], "tab:green")):
        shown = points[chosen[mask]]
        axis.scatter(shown[:, across], shown[:, up], s=0.3, c=colour, linewidths=0)
    axis.set_xlabel(f"{'xyz'[across]}, m", fontsize=8)
    axis.set_ylabel(f"{'xyz'[up]}, m", fontsize=8)
    axis.tick_params(labelsize=7)


def main() -> None:
    """Draw all of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--data", type=Path, default=ROOT / "../shared/data")
    parser.add_argument("--out", type=Path, default=ROOT / "docs/images")
    options = parser.parse_args()
    mpl.use("Agg")
    options.out.mkdir(parents=True, exist_ok=True)
    building = simulate_building(1, ramp_slope=0.15)
    mask = ground_mask(building.points, DEFAULT)
    draw(building.points, mask, (10.0, 5.0), options.out / "ground_building.png")
    for name, place in MAPS.items():
        points = load(options.data / "maps", name)
        draw(points, ground_mask(points, DEFAULT), place, options.out / f"ground_{name}.png")


if __name__ == "__main__":
    main()
