"""What a simulation can be told."""

from typing import Any, Self

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from pipeline.errors import ConfigurationError
from pipeline.simulation.scene import SceneKind

RINGS = 16  # lasers of the sensor
POINTS_OF_A_BLOCK = 1_000_000  # most points that one block of scene gives to a map of a given size


def key(default: Any, description: str, **limits: Any) -> Any:
    """Return a parameter of a simulation: its default, what it means, and what is allowed."""
    return Field(default, description=description, **limits)


class SimulationParameters(BaseModel):
    """The scene, the sensor, the drive and what moves.

    The defaults are a Velodyne VLP-16 (16 rings over 30 degrees, 10 Hz) whose rotations are thinned
    in azimuth and in time to a map of about 190 thousand points. `azimuth_step=0.2
    rotations_per_scan=1` is the sensor as it is.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    scene: SceneKind = key(
        SceneKind.INDOOR,
        "`indoor`: one floor of 750 square metres. `storeys`: two floors and a ramp. "
        "`ramp`: a hall with a platform and a ramp. `street`: 120 m of street over a hill.",
    )
    seed: int = key(0, "Seed of plan, all that moves, noise and drift.", ge=0)
    drive: int = key(0, "Another number: the same scene, but other people, noise and drift.", ge=0)
    points: int | None = key(
        None,
        "Points of the map, exactly. Blocks of scene with up to a million points each are put side "
        "by side, and `azimuth_step` is chosen to fit. Without it, the map is one block and has "
        "what the scans give.",
        ge=1,
    )

    scans: int = key(700, "Scans of each block in the map; about, with `points`.", ge=1)
    rotations_per_scan: int = key(4, "Rotations from one scan of the map to the next.", ge=1)
    rotation_rate: float = key(10.0, "Rotations of the sensor, per second.", gt=0)
    azimuth_step: float = key(20.0, "Degrees between two firings of a ring.", ge=0.1, le=90)
    sensor_height: float = key(0.9, "Metres of the sensor above the floor.", ge=0.3, le=1.6)
    min_range: float = key(0.4, "Shortest range that is measured, in metres.", ge=0)
    max_range: float = key(100.0, "Longest range that is measured, in metres.", gt=0)
    range_noise: float = key(0.015, "Standard deviation of a measured range, in metres.", ge=0)
    range_resolution: float = key(0.002, "Step that ranges are rounded to; 0: none.", ge=0)

    robot_speed: float = key(0.9, "Of the robot, in metres per second.", gt=0)
    drift_position: float = key(0.015, "Deviation of the pose along each axis, in metres.", ge=0)
    drift_heading: float = key(0.1, "Deviation of the estimated heading, in degrees.", ge=0)

    walkers: int = key(10, "People who walk and stop, in each block.", ge=0)
    queuers: int = key(4, "People in the queue at the counter.", ge=0, le=6)
    machines: int = key(2, "Forklifts and AGVs indoors, else cars and bicycles.", ge=0, le=4)
    glass: bool = key(True, "Whether panes let rays pass; otherwise they are solid walls.")

    @field_validator("azimuth_step")
    @classmethod
    def _has_an_effect(cls, step: float, info: ValidationInfo) -> float:
        """Refuse a step where `points` chooses it, but for the default that a file may hold."""
        points = info.data.get("points")
        if points is not None and step != cls.model_fields["azimuth_step"].default:
            raise ValueError(f"it has no effect with points={points}, which chooses it to fit")
        return step

    @property
    def scan_interval(self) -> float:
        """Time from one scan of the map to the next, in seconds."""
        return self.rotations_per_scan / self.rotation_rate

    @property
    def columns(self) -> int:
        """Firings of each ring in a rotation."""
        return round(360.0 / self.azimuth_step)

    @property
    def expected_points(self) -> int:
        """Points of the map: exactly, or as many as there would be were every ray returned."""
        return self.points or self.scans * self.columns * RINGS

    def low_activity(self) -> Self:
        """Return another drive through the same scene while only two people walk about."""
        quiet = {"drive": self.drive + 1, "walkers": min(self.walkers, 2)}
        return self.model_copy(update={**quiet, "queuers": 0, "machines": 0})


def nothing_seen(least: float, most: float) -> ConfigurationError:
    """Return what to raise where a sensor of these ranges, in metres, sees nothing."""
    return ConfigurationError(
        "simulate: expected something within the sensor's range, found nothing from "
        f"min_range {least:g} to max_range {most:g} m"
    )
