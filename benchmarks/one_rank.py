"""What one rank of all densities removes from the recorded street: readings of it, and where.

    python -m benchmarks.one_rank [--maps ../shared/data/maps]

"The 12.5 % least dense" can be meant of the whole map, of what is not ground, of what is labelled,
or of what is near the path. SA, DA and AA of each, in percent, and what goes at which distance.
Takes two minutes of processor time and 2 GB.
"""

import argparse
from collections.abc import Iterator
from datetime import date
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.compare.data.recorded import street_scene
from benchmarks.compare.scene import Scene
from benchmarks.density import machine
from benchmarks.studies.labelled import LabelledMap
from dynahull import clean
from pipeline.configuration.run import load_configuration
from pipeline.evaluation.truth import Truth

SHARE = 0.125
OTHER_SHARES = (0.10, 0.15, 0.175, 0.20)
NEAR = (20.0, 30.0, 40.0)
"""Metres from the path."""

Floats = NDArray[np.float64]
Booleans = NDArray[np.bool_]


class Reading(NamedTuple):
    """One meaning of "the least dense": by which densities, how many, and out of which points."""

    name: str
    density: Floats
    most: int
    candidates: Booleans


def main() -> None:
    """Print SA, DA and AA of all readings, and the shares removed by distance."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--maps", type=Path, default=Path("../shared/data/maps"))
    scene = street_scene(parser.parse_args().maps)
    print(f"{date.today()}, {machine()}")
    away = np.asarray(cKDTree(scene.poses[:, :2, 3]).query(scene.xyz[:, :2])[0])
    known = scene.labels != Truth.UNKNOWN
    scored = LabelledMap(scene.xyz[known], scene.labels[known], np.empty(0))
    for reading in readings(scene, away):
        found = scored.accuracy(kept_by(reading)[known])
        accuracies = found.static_accuracy, found.dynamic_accuracy, found.associated_accuracy
        print(f"{reading.name:50}", *(f"{each or 0:6.1f}" for each in accuracies), flush=True)
        if reading.name == "12.5 % of the map":
            by_distance(scene, away, kept_by(reading))


def readings(scene: Scene, away: Floats) -> Iterator[Reading]:
    """Yield all readings of a scene whose points are `away` metres from the path."""
    everything = np.ones(len(scene), np.bool_)
    of_all = density(scene, "ground.method=none")
    yield Reading("12.5 % of the map", of_all, round(SHARE * len(scene)), everything)
    for share in OTHER_SHARES:
        yield Reading(f"{share:.1%} of the map", of_all, round(share * len(scene)), everything)
    labelled = scene.labels != Truth.UNKNOWN
    for name, points in (
        ("the labelled points", labelled),
        *((f"the points within {limit:.0f} m", away <= limit) for limit in NEAR),
    ):
        yield Reading(f"12.5 % of {name}", of_all, round(SHARE * points.sum()), points)
    of_others = density(scene)
    others = ~np.isnan(of_others)
    for name, count in (("what is not ground", others.sum()), ("the map", len(scene))):
        title = f"12.5 % of {name}, out of what is not ground"
        yield Reading(title, of_others, round(SHARE * count), others)


def density(scene: Scene, *settings: str) -> Floats:
    """Return the density of every point in a single cluster, NaN for those set aside."""
    parameters = load_configuration("paper", ["clustering.count=1", *settings]).method()
    return clean(scene.xyz, parameters).density


def kept_by(reading: Reading) -> Booleans:
    """Return what is left when the least dense of the candidates are removed."""
    rows = np.flatnonzero(reading.candidates & np.isfinite(reading.density))
    order = np.argsort(reading.density[rows], kind="stable")
    kept = np.ones(len(reading.density), np.bool_)
    kept[rows[order[: reading.most]]] = False
    return kept


def by_distance(scene: Scene, away: Floats, kept: Booleans) -> None:
    """Print which shares of the static and of the moving points go, by distance from the path."""
    for least in range(0, 40, 10):
        here = (away >= least) & (away < least + 10)
        shares = [
            f"{len(removed):,} {truth.name.lower()}"
            + (f", {removed.mean():.1%} removed" if len(removed) else "")
            for truth in (Truth.STATIC, Truth.DYNAMIC)
            for removed in [~kept[here & (scene.labels == truth)]]
        ]
        print(f"    {least} to {least + 10} m from the path: {'; '.join(shares)}")


if __name__ == "__main__":
    main()
