"""Simulated scenes: a whole scan each second, as maps are made of key frames."""

from collections.abc import Sequence

import numpy as np

from benchmarks.compare.scene import Scene
from pipeline.configuration.run import load_parameters
from pipeline.evaluation.labels import Truth
from pipeline.simulation import SceneKind, SimulationParameters, simulate

__all__ = ["simulated_scene"]

SETTINGS = ("scans=280", "rotations_per_scan=10", "azimuth_step=2.0")
"""280 scans of 16 rings and 180 columns. The simulation's own, 18 columns every 0.4 s, give the
same drive, but range images and rays want scans that are denser."""

_RING_SPACING = 2.0  # degrees, of a VLP-16


def simulated_scene(kind: SceneKind, seed: int, settings: Sequence[str] = ()) -> Scene:
    """Simulate a scene, with its estimated poses.

    Parameters
    ----------
    kind : SceneKind
    seed : int
    settings : sequence of str
        `key=value` of `SimulationParameters`, after those above.
    """
    parameters = load_parameters(
        SimulationParameters, None, [*SETTINGS, *settings, f"scene={kind.value}", f"seed={seed}"]
    )
    made = simulate(parameters)
    return Scene(
        name=f"simulated {kind.value}, seed {seed}",
        group=f"simulated {kind.value}",
        xyz=made.xyz.astype(np.float64),
        labels=np.where(made.moving == 1, Truth.DYNAMIC, Truth.STATIC).astype(np.int8),
        scan=made.scan.astype(np.int32),
        poses=made.estimated_poses,
        ring_spacing=_RING_SPACING,
    )
