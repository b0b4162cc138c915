"""The map as it is: what any method has to better."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method
from benchmarks.compare.scene import Scene

__all__ = ["METHODS"]


def _remove(scene: Scene) -> NDArray[np.bool_]:
    return np.zeros(len(scene), dtype=np.bool_)


METHODS = (Method("nothing removed", Family.BASELINE, lambda: _remove),)
