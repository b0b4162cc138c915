"""Scenes of triangle meshes, rendered as LiDAR maps with the truth about every point.

Needs Open3D, whose `RaycastingScene` casts the rays: the extra `open3d`.
"""

from pipeline.simulation.meshes.parameters import (
    DriveMode,
    MeshParameters,
    MeshSceneKind,
    SensorKind,
    random_parameters,
)
from pipeline.simulation.meshes.simulate import MeshMap, simulate_meshes

__all__ = [
    "DriveMode",
    "MeshMap",
    "MeshParameters",
    "MeshSceneKind",
    "SensorKind",
    "random_parameters",
    "simulate_meshes",
]
