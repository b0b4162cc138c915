"""The trajectories on the map, and their distance from the truth over time."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["draw"]

Floats = NDArray[np.float64]

_DRAWN = 40_000
"""Points of the map."""


def draw(path: Path, map_points: Floats, truth: Floats, found: Mapping[str, Floats]) -> None:
    """Draw all trajectories of one drive.

    Parameters
    ----------
    path : Path
        PNG or SVG.
    map_points : (N, 3) float64 array
        Drawn in grey.
    truth : (S, 4, 4) float64 array
    found : mapping of str to (S, 4, 4) float64 array
        The poses found on each map.
    """
    import matplotlib as mpl  # noqa: PLC0415 (optional, and slow to import)

    mpl.use("agg")
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, (plan, errors) = plt.subplots(
        2, 1, figsize=(9, 8), height_ratios=(3, 2), layout="constrained"
    )
    some = map_points[:: max(1, len(map_points) // _DRAWN)]
    plan.plot(some[:, 0], some[:, 1], ",", color="0.75", zorder=0)
    plan.plot(truth[:, 0, 3], truth[:, 1, 3], color="black", linewidth=3, label="truth")
    for name, poses in found.items():
        plan.plot(poses[:, 0, 3], poses[:, 1, 3], linewidth=1, label=name)
        away = 1000 * np.linalg.norm(poses[:, :3, 3] - truth[:, :3, 3], axis=1)
        errors.plot(away, linewidth=0.8, label=name)
    plan.set_aspect("equal")
    plan.set(xlabel="x, m", ylabel="y, m")
    errors.set(xlabel="scan", ylabel="distance from the truth, mm", yscale="log")
    plan.legend(loc="center left", bbox_to_anchor=(1.02, 0.5), fontsize="small")
    figure.savefig(path, dpi=90)
    plt.close(figure)
