"""What a simulation can be told."""

from pydantic import BaseModel, ConfigDict, Field


class SimulationParameters(BaseModel):
    """The sensor, the drive and the people of a simulation.

    The defaults are a Velodyne VLP-16 (16 rings over 30 degrees, 10 Hz) whose rotations are thinned
    in azimuth and in time to a map of about 190 thousand points.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    seed: int = Field(0, ge=0, description="Seed of the people, the noise and the drift.")

    scans: int = Field(700, ge=1, description="Scans that enter the map.")
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

    walkers: int = Field(10, ge=0, description="People who walk and stop about the building.")
    queuers: int = Field(4, ge=0, le=6, description="People in the queue at the counter.")
    glass: bool = Field(
        True, description="Whether panes let rays pass; otherwise they are solid walls."
    )

    @property
    def scan_interval(self) -> float:
        """Time from one scan of the map to the next, in seconds."""
        return self.rotations_per_scan / self.rotation_rate

    @property
    def duration(self) -> float:
        """Time from the first scan to the end of the last rotation, in seconds."""
        return (self.scans - 1) * self.scan_interval + 1 / self.rotation_rate
