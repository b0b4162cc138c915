"""Where the rays of a sensor go, scan after scan."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pipeline.simulation.meshes.parameters import SensorKind

_RINGS = {
    # Velodyne VLP-16: 2 degrees apart.
    SensorKind.VLP16: np.linspace(-15.0, 15.0, 16),
    # Velodyne HDL-32E: 1.33 degrees apart.
    SensorKind.RING32: np.linspace(-30.67, 10.67, 32),
    # Velodyne HDL-64E: 32 lasers a third of a degree apart, below them 32 half a degree apart.
    SensorKind.RING64: np.concatenate(
        [np.linspace(-24.33, -8.83, 32), np.linspace(-8.33, 2.0, 32)]
    ),
    # Ouster OS1-64: 45 degrees.
    SensorKind.OS64: np.linspace(-22.5, 22.5, 64),
}
_MID360_LOW, _MID360_HIGH = np.radians(-7.0), np.radians(52.0)
_MID360_TURNS = 61.803  # turns of the prism a second, and of its nodding: never in step
_MID360_NODS = 23.607


@dataclass(frozen=True, slots=True)
class Sweep:
    """The rays of one scan.

    Attributes
    ----------
    directions : (n, 3) float64 array
        Unit vectors in the sensor's frame: x ahead, y left, z up.
    share : (n,) float64 array
        When each fires, as a share of the scan.
    """

    directions: NDArray[np.float64]
    share: NDArray[np.float64]


def sweep(
    kind: SensorKind, rays: int, number: int, rate: float, random: np.random.Generator
) -> Sweep:
    """Return the rays of a scan, about so many."""
    if kind is SensorKind.MID360:
        return _rosette(rays, number, rate, random)
    elevations = np.radians(_RINGS[kind])
    columns = max(4, round(rays / len(elevations)))
    share = np.repeat((np.arange(columns) + random.random()) / columns, len(elevations))
    return _directed(2 * np.pi * share, np.tile(elevations, columns), share)


def _rosette(rays: int, number: int, rate: float, random: np.random.Generator) -> Sweep:
    """Return four lines of a turning, nodding beam, which go elsewhere in each scan."""
    share = (np.arange(rays // 4) + 0.5) / (rays // 4)
    time = np.repeat((number * 1.0371 + share) / rate, 4) + random.random() * 1e-3
    line = np.tile(np.arange(4), rays // 4)
    azimuth = 2 * np.pi * (_MID360_TURNS * time + line * 0.0171)
    nod = np.sin(2 * np.pi * (_MID360_NODS * time + line * 0.06))
    # An angle by arcsine: lines are as dense in the middle as at the edges.
    spread = 0.5 + np.arcsin(nod) / np.pi
    elevation = _MID360_LOW + (_MID360_HIGH - _MID360_LOW) * spread
    return _directed(azimuth, elevation, np.repeat(share, 4))


def _directed(
    azimuth: NDArray[np.float64], elevation: NDArray[np.float64], share: NDArray[np.float64]
) -> Sweep:
    flat = np.cos(elevation)
    directions = np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=1
    )
    return Sweep(directions, share)
