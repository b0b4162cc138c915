"""The scenes, one module a kind."""

from collections.abc import Callable

import numpy as np

from pipeline.simulation.meshes.parameters import MeshParameters, MeshSceneKind
from pipeline.simulation.meshes.scenes.corridor import corridor
from pipeline.simulation.meshes.scenes.garage import garage
from pipeline.simulation.meshes.scenes.lobby import lobby
from pipeline.simulation.meshes.scenes.office import office
from pipeline.simulation.meshes.scenes.park import park
from pipeline.simulation.meshes.scenes.room import room
from pipeline.simulation.meshes.scenes.stairs import stairs
from pipeline.simulation.meshes.scenes.street import street
from pipeline.simulation.meshes.scenes.warehouse import warehouse
from pipeline.simulation.meshes.stage import Stage

_SCENES: dict[MeshSceneKind, Callable[[Stage, MeshParameters], None]] = {
    MeshSceneKind.CORRIDOR: corridor,
    MeshSceneKind.GARAGE: garage,
    MeshSceneKind.LOBBY: lobby,
    MeshSceneKind.OFFICE: office,
    MeshSceneKind.PARK: park,
    MeshSceneKind.ROOM: room,
    MeshSceneKind.STAIRS: stairs,
    MeshSceneKind.STREET: street,
    MeshSceneKind.WAREHOUSE: warehouse,
}


def build_stage(parameters: MeshParameters, random: np.random.Generator) -> Stage:
    """Build the scene that the parameters name."""
    stage = Stage(random)
    _SCENES[parameters.kind](stage, parameters)
    return stage
