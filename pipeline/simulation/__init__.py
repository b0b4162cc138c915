"""A simulated LiDAR map with ghosts in it, and the truth about every point.

A robot with a 16-ring LiDAR drives through an indoor floor plan where people walk, stop and queue.
`simulate` gathers its scans into one map, as SLAM would; `write_simulated_map` puts it on disk.
"""

from pipeline.simulation.output import SimulationFiles, write_simulated_map
from pipeline.simulation.parameters import SimulationParameters
from pipeline.simulation.scene import Surface
from pipeline.simulation.simulate import SimulatedMap, SimulatedScan, simulate, simulate_scans

__all__ = [
    "SimulatedMap",
    "SimulatedScan",
    "SimulationFiles",
    "SimulationParameters",
    "Surface",
    "simulate",
    "simulate_scans",
    "write_simulated_map",
]
