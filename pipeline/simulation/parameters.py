"""What a simulation can be told."""

from typing import Self

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from pipeline.errors import ConfigurationError
from pipeline.simulation.scene import SceneKind

RINGS = 16
"""Lasers of the sensor."""

POINTS_OF_A_BLOCK = 1_000_000
"""Most points that one block of scene gives to a map of a given size."""


class SimulationParameters(BaseModel):
    """The scene, the sensor, the drive and what moves.

    The defaults are a Velodyne VLP-16 (16 rings over 30 degrees, 10 Hz) whose rotations are thinned
    in azimuth and in time to a map of about 190 thousand points. `azimuth_step=0.2
    rotations_per_scan=1` is the sensor as it is.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    scene: SceneKind = Field(
        SceneKind.INDOOR,
        description="`indoor`: one floor of 750 square metres. `storeys`: two floors and a ramp. "
        "`ramp`: a hall with a platform and a ramp. `street`: 120 m of street over a hill.",
    )
    seed: int = Field(
        0, ge=0, description="Seed of the floor plan, all that moves, the noise and the drift."
    )
    drive: int = Field(
        0, ge=0, description="Another number: the same scene, but other people, noise and drift."
    )
    points: int | None = Field(
        None,
        ge=1,
        description="Points of the map, exactly. Blocks of scene with up to a million points each "
        "are put side by side, and `azimuth_step` is chosen to fit. Without it, the map is one "
        "block and has what the scans give.",
    )

    scans: int = Field(
        700, ge=1, description="Scans that enter the map from each block; about, with `points`."
    )
    rotations_per_scan: int = Field(
        4, ge=1, description="Rotations of the sensor from one scan of the map to the next."
    )
    rotation_rate: float = Field(10.0, gt=0, description="Rotations of the sensor, per second.")
    azimuth_step: float = Field(
        20.0, ge=0.1, le=90, description="Angle between two firings of a ring, in degrees."
    )
    sensor_height: float = Field(
        0.9, ge=0.3, le=1.6, description="Height of the sensor above the floor, in metres."
    )
    min_range: float = Field(0.4, ge=0, description="Shortest range that is measured, in metres.")
    max_range: float = Field(100.0, gt=0, description="Longest range that is measured, in metres.")
    range_noise: float = Field(
        0.015, ge=0, description="Standard deviation of a measured range, in metres."
    )
    range_resolution: float = Field(
        0.002, ge=0, description="Step that ranges are rounded to, in metres; 0 for no rounding."
    )

    robot_speed: float = Field(0.9, gt=0, description="Speed of the robot, in metres per second.")
    drift_position: float = Field(
        0.015,
        ge=0,
        description="Standard deviation of the estimated position along each axis, in metres.",
    )
    drift_heading: float = Field(
        0.1, ge=0, description="Standard deviation of the estimated heading, in degrees."
    )

    walkers: int = Field(10, ge=0, description="People who walk and stop, in each block.")
    queuers: int = Field(4, ge=0, le=6, description="People in the queue at the counter.")
    machines: int = Field(
        2,
        ge=0,
        le=4,
        description="Forklifts and automated vehicles indoors, cars and bicycles on the street.",
    )
    glass: bool = Field(
        True, description="Whether panes let rays pass; otherwise they are solid walls."
    )

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
