"""The scenes."""

from collections.abc import Callable

import numpy as np

from pipeline.simulation.meshes.parameters import MeshParameters
from pipeline.simulation.meshes.scenes.halls import garage, lobby, stairs, warehouse
from pipeline.simulation.meshes.scenes.outdoors import park, street
from pipeline.simulation.meshes.scenes.rooms import corridor, office, room
from pipeline.simulation.meshes.stage import Stage

_SCENES: dict[str, Callable[[Stage, MeshParameters], None]] = {
    build.__name__: build
    for build in (corridor, garage, lobby, office, park, room, stairs, street, warehouse)
}


def build_stage(parameters: MeshParameters, random: np.random.Generator) -> Stage:
    """Build the scene that the parameters name."""
    stage = Stage(random)
    _SCENES[parameters.kind](stage, parameters)
    return stage
