"""What a simulation of meshes can be told."""

from collections.abc import Sequence
from enum import StrEnum
from typing import Self

from pydantic import BaseModel, ConfigDict, Field

from pipeline.configuration.run import load_parameters
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
    """Sensors: three or more tables of rings, and a pattern that does not repeat."""

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
        0,
        ge=0,
        description="Number of the drive: another one goes through the same scene, with other "
        "people, noise and drift.",
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
