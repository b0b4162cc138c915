"""Parameters drawn widely, to learn from."""

from typing import Any

import numpy as np

from pipeline.simulation.meshes.parameters import (
    DriveMode,
    MeshParameters,
    MeshSceneKind,
    SensorKind,
)


def random_parameters(
    seed: int, kind: MeshSceneKind | None = None, sensor: SensorKind | None = None
) -> MeshParameters:
    """Draw a scene, a sensor, its way, what moves, noise, drift and how the map is made.

    Parameters
    ----------
    seed : int
    kind, sensor : optional
        Fix them, and draw the rest.

    Returns
    -------
    MeshParameters
        The same for the same seed.
    """
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))
    u = random.uniform
    drawn_kind = MeshSceneKind(str(random.choice([str(each) for each in MeshSceneKind])))
    drawn_sensor = SensorKind(
        str(random.choice(["vlp16", "vlp16", "ring32", "ring64", "os64", "mid360", "mid360"]))
    )
    kind, sensor = kind or drawn_kind, sensor or drawn_sensor
    shares = [0.1, 0.2, 0.7] if kind is MeshSceneKind.ROOM else [0.5, 0.35, 0.15]
    mode = DriveMode(str(random.choice(["through", "stop_and_go", "stand"], p=shares)))
    outdoors = not kind.indoors
    vehicle = outdoors and random.random() < 0.5
    few = random.random()
    crowd = 100 if kind is MeshSceneKind.LOBBY else 25
    people = 0 if few < 0.14 else int(u(1, 6)) if few < 0.3 else int(u(4, crowd))
    still = few < 0.12  # nothing moves at all
    keyed = random.random() < 0.5
    good = random.random() < 0.5  # a map as one hopes for: whole scans, small drift, no filter
    scans = int(np.exp(u(np.log(60), np.log(300 if good else 500))))
    total = np.exp(u(np.log(2e6), np.log(4e6)) if good else u(np.log(4e5), np.log(3e6)))
    if random.random() < 0.25:  # a short, hurried drive: most places are hardly scanned
        scans = int(np.exp(u(np.log(6), np.log(60))))
        total = np.exp(u(np.log(8e4), np.log(6e5)))
    elif mode is DriveMode.STAND:  # sees the same walls again and again
        total *= u(1, 4)
    voxel = float(random.choice([0.05, 0.05, 0.1, 0.2 if outdoors else 0.1]))
    drawn = {"kind": kind, "sensor": sensor, "seed": seed, "scans": scans, "mode": mode}
    drawn["rays"] = int(np.clip(total / scans, 2_500, 60_000 if good else 28_000))
    drawn |= _way(random, sensor, vehicle, keyed) | _returns(random)
    if sensor is SensorKind.RING64:  # looks 2 degrees up: stands as high as people, or on a car
        drawn["sensor_height"] = max(drawn["sensor_height"], float(u(1.2, 1.9)))
    drawn |= _movers(random, mode, outdoors, 0 if still else people, still) | _things(random)
    return MeshParameters.model_validate(drawn | _errors(random, good, voxel))


_Drawn = dict[str, Any]


def _way(random: np.random.Generator, sensor: SensorKind, vehicle: bool, keyed: bool) -> _Drawn:
    u = random.uniform
    return {
        "interval": float(random.choice([0.1, 0.2, 0.5, 1.0])) if not keyed else 0.1,
        "key_distance": float(u(0.2, 1.0)) * (3.0 if vehicle else 1.0) if keyed else 0.0,
        "rate": float(random.choice([5.0, 10.0, 10.0, 20.0])),
        "speed": float(u(2.5, 9) if vehicle else u(0.5, 1.5)),
        "sensor_height": float(
            u(1.6, 2.4) if vehicle else random.choice([u(0.3, 0.7), u(0.7, 1.3)])
        ),
        "pitch": float(u(-5, 30)) if sensor is SensorKind.MID360 and random.random() < 0.4 else 0.0,
        "wobble": float(u(0.5, 5)) if not vehicle and random.random() < 0.3 else float(u(0, 0.3)),
        "own_body": float(u(1.2, 2.5) if vehicle else u(0.25, 0.5)),
    }


def _returns(random: np.random.Generator) -> _Drawn:
    u = random.uniform
    return {
        "max_range": float(random.choice([15, 30, 60, 100])),
        "range_noise": float(np.exp(u(np.log(0.004), np.log(0.03)))),
        "angle_noise": float(u(0.0, 0.12)),
        "dropouts": float(u(0, 0.15)),
        "sensitivity": float(np.exp(u(np.log(0.4), np.log(3)))),
        "mixed": float(u(0, 0.3)),
        "beam": float(u(0.05, 0.25)),
    }


def _movers(
    random: np.random.Generator, mode: DriveMode, outdoors: bool, people: int, still: bool
) -> _Drawn:
    u = random.uniform
    return {
        "people": people,
        "lingering": float(u(0.2, 1.0) if mode is DriveMode.STAND else u(0, 0.4)),
        "seated": int(u(0, 8)) if random.random() < 0.5 else 0,
        "vehicles": 0
        if still
        else int(random.choice([0, 1, 2, 4, 8] if outdoors else [0, 0, 1, 2, 4])),
    }


def _things(random: np.random.Generator) -> _Drawn:
    u = random.uniform
    return {
        "glass": float(u(0, 1)),
        "mirrors": float(u(0, 0.6)),
        "clutter": float(u(0.3, 2.5)),
    }


def _errors(random: np.random.Generator, good: bool, voxel: float) -> _Drawn:
    """Draw drift, and what becomes of the map's points."""
    u = random.uniform
    return {
        "drift_position": float(np.exp(u(np.log(0.003), np.log(0.02 if good else 0.06)))),
        "drift_angle": float(u(0.0, 0.1 if good else 0.3)),
        "jitter_position": float(u(0.0, 0.01)),
        "jitter_angle": float(u(0.0, 0.05 if good else 0.12)),
        "loop_gap": float(u(0.03, 0.15)) if random.random() < 0.2 else 0.0,
        "scan_voxel": float(u(0.05, 0.2)) if not good and random.random() < 0.3 else 0.0,
        "voxel": voxel if not good and random.random() < 0.5 else 0.0,
        "keep": float(u(0.2, 1.0)) if not good and random.random() < 0.4 else 1.0,
    }
