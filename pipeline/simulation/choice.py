"""Which simulation settings ask for: scenes of boxes, or of meshes."""

from collections.abc import Sequence

from pipeline.configuration.run import load_parameters
from pipeline.simulation.meshes.parameters import MeshParameters, MeshSceneKind
from pipeline.simulation.parameters import SimulationParameters
from pipeline.simulation.scene import SceneKind

_ONLY_MESHES = {str(kind) for kind in MeshSceneKind} - {str(kind) for kind in SceneKind}


def load_simulation(settings: Sequence[str]) -> SimulationParameters | MeshParameters:
    """Read `key=value` settings of a simulation.

    Parameters
    ----------
    settings : sequence of str
        A `sensor`, a `kind`, or a `scene` that only meshes have asks for meshes. Their `scene` is
        another word for their `kind`.

    Raises
    ------
    ConfigurationError
        When a setting is unknown or not allowed.
    """
    pairs = [setting.partition("=") for setting in settings]
    meshes = any(
        key in ("sensor", "kind") or (key == "scene" and value in _ONLY_MESHES)
        for key, _, value in pairs
    )
    if not meshes:
        return load_parameters(SimulationParameters, None, settings)
    renamed = [
        "kind" + setting[5:] if setting.startswith("scene=") else setting for setting in settings
    ]
    return load_parameters(MeshParameters, None, renamed)
