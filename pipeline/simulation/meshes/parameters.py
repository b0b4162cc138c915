"""What a simulation of meshes can be told, by settings or drawn widely to learn from."""

import re
from collections.abc import Sequence
from enum import StrEnum
from typing import Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict

from pipeline.configuration.run import load_parameters
from pipeline.errors import ConfigurationError
from pipeline.simulation.parameters import SimulationParameters, key
from pipeline.simulation.scene import SceneKind
from pipeline.simulation.tables import Random


class MeshSceneKind(StrEnum):
    """Scenes of triangles."""

    OFFICE = "office"
    LOBBY = "lobby"
    WAREHOUSE = "warehouse"
    GARAGE = "garage"
    STREET = "street"
    CORRIDOR = "corridor"
    STAIRS = "stairs"
    PARK = "park"
    ROOM = "room"

    @property
    def indoors(self) -> bool:
        """Whether there is a roof."""
        return self not in (MeshSceneKind.STREET, MeshSceneKind.PARK)


class SensorKind(StrEnum):
    """Sensors: four with rings, and one whose pattern does not repeat."""

    VLP16 = "vlp16"
    RING32 = "ring32"
    RING64 = "ring64"
    OS64 = "os64"
    MID360 = "mid360"


class DriveMode(StrEnum):
    """How the sensor gets about."""

    THROUGH = "through"
    STOP_AND_GO = "stop_and_go"
    STAND = "stand"


class MeshParameters(BaseModel):
    """The scene, the sensor, its way, what moves, and how the map is made."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    kind: MeshSceneKind = key(MeshSceneKind.OFFICE, "The scene.")
    sensor: SensorKind = key(SensorKind.VLP16, "The sensor.")
    seed: int = key(0, "Seed of all that is random.", ge=0)
    drive: int = key(0, "Another number: the same scene, but other people, noise and drift.", ge=0)

    scans: int = key(150, "Scans that enter the map.", ge=1)
    rays: int = key(14_000, "Rays of a scan, about: rings are thinned in azimuth.", ge=64)
    interval: float = key(0.8, "Least time between two scans, in seconds.", gt=0)
    key_distance: float = key(0.0, "Metres between two scans; 0: time alone counts.", ge=0)
    rate: float = key(10.0, "Scans that the sensor makes, per second.", gt=0)

    mode: DriveMode = key(DriveMode.THROUGH, "How the sensor gets about.")
    speed: float = key(1.0, "Of the sensor, in metres per second.", gt=0)
    sensor_height: float = key(0.9, "Above the ground, in metres.", ge=0.2, le=3)
    pitch: float = key(0.0, "How far it is tilted down ahead, in degrees.", ge=-90, le=90)
    wobble: float = key(0.0, "Roll and pitch of a hand or a head, in degrees (deviation).", ge=0)
    own_body: float = key(0.35, "Nothing nearer than this in plan is measured, in metres.", ge=0)

    min_range: float = key(0.3, "In metres.", ge=0)
    max_range: float = key(100.0, "In metres.", gt=0)
    range_noise: float = key(0.012, "Deviation of a range, in metres.", ge=0)
    angle_noise: float = key(0.05, "Deviation of a ray, in degrees.", ge=0)
    dropouts: float = key(0.02, "Share of returns lost at random.", ge=0, le=0.9)
    sensitivity: float = key(1.0, "Above 1, the sensor sees dark and grazed things.", gt=0)
    mixed: float = key(0.1, "Share of rays on an edge that measure something between.", ge=0, le=1)
    beam: float = key(0.17, "Width of a ray, in degrees.", ge=0)

    people: int = key(8, "People who come, go, gather, sit and queue.", ge=0)
    lingering: float = key(0.2, "Share who stand most or all of the time.", ge=0, le=1)
    visiting: float = key(0.0, "Share who are there for some seconds only.", ge=0, le=1)
    seated: int = key(3, "People who sit or stand all the time.", ge=0)
    vehicles: int = key(2, "Cars, forklifts, robots, doors, chairs: wheels.", ge=0)
    glass: float = key(0.5, "How much of a scene is glass.", ge=0, le=1)
    mirrors: float = key(0.2, "How likely mirrors are.", ge=0, le=1)
    clutter: float = key(1.0, "How much stands and lies about.", ge=0, le=3)

    drift_position: float = key(0.015, "Deviation of the pose, in metres.", ge=0)
    drift_angle: float = key(0.1, "Deviation of the heading, in degrees.", ge=0)
    jitter_position: float = key(0.003, "Of each scan alone, in metres.", ge=0)
    jitter_angle: float = key(0.03, "Of each scan alone, in degrees.", ge=0)
    loop_gap: float = key(0.0, "Metres that a loop closure leaves: walls are doubled.", ge=0)

    scan_voxel: float = key(0.0, "Each scan's voxel filter, in metres; 0: none.", ge=0)
    voxel: float = key(0.0, "The map's voxel filter, in metres; 0: none.", ge=0)
    keep: float = key(1.0, "Share of points that the map keeps.", gt=0, le=1)

    @property
    def points(self) -> None:
        """A map has what its scans give, not a number of points that is chosen."""
        return None

    @property
    def expected_points(self) -> int:
        """Points of the map, were every ray to return."""
        return self.scans * self.rays

    def low_activity(self) -> Self:
        """Return another drive through the same scene while only two people walk about."""
        quiet = {"drive": self.drive + 1, "people": min(self.people, 2), "vehicles": 0}
        return self.model_copy(update=quiet)


_ONLY_MESHES = {str(kind) for kind in MeshSceneKind} - {str(kind) for kind in SceneKind}


def load_simulation(settings: Sequence[str]) -> SimulationParameters | MeshParameters:
    """Read `key=value` settings of a simulation.

    Parameters
    ----------
    settings : sequence of str
        A `sensor`, a `kind`, or a `scene` that only meshes have asks for meshes. Their `scene` is
        another word for their `kind`.

    Raises
    ------
    ConfigurationError
        When a setting is unknown or not allowed.
    """
    pairs = [setting.partition("=") for setting in settings]
    scenes = [*map(str, SceneKind), *sorted(_ONLY_MESHES)]
    for name, _, value in pairs:
        if name == "scene" and value not in {*scenes, *map(str, MeshSceneKind)}:
            raise ConfigurationError(f"scene: expected one of {', '.join(scenes)}, found {value!r}")
    meshes = any(
        name in ("sensor", "kind") or (name == "scene" and value in _ONLY_MESHES)
        for name, _, value in pairs
    )
    if not meshes:
        return load_parameters(SimulationParameters, None, settings)
    renamed = [re.sub("^scene=", "kind=", setting) for setting in settings]
    return load_parameters(MeshParameters, None, renamed)


def random_parameters(
    seed: int,
    kind: MeshSceneKind | None = None,
    sensor: SensorKind | None = None,
    mode: DriveMode | None = None,
) -> MeshParameters:
    """Draw a scene, a sensor, its way, what moves, noise, drift and how the map is made.

    The same seed gives the same. A kind, a sensor or a mode that is given stays, and the rest is
    drawn.
    """
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))
    u = random.uniform
    drawn_kind = str(random.choice([str(each) for each in MeshSceneKind]))
    sensors = ["vlp16", "vlp16", "ring32", "ring64", "os64", "mid360", "mid360"]
    drawn_sensor = str(random.choice(sensors))
    kind, sensor = kind or MeshSceneKind(drawn_kind), sensor or SensorKind(drawn_sensor)
    shares = [0.1, 0.2, 0.7] if kind is MeshSceneKind.ROOM else [0.5, 0.35, 0.15]
    drawn_mode = str(random.choice(["through", "stop_and_go", "stand"], p=shares))
    mode = mode or DriveMode(drawn_mode)
    outdoors = not kind.indoors
    vehicle = outdoors and random.random() < 0.5
    few = random.random()
    crowd = 100 if kind is MeshSceneKind.LOBBY else 25
    people = 0 if few < 0.14 else int(u(1, 6)) if few < 0.3 else int(u(4, crowd))
    still = few < 0.12  # nothing moves at all
    keyed = random.random() < 0.5
    good = random.random() < 0.5  # a map as one hopes for: whole scans, small drift, no filter
    scans = int(_log_uniform(random, 60, 300 if good else 500))
    total = _log_uniform(random, *((2e6, 4e6) if good else (4e5, 3e6)))
    if random.random() < 0.25:  # a short, hurried drive: most places are hardly scanned
        scans, total = int(_log_uniform(random, 6, 60)), _log_uniform(random, 8e4, 6e5)
    elif mode is DriveMode.STAND:  # sees the same walls again and again
        total *= u(1, 4)
    voxel = float(random.choice([0.05, 0.05, 0.1, 0.2 if outdoors else 0.1]))
    rays = int(np.clip(total / scans, 2_500, 60_000 if good else 28_000))
    drawn: dict[str, Any] = {"kind": kind, "sensor": sensor, "seed": seed, "mode": mode}
    # In this order: what is drawn later follows from what was drawn before.
    drawn |= {"scans": scans, "rays": rays} | _sensor(random, sensor, vehicle, keyed)
    if sensor is SensorKind.RING64:  # looks 2 degrees up: stands as high as people, or on a car
        drawn["sensor_height"] = max(drawn["sensor_height"], u(1.2, 1.9))
    drawn |= _what_moves(random, mode, outdoors, people, still)
    drawn |= _map_of_scans(random, good, voxel)
    if mode is DriveMode.STAND:
        drawn |= _standing(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(98,))))
    return MeshParameters.model_validate(drawn)


def _sensor(random: Random, kind: SensorKind, vehicle: bool, keyed: bool) -> dict[str, Any]:
    """Draw the way of the sensor, and what it makes of what it meets."""
    u = random.uniform
    return {
        "interval": float(random.choice([0.1, 0.2, 0.5, 1.0])) if not keyed else 0.1,
        "key_distance": u(0.2, 1.0) * (3.0 if vehicle else 1.0) if keyed else 0.0,
        "rate": float(random.choice([5.0, 10.0, 10.0, 20.0])),
        "speed": u(2.5, 9) if vehicle else u(0.5, 1.5),
        "sensor_height": (
            u(1.6, 2.4) if vehicle else float(random.choice([u(0.3, 0.7), u(0.7, 1.3)]))
        ),
        "pitch": u(-5, 30) if kind is SensorKind.MID360 and random.random() < 0.4 else 0.0,
        "wobble": u(0.5, 5) if not vehicle and random.random() < 0.3 else u(0, 0.3),
        "own_body": u(1.2, 2.5) if vehicle else u(0.25, 0.5),
        "max_range": float(random.choice([15, 30, 60, 100])),
        "range_noise": _log_uniform(random, 0.004, 0.03),
        "angle_noise": u(0.0, 0.12),
        "dropouts": u(0, 0.15),
        "sensitivity": _log_uniform(random, 0.4, 3),
        "mixed": u(0, 0.3),
        "beam": u(0.05, 0.25),
    }


def _what_moves(
    random: Random, mode: DriveMode, outdoors: bool, people: int, still: bool
) -> dict[str, Any]:
    """Draw what moves, and what stands about."""
    u = random.uniform
    vehicles = [0, 1, 2, 4, 8] if outdoors else [0, 0, 1, 2, 4]
    return {
        "people": 0 if still else people,
        "lingering": u(0.2, 1.0) if mode is DriveMode.STAND else u(0, 0.4),
        "seated": int(u(0, 8)) if random.random() < 0.5 else 0,
        "vehicles": 0 if still else int(random.choice(vehicles)),
        "glass": u(0, 1),
        "mirrors": u(0, 0.6),
        "clutter": u(0.3, 2.5),
    }


def _map_of_scans(random: Random, good: bool, voxel: float) -> dict[str, Any]:
    """Draw drift, and what becomes of the map's points."""
    u = random.uniform
    return {
        "drift_position": _log_uniform(random, 0.003, 0.02 if good else 0.06),
        "drift_angle": u(0.0, 0.1 if good else 0.3),
        "jitter_position": u(0.0, 0.01),
        "jitter_angle": u(0.0, 0.05 if good else 0.12),
        "loop_gap": u(0.03, 0.15) if random.random() < 0.2 else 0.0,
        "scan_voxel": u(0.05, 0.2) if not good and random.random() < 0.3 else 0.0,
        "voxel": voxel if not good and random.random() < 0.5 else 0.0,
        "keep": u(0.2, 1.0) if not good and random.random() < 0.4 else 1.0,
    }


def _standing(random: Random) -> dict[str, Any]:
    """Draw who passes by a sensor that stands, and whether its scans need no registration."""
    drawn: dict[str, Any] = {}
    if random.random() < 0.6:  # on a tripod: rays meet the same places again and again
        drawn["range_noise"] = _log_uniform(random, 0.0005, 0.01)
        drawn["angle_noise"] = random.uniform(0.0, 0.01)
        still = ("drift_position", "drift_angle", "jitter_position", "jitter_angle")
        drawn |= dict.fromkeys((*still, "wobble", "loop_gap"), 0.0)
    return drawn | {"visiting": random.uniform(0, 1) if random.random() < 0.6 else 0.0}


def _log_uniform(random: Random, low: float, high: float) -> float:
    return float(np.exp(random.uniform(np.log(low), np.log(high))))
