"""DynaHull: every ready configuration, and what becomes of it without its steps.

Without the ground step, the ground is part of the clusters. One cluster is a map without clustering
and without Eq. 1; one rank over all, ground and everything, is the simplest thing that can be done
with the densities.
"""

import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method, Removal, versions_of
from benchmarks.compare.scene import Scene
from dynahull import MethodParameters, clean
from pipeline.configuration.run import load_configuration, ready_configurations

__all__ = ["methods"]

_PAPER = "paper"
_VERSION = versions_of("dynahull-pipeline", "scikit-learn")
_ONE_CLUSTER = ["clustering.count=1", "removal.min_percent=12.5", "removal.max_percent=12.5"]
_WITHOUT_STEPS = {
    "no ground step": ["ground.method=none"],
    "one cluster, 12.5 % removed": _ONE_CLUSTER,
    "one rank over all, 12.5 % removed": [*_ONE_CLUSTER, "ground.method=none"],
}
"""12.5 % is halfway between the bounds of Eq. 1."""


def methods() -> Iterator[Method]:
    """Yield the paper's configuration first, then those that differ from it in the method."""
    seen: list[MethodParameters] = []
    for name in sorted(ready_configurations(), key=lambda name: (name != _PAPER, name)):
        parameters = load_configuration(name).method()
        if parameters not in seen:
            seen.append(parameters)
            yield _method(f"DynaHull, {name}", parameters)
            if parameters.removal.weighs_evidence:
                yield _method(f"DynaHull, {name}, scan numbers", parameters, told=("scan",))
                yield _method(f"DynaHull, {name}, poses", parameters, told=("scan", "poses"))
    for name, settings in _WITHOUT_STEPS.items():
        yield _method(f"DynaHull, {name}", load_configuration(_PAPER, settings).method())


def _method(name: str, parameters: MethodParameters, told: tuple[str, ...] = ()) -> Method:
    def load() -> Removal:
        clean(np.random.default_rng(0).normal(size=(1000, 3)), parameters)  # compiles

        def remove(scene: Scene) -> NDArray[np.bool_]:
            threads = len(os.sched_getaffinity(0))
            more = {each: getattr(scene, each) for each in told}
            return ~clean(scene.xyz, parameters, threads=threads, **more).kept

        return remove

    return Method(name, Family.OURS, load, repr(parameters), _VERSION)
