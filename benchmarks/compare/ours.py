"""DynaHull: every ready configuration, and one rank over the whole map beside them."""

import os
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method, Removal
from benchmarks.compare.scene import Scene
from dynahull import MethodParameters, clean
from pipeline.configuration import load_configuration, ready_configurations

__all__ = ["methods"]

_PAPER = "paper"
_ONE_RANK = "one cluster, 12.5 % removed"


def methods() -> Iterator[Method]:
    """Yield the paper's configuration first, then those that differ from it in the method."""
    seen: list[MethodParameters] = []
    for name in sorted(ready_configurations(), key=lambda name: (name != _PAPER, name)):
        parameters = load_configuration(name).method()
        if parameters not in seen:
            seen.append(parameters)
            yield _method(f"DynaHull, {name}", parameters)
    one_rank = load_configuration(
        _PAPER,
        ["clustering.count=1", "removal.min_percent=12.5", "removal.max_percent=12.5"],
    )
    yield _method(f"DynaHull, {_ONE_RANK}", one_rank.method())


def _method(name: str, parameters: MethodParameters) -> Method:
    def load() -> Removal:
        clean(np.random.default_rng(0).normal(size=(1000, 3)), parameters)  # compiles

        def remove(scene: Scene) -> NDArray[np.bool_]:
            threads = len(os.sched_getaffinity(0))
            return ~clean(scene.xyz, parameters, threads=threads).kept

        return remove

    return Method(name, Family.OURS, load)
