"""The LiDAR: where its rays go, and what it makes of the distances they find.

A Velodyne VLP-16 (User Manual 63-9243): 16 lasers from -15 to +15 degrees, 2 degrees apart, fire
together at each azimuth of a rotation.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.parameters import RINGS, SimulationParameters
from pipeline.simulation.shapes import Surface

RING_ELEVATIONS = np.radians(np.linspace(-15.0, 15.0, RINGS))
"""Angle of each ring above the horizon, in radians."""

_REFLECTIVITY = np.zeros(len(Surface))
_REFLECTIVITY[Surface.FLOOR] = 25.0
_REFLECTIVITY[Surface.WALL] = 60.0
_REFLECTIVITY[Surface.CEILING] = 75.0
_REFLECTIVITY[Surface.FURNITURE] = 40.0
_REFLECTIVITY[Surface.PERSON] = 30.0
_REFLECTIVITY[Surface.MACHINE] = 50.0
_REFLECTIVITY[Surface.VEHICLE] = 55.0
_REFLECTIVITY[Surface.VEGETATION] = 45.0
_REFLECTIVITY_SPREAD = 8.0


@dataclass(frozen=True, slots=True)
class Rotation:
    """One turn of the sensor: c firings of all rings, n = 16 c rays in the order of firing.

    Attributes
    ----------
    delay : (c,) float64 array
        Time of each firing since the turn began, in seconds.
    firings : (n,) int64 array
        The firing each ray belongs to.
    directions : (n, 3) float64 array
        Unit vectors in the sensor's frame: x forward, y left, z up.
    """

    delay: NDArray[np.float64]
    firings: NDArray[np.int64]
    directions: NDArray[np.float64]


def rotation(
    parameters: SimulationParameters, columns: int, random: np.random.Generator
) -> Rotation:
    """Turn the sensor once; the azimuth of the first firing is random, as its motor is free."""
    share = (np.arange(columns) + random.random()) / columns
    azimuth = np.repeat(2 * np.pi * share, len(RING_ELEVATIONS))
    elevation = np.tile(RING_ELEVATIONS, columns)
    level = np.cos(elevation)
    return Rotation(
        delay=share / parameters.rotation_rate,
        firings=np.repeat(np.arange(columns), len(RING_ELEVATIONS)),
        directions=np.stack(
            [level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)], axis=1
        ),
    )


def measured_ranges(
    distance: NDArray[np.float64], noise: NDArray[np.float64], parameters: SimulationParameters
) -> NDArray[np.float64]:
    """Return true distances as the sensor reports them, NaN where it reports none; in metres.

    Parameters
    ----------
    distance : (n,) float64 array
        Infinite where a ray meets nothing.
    noise : (n,) float64 array
        Standard normal.
    """
    ranges = distance + noise * parameters.range_noise
    if parameters.range_resolution:
        ranges = np.round(ranges / parameters.range_resolution) * parameters.range_resolution
    within = (distance >= parameters.min_range) & (distance <= parameters.max_range)
    return np.where(within, ranges, np.nan)


def intensities(surface: NDArray[np.uint8], noise: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return the calibrated reflectivity of each return, a whole number from 0 to 255."""
    spread = noise * _REFLECTIVITY_SPREAD
    return np.clip(np.round(_REFLECTIVITY[surface] + spread), 0, 255).astype(np.float32)
