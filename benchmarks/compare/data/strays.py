"""The simplest scene for who has the map only: single points in the air above a dense floor.

A method that takes away what has few neighbours must find them and leave the floor; if it does not,
it is called wrongly.
"""

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.scene import Scene
from pipeline.evaluation.truth import Truth

__all__ = ["strays_scene"]

_SPACING = 0.03
_NOISE = 0.005
_APART = 1.0
_HEIGHTS = (1.0, 2.0, 3.0)


def strays_scene(side: float = 6.0, seed: int = 0) -> Scene:
    """Lay a floor, and hang points above it, a metre from the floor and from each other.

    Parameters
    ----------
    side : float
        Of the floor, metres; points of it lie 3 cm apart.
    seed : int
        Of the noise of all points.
    """
    random = np.random.default_rng(seed)
    floor = _lattice(np.arange(0.0, side, _SPACING), (0.0,))
    strays = _lattice(np.arange(_APART / 2, side, _APART), _HEIGHTS)
    xyz = np.concatenate([floor, strays])
    labels = np.repeat([Truth.STATIC, Truth.DYNAMIC], [len(floor), len(strays)])
    return Scene(
        name="strays",
        group="strays",
        xyz=xyz + random.normal(0, _NOISE, xyz.shape),
        labels=labels.astype(np.int8),
        scan=np.zeros(len(xyz), np.int32),
        poses=np.eye(3, 4)[None],
        ring_spacing=1.0,
    )


def _lattice(places: NDArray[np.float64], heights: tuple[float, ...]) -> NDArray[np.float64]:
    return np.stack(np.meshgrid(places, places, heights), axis=-1).reshape(-1, 3)
