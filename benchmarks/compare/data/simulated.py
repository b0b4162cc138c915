"""Simulated scenes: a whole scan each second, as maps are made of key frames."""

from collections.abc import Sequence

import numpy as np

from benchmarks.compare.scene import Scene
from pipeline.configuration.run import load_parameters
from pipeline.evaluation.truth import Truth
from pipeline.simulation import SceneKind, SimulationParameters, simulate
from pipeline.simulation.meshes import random_parameters, simulate_meshes
from pipeline.simulation.meshes.parameters import MeshSceneKind, SensorKind

__all__ = ["mesh_scene", "simulated_scene"]

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


_UNSEEN = 10_000
"""Seeds of training are below it."""

_SPACINGS = {SensorKind.VLP16: 2.0, SensorKind.RING64: 26.9 / 64, SensorKind.MID360: 1.0}


def mesh_scene(kind: MeshSceneKind, sensor: SensorKind, seed: int) -> Scene:
    """Simulate a scene of meshes as a good map shows it: whole scans, small drift, some movers.

    Parameters
    ----------
    kind : MeshSceneKind
    sensor : SensorKind
    seed : int
    """
    drawn = random_parameters(_UNSEEN + seed, kind, sensor)
    told = drawn.model_copy(
        update={
            "scans": 150, "rays": 20_000, "interval": 1.0, "key_distance": 0.0, "people": 12,
            "drift_position": 0.01, "drift_angle": 0.05, "loop_gap": 0.0, "scan_voxel": 0.0,
            "voxel": 0.0, "keep": 1.0,
        }
    )  # fmt: skip
    made = simulate_meshes(told)
    points = made.points
    labels = np.where(points.moving, Truth.DYNAMIC, Truth.STATIC).astype(np.int8)
    labels[~points.known] = Truth.UNKNOWN
    name = f"{kind.value} of meshes, {sensor.value}"
    return Scene(
        name=f"{name}, seed {seed}",
        group=name,
        xyz=points.xyz,
        labels=labels,
        scan=points.scan,
        poses=made.poses,
        ring_spacing=_SPACINGS.get(sensor, 1.0),
    )
