"""The scenes, one module a kind."""

from collections.abc import Callable

import numpy as np

from pipeline.simulation.meshes.parameters import MeshParameters, MeshSceneKind
from pipeline.simulation.meshes.scenes.lobby import lobby
from pipeline.simulation.meshes.scenes.office import office
from pipeline.simulation.meshes.scenes.street import street
from pipeline.simulation.meshes.scenes.warehouse import warehouse
from pipeline.simulation.meshes.stage import Stage

_SCENES: dict[MeshSceneKind, Callable[[Stage, MeshParameters], None]] = {
    MeshSceneKind.OFFICE: office,
    MeshSceneKind.LOBBY: lobby,
    MeshSceneKind.WAREHOUSE: warehouse,
    MeshSceneKind.STREET: street,
}


def build_stage(parameters: MeshParameters, random: np.random.Generator) -> Stage:
    """Build the scene that the parameters name."""
    stage = Stage(random)
    _SCENES[parameters.kind](stage, parameters)
    return stage
