"""Draw real maps from above, before and after: the README's picture, and those of docs/results.

    python -m benchmarks.pictures [--maps ../shared/data/maps] [--to docs/images] [-c auto]

Draws what stands on the floor, below the ceiling of a room, and prints how much of each map goes.
"""

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt
from numpy.typing import NDArray

from dynahull import Label, clean
from dynahull.ground.methods import height_above_ground
from pipeline.configuration.run import load_configuration
from tiling.formats import open_map

Extent = tuple[tuple[float, float], tuple[float, float]]

MAPS: dict[str, Extent | None] = {
    "corridor.pcd": ((13.0, 50.0), (22.0, 40.0)),
    "lobby_a.pcd": None,
    "lobby_b.pcd": None,
    "campus_loop.laz": ((-60.0, 60.0), (-60.0, 60.0)),
}
"""Maps, and the part that is drawn, metres along x and y; None: all of it."""

CEILING = 2.1
"""Metres above the floor."""

_DENSE = 200_000
"""Points of a picture whose dots are at their smallest."""


def main() -> None:
    """Clean, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=Path, default=Path("../shared/data/maps"))
    parser.add_argument("--to", type=Path, default=Path("docs/images"))
    parser.add_argument("-c", "--config", default="auto")
    arguments = parser.parse_args()
    mpl.use("Agg")
    parameters = load_configuration(arguments.config).method()
    arguments.to.mkdir(parents=True, exist_ok=True)
    for name, extent in MAPS.items():
        reader = open_map(arguments.maps / name)
        points = np.concatenate([batch.xyz for batch in reader.batches()])
        labels = clean(points, parameters).labels
        print(f"{name}: {100 * np.mean(labels == Label.DYNAMIC):.1f} % removed")
        height = height_above_ground(points, labels == Label.GROUND, parameters.ground)
        shown = (height < CEILING) & _inside(points, extent)
        path = arguments.to / f"{name.partition('.')[0]}_before_after.png"
        draw(points[shown], labels[shown], path)


def _inside(points: NDArray[np.float64], extent: Extent | None) -> NDArray[np.bool_]:
    if extent is None:
        return np.ones(len(points), np.bool_)
    low, high = np.array(extent).T
    return np.asarray(((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1))


def draw(points: NDArray[np.float64], labels: NDArray[np.uint8], path: Path) -> None:
    """Draw the map as it came, with the points to go in red, and as it is given back."""
    ghosts = labels == Label.DYNAMIC
    stays = labels == Label.STATIC
    extent = np.ptp(points[stays, :2], axis=0)
    flat = extent[0] > 1.3 * extent[1]
    size = (10.0, 20 * extent[1] / extent[0]) if flat else (10.0, 5 * extent[1] / extent[0] + 0.4)
    figure, panels = plt.subplots(
        2 if flat else 1, 1 if flat else 2, figsize=size, layout="constrained"
    )
    dot = 0.15 * max(1.0, _DENSE / max(int(stays.sum()), 1) / 4)
    for panel, title in zip(panels, ("before (red: removed)", "after"), strict=True):
        panel.scatter(points[stays, 0], points[stays, 1], s=dot, c="#304050", linewidths=0)
        panel.set(aspect="equal", title=title, xticks=[], yticks=[])
    panels[0].scatter(points[ghosts, 0], points[ghosts, 1], s=3 * dot, c="#d03020", linewidths=0)
    figure.savefig(path, dpi=90)
    plt.close(figure)


if __name__ == "__main__":
    main()
