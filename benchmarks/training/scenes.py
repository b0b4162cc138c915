"""What is simulated to learn from: scenes drawn widely, and two kinds that these hardly hold."""

import numpy as np

from pipeline.simulation.meshes import random_parameters
from pipeline.simulation.meshes.parameters import (
    DriveMode,
    MeshParameters,
    MeshSceneKind,
    SensorKind,
)

STANDING, DRIVEN = 100_000, 200_000
"""Seeds from here on are of a sensor on a tripod, and of some seconds of driving."""

_UNFILTERED = {"voxel": 0.0, "scan_voxel": 0.0, "keep": 1.0, "loop_gap": 0.0}


def parameters_of(seed: int) -> MeshParameters:
    """Draw a scene of meshes, and how it is mapped."""
    if seed >= DRIVEN:
        return _while_driving(seed)
    return random_parameters(seed) if seed < STANDING else _on_a_tripod(seed)


def _on_a_tripod(seed: int) -> MeshParameters:
    """Draw a dense map of a sensor that does not move at all, and few who pass by."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(97,)))
    u = random.uniform
    scans = int(np.exp(u(np.log(100), np.log(400))))
    fixed = ("drift_position", "drift_angle", "jitter_position", "jitter_angle", "wobble")
    drawn = {
        "mode": DriveMode.STAND,
        "scans": scans,
        "rays": int(np.clip(np.exp(u(np.log(2e6), np.log(8e6))) / scans, 2_500, 60_000)),
        "people": 0 if random.random() < 0.2 else int(u(1, 7)),
        "visiting": float(u(0, 1)),
        "lingering": float(u(0, 1)),
        "vehicles": int(random.choice([0, 0, 0, 1])),
        "range_noise": float(np.exp(u(np.log(0.0005), np.log(0.01)))),
        "angle_noise": float(u(0.0, 0.01)),
    }
    drawn |= dict.fromkeys(fixed, 0.0) | _UNFILTERED
    kind = MeshSceneKind.ROOM if random.random() < 0.4 else None
    return random_parameters(seed, kind).model_copy(update=drawn)


def _while_driving(seed: int) -> MeshParameters:
    """Draw some dense scans of a street, a tenth of a second apart, by a car that drives."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(97,)))
    u = random.uniform
    drawn = {
        "mode": DriveMode.THROUGH,
        "scans": int(np.exp(u(np.log(5), np.log(40)))),
        "rays": int(u(30_000, 120_000)),
        "interval": 0.1,
        "key_distance": 0.0,
        "rate": 10.0,
        "speed": float(u(3, 14)),
        "sensor_height": float(u(1.6, 2.2)),
        "own_body": float(u(1.2, 2.5)),
        "pitch": 0.0,
        "wobble": float(u(0, 0.3)),
        "people": int(u(0, 15)),
        "vehicles": int(random.choice([0, 1, 2, 4, 8])),
        "max_range": float(random.choice([60, 100])),
        "range_noise": float(np.exp(u(np.log(0.005), np.log(0.025)))),
        "drift_position": float(np.exp(u(np.log(0.003), np.log(0.03)))),
    }
    sensor = SensorKind(str(random.choice(["ring64", "ring64", "ring64", "os64", "ring32"])))
    drawn |= _UNFILTERED
    return random_parameters(seed, MeshSceneKind.STREET, sensor).model_copy(update=drawn)
