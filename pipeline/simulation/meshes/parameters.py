"""What a simulation of meshes can be told, by settings or drawn widely to learn from."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Any, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from pipeline.configuration.run import load_parameters
from pipeline.errors import ConfigurationError
from pipeline.simulation.parameters import SimulationParameters
from pipeline.simulation.scene import SceneKind


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

    kind: MeshSceneKind = Field(MeshSceneKind.OFFICE, description="The scene.")
    sensor: SensorKind = Field(SensorKind.VLP16, description="The sensor.")
    seed: int = Field(0, ge=0, description="Seed of all that is random.")

    drive: int = Field(
        0, ge=0, description="Another number: the same scene, but other people, noise and drift."
    )

    scans: int = Field(150, ge=1, description="Scans that enter the map.")
    rays: int = Field(
        14_000, ge=64, description="Rays of a scan, about: rings are thinned in azimuth."
    )
    interval: float = Field(0.8, gt=0, description="Least time between two scans, in seconds.")
    key_distance: float = Field(
        0.0, ge=0, description="Way between two scans, in metres; 0 for none: time alone counts."
    )
    rate: float = Field(10.0, gt=0, description="Scans that the sensor makes, per second.")

    mode: DriveMode = Field(DriveMode.THROUGH, description="How the sensor gets about.")
    speed: float = Field(1.0, gt=0, description="Its speed, in metres per second.")
    sensor_height: float = Field(0.9, ge=0.2, le=3, description="Above the ground, in metres.")
    pitch: float = Field(
        0.0, ge=-90, le=90, description="How far the sensor is tilted down ahead, in degrees."
    )
    wobble: float = Field(
        0.0, ge=0, description="Roll and pitch of a hand or a head, in degrees (deviation)."
    )
    own_body: float = Field(
        0.35, ge=0, description="Nothing nearer than this in plan is measured, in metres."
    )

    min_range: float = Field(0.3, ge=0, description="In metres.")
    max_range: float = Field(100.0, gt=0, description="In metres.")
    range_noise: float = Field(0.012, ge=0, description="Deviation of a range, in metres.")
    angle_noise: float = Field(0.05, ge=0, description="Deviation of a ray, in degrees.")
    dropouts: float = Field(0.02, ge=0, le=0.9, description="Share of returns lost at random.")
    sensitivity: float = Field(
        1.0, gt=0, description="How weak a return may be: above 1 sees dark and grazed things."
    )
    mixed: float = Field(
        0.1, ge=0, le=1, description="Share of rays on an edge that measure something between."
    )
    beam: float = Field(0.17, ge=0, description="Width of a ray, in degrees.")

    people: int = Field(8, ge=0, description="People who come, go, gather, sit and queue.")
    lingering: float = Field(
        0.2, ge=0, le=1, description="Share of them who stand at one place most or all of the time."
    )
    visiting: float = Field(
        0.0, ge=0, le=1, description="Share of them who are there for some seconds only."
    )
    seated: int = Field(3, ge=0, description="People who sit or stand all the time.")
    vehicles: int = Field(2, ge=0, description="Cars, forklifts, robots, doors, chairs: wheels.")
    glass: float = Field(0.5, ge=0, le=1, description="How much of a scene is glass.")
    mirrors: float = Field(0.2, ge=0, le=1, description="How likely mirrors are.")
    clutter: float = Field(1.0, ge=0, le=3, description="How much stands and lies about.")

    drift_position: float = Field(0.015, ge=0, description="Deviation of the pose, in metres.")
    drift_angle: float = Field(0.1, ge=0, description="Deviation of the heading, in degrees.")
    jitter_position: float = Field(0.003, ge=0, description="Of each scan alone, in metres.")
    jitter_angle: float = Field(0.03, ge=0, description="Of each scan alone, in degrees.")
    loop_gap: float = Field(
        0.0, ge=0, description="What a loop closure leaves open, in metres: walls are doubled."
    )

    scan_voxel: float = Field(
        0.0, ge=0, description="Each scan's voxel filter, in metres; 0: none."
    )
    voxel: float = Field(0.0, ge=0, description="The map's voxel filter, in metres; 0 for none.")
    keep: float = Field(1.0, gt=0, le=1, description="Share of points that the map keeps.")

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
    for key, _, value in pairs:
        if key == "scene" and value not in {*scenes, *map(str, MeshSceneKind)}:
            raise ConfigurationError(f"scene: expected one of {', '.join(scenes)}, found {value!r}")
    meshes = any(
        key in ("sensor", "kind") or (key == "scene" and value in _ONLY_MESHES)
        for key, _, value in pairs
    )
    if not meshes:
        return load_parameters(SimulationParameters, None, settings)
    renamed = [
        "kind" + setting[5:] if setting.startswith("scene=") else setting for setting in settings
    ]
    return load_parameters(MeshParameters, None, renamed)


def random_parameters(
    seed: int, kind: MeshSceneKind | None = None, sensor: SensorKind | None = None
) -> MeshParameters:
    """Draw a scene, a sensor, its way, what moves, noise, drift and how the map is made.

    The same seed gives the same. A kind or a sensor that is given stays, and the rest is drawn.
    """
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(99,)))
    u = random.uniform
    drawn_kind = str(random.choice([str(each) for each in MeshSceneKind]))
    sensors = ["vlp16", "vlp16", "ring32", "ring64", "os64", "mid360", "mid360"]
    drawn_sensor = str(random.choice(sensors))
    kind, sensor = kind or MeshSceneKind(drawn_kind), sensor or SensorKind(drawn_sensor)
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
    rays = int(np.clip(total / scans, 2_500, 60_000 if good else 28_000))
    drawn: dict[str, Any] = {"kind": kind, "sensor": sensor, "seed": seed, "mode": mode}
    drawn |= {"scans": scans, "rays": rays}
    # In this order: what is drawn later follows from what was drawn before.
    drawn |= _way_of_sensor(random, sensor, vehicle, keyed)
    drawn |= _measurements(random)
    if sensor is SensorKind.RING64:  # looks 2 degrees up: stands as high as people, or on a car
        drawn["sensor_height"] = max(drawn["sensor_height"], float(u(1.2, 1.9)))
    drawn |= _what_moves(random, mode, outdoors, 0 if still else people, still)
    drawn |= _map_of_scans(random, good, voxel)
    if mode is DriveMode.STAND:
        drawn |= _standing(np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(98,))))
    return MeshParameters.model_validate(drawn)


def _way_of_sensor(
    random: np.random.Generator, sensor: SensorKind, vehicle: bool, keyed: bool
) -> dict[str, Any]:
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


def _standing(random: np.random.Generator) -> dict[str, Any]:
    """Draw who passes by a sensor that stands, and whether its scans need no registration."""
    u = random.uniform
    drawn: dict[str, Any] = {}
    if random.random() < 0.6:  # on a tripod: rays meet the same places again and again
        drawn["range_noise"] = float(np.exp(u(np.log(0.0005), np.log(0.01))))
        drawn["angle_noise"] = float(u(0.0, 0.01))
        still = ("drift_position", "drift_angle", "jitter_position", "jitter_angle")
        drawn |= dict.fromkeys((*still, "wobble", "loop_gap"), 0.0)
    return drawn | {"visiting": float(u(0, 1)) if random.random() < 0.6 else 0.0}


def _measurements(random: np.random.Generator) -> dict[str, Any]:
    """Draw what the sensor makes of what it meets."""
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


def _what_moves(
    random: np.random.Generator, mode: DriveMode, outdoors: bool, people: int, still: bool
) -> dict[str, Any]:
    """Draw what moves, and what stands about."""
    u = random.uniform
    vehicles = [0, 1, 2, 4, 8] if outdoors else [0, 0, 1, 2, 4]
    return {
        "people": people,
        "lingering": float(u(0.2, 1.0) if mode is DriveMode.STAND else u(0, 0.4)),
        "seated": int(u(0, 8)) if random.random() < 0.5 else 0,
        "vehicles": 0 if still else int(random.choice(vehicles)),
        "glass": float(u(0, 1)),
        "mirrors": float(u(0, 0.6)),
        "clutter": float(u(0.3, 2.5)),
    }


def _map_of_scans(random: np.random.Generator, good: bool, voxel: float) -> dict[str, Any]:
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
