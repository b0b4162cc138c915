"""Draw the README's picture: a real corridor, before and after.

    python -m benchmarks.pictures [--maps ../shared/data/maps] [--to docs/images]

Cleans the map with the ready configuration `indoor`, and draws from above what stands on the floor,
below the ceiling.
"""

import argparse
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib import pyplot as plt

from dynahull import Label, clean
from dynahull.ground.methods import height_above_ground
from pipeline.configuration import load_configuration
from tiling.formats import open_map

EXTENT = ((13.0, 50.0), (22.0, 40.0))
"""The part that is drawn, metres along x and y."""

CEILING = 2.1
"""Metres above the floor."""


def main() -> None:
    """Clean, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--maps", type=Path, default=Path("../shared/data/maps"))
    parser.add_argument("--to", type=Path, default=Path("docs/images"))
    arguments = parser.parse_args()
    mpl.use("Agg")
    reader = open_map(arguments.maps / "corridor.pcd")
    points = np.concatenate([batch.xyz for batch in reader.batches()])
    parameters = load_configuration("indoor").method()
    labels = clean(points, parameters).labels
    height = height_above_ground(points, labels == Label.GROUND, parameters.ground)
    low = height < CEILING
    arguments.to.mkdir(parents=True, exist_ok=True)
    draw(points[low], labels[low], arguments.to / "corridor_before_after.png")


def draw(points: np.ndarray, labels: np.ndarray, path: Path) -> None:
    """Draw the map as it came, with the points to go in red, and as it is given back."""
    ghosts = labels == Label.DYNAMIC
    stays = labels == Label.STATIC
    figure, panels = plt.subplots(2, 1, figsize=(10, 10.2), layout="constrained")
    for panel, title in zip(panels, ("before (red: removed)", "after"), strict=True):
        panel.scatter(points[stays, 0], points[stays, 1], s=0.15, c="#304050", linewidths=0)
        panel.set(xlim=EXTENT[0], ylim=EXTENT[1], aspect="equal", title=title)
        panel.set_xticks([])
        panel.set_yticks([])
    panels[0].scatter(points[ghosts, 0], points[ghosts, 1], s=0.4, c="#d03020", linewidths=0)
    figure.savefig(path, dpi=90)


if __name__ == "__main__":
    main()
