"""The data of the comparison: simulated, recorded, and a scene on which every peer must work."""

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from benchmarks.compare.data.crossing import crossing_scene
from benchmarks.compare.data.recorded import (
    first_half_of_street,
    room_scene,
    second_half_of_street,
    semantickitti_scene,
    standing_street_scene,
    street_scene,
)
from benchmarks.compare.data.simulated import mesh_scene, simulated_scene
from benchmarks.compare.scene import Scene
from pipeline.simulation import SceneKind
from pipeline.simulation.meshes.parameters import MeshSceneKind, SensorKind

__all__ = ["SCENES", "scene_makers"]

_SIMULATED = "simulated-"
RECORDED: dict[str, Callable[[Path], Scene]] = {
    "street-64": street_scene,
    "street-64-first-half": first_half_of_street,
    "street-64-second-half": second_half_of_street,
    "street-64-standing": standing_street_scene,
    "room": room_scene,
    **{
        f"semantickitti-{sequence}": partial(semantickitti_scene, sequence)
        for sequence in ("00", "02", "04", "06", "08", "10")
    },
}
MESHES = {
    f"mesh-{kind.value}-{sensor.value}": (kind, sensor)
    for kind, sensor in (
        (MeshSceneKind.OFFICE, SensorKind.VLP16),
        (MeshSceneKind.LOBBY, SensorKind.MID360),
        (MeshSceneKind.WAREHOUSE, SensorKind.RING64),
        (MeshSceneKind.GARAGE, SensorKind.VLP16),
    )
}
SCENES = ("crossing", *(f"{_SIMULATED}{kind.value}" for kind in SceneKind), *MESHES, *RECORDED)
"""Names that the command line takes."""


def scene_makers(
    names: Sequence[str], seeds: Sequence[int], settings: Sequence[str], maps: Path
) -> list[Callable[[], Scene]]:
    """Return what makes the scenes: all with the first seed, then those that have further ones.

    Parameters
    ----------
    names : sequence of str
        Of `SCENES`.
    seeds : sequence of int
        Of those that are simulated: as many scenes.
    settings : sequence of str
        `key=value`, for the simulation.
    maps : Path
        The folder of recorded maps.
    """
    makers: list[Callable[[], Scene]] = []
    for round_number, seed in enumerate(seeds):
        for name in names:
            if name.startswith(_SIMULATED):
                kind = SceneKind(name.removeprefix(_SIMULATED))
                makers.append(partial(simulated_scene, kind, seed, settings))
            elif name in MESHES:
                makers.append(partial(mesh_scene, *MESHES[name], seed))
            elif round_number == 0:
                recorded = RECORDED.get(name)
                makers.append(partial(recorded, maps) if recorded else crossing_scene)
    return makers
