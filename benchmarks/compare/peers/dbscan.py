"""DBSCAN of scikit-learn: what belongs to no cluster, or to a small one, is taken for a ghost."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Family, Method, Removal, versions_of
from benchmarks.compare.scene import Scene

__all__ = ["METHODS"]

EPS = 0.1
"""Metres; scikit-learn keeps all neighbours of all points in memory, which bounds it."""

MIN_SAMPLES = 10

SMALLEST = 500
"""Points of the smallest cluster that is kept: a person is a cluster too."""


def _load() -> Removal:
    from sklearn.cluster import DBSCAN  # noqa: PLC0415

    def remove(scene: Scene) -> NDArray[np.bool_]:
        clusters = DBSCAN(eps=EPS, min_samples=MIN_SAMPLES, n_jobs=-1).fit_predict(scene.xyz)
        sizes = np.bincount(clusters + 1)
        sizes[0] = 0  # noise
        return np.asarray(sizes[clusters + 1] < SMALLEST)

    return remove


METHODS = (
    Method(
        f"DBSCAN ({EPS} m, {MIN_SAMPLES}; under {SMALLEST})",
        Family.MAP,
        _load,
        version=versions_of("scikit-learn"),
    ),
)
