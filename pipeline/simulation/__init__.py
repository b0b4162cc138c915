"""A simulated LiDAR map with ghosts in it, and the truth about every point.

A robot with a 16-ring LiDAR drives through a building or a street where people walk, stop and
queue, and machines drive. `simulate` gathers its scans into one map, as SLAM would;
`simulate_scans` yields them one by one; `write_simulation` puts everything on disk as a stream.
`pipeline.simulation.meshes` has scenes of triangle meshes, other sensors and other ways to map.
"""

from pipeline.simulation.meshes.parameters import load_simulation
from pipeline.simulation.output import SimulationFiles, write_simulation
from pipeline.simulation.parameters import SimulationParameters
from pipeline.simulation.scans import (
    SimulatedMap,
    SimulatedScan,
    build_scene,
    simulate,
    simulate_scans,
)
from pipeline.simulation.scene import SceneKind, Surface
from pipeline.simulation.tables import Points

__all__ = [
    "Points",
    "SceneKind",
    "SimulatedMap",
    "SimulatedScan",
    "SimulationFiles",
    "SimulationParameters",
    "Surface",
    "build_scene",
    "load_simulation",
    "simulate",
    "simulate_scans",
    "write_simulation",
]
