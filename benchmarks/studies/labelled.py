"""A simulated map with its truth, and what it is worth once points are removed from it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from pipeline.configuration.run import load_parameters
from pipeline.evaluation.scoring import DynamicMapAccuracy, Tally
from pipeline.evaluation.truth import Truth
from pipeline.simulation import SimulationParameters, simulate

__all__ = ["LabelledMap", "labelled_map"]

MATCH_DISTANCE = 0.05
"""Metres, of the DynamicMap benchmark."""


@dataclass(frozen=True, slots=True)
class LabelledMap:
    """A map with the truth about every point.

    Attributes
    ----------
    xyz : (N, 3) float64 array
        Metres.
    labels : (N,) int8 array
        `pipeline.evaluation.truth.Truth`.
    to_truth : (N,) float64 array
        Distance to the nearest static point, metres.
    """

    xyz: NDArray[np.float64]
    labels: NDArray[np.int8]
    to_truth: NDArray[np.float64]

    def distances(self, kept: NDArray[np.bool_]) -> tuple[float, float]:
        """Return mean, mm, and variance, mm², of the distance to the truth of what is kept."""
        of_kept = 1000 * self.to_truth[kept]
        return float(of_kept.mean()), float(of_kept.var())

    def accuracy(self, kept: NDArray[np.bool_]) -> DynamicMapAccuracy:
        """Return SA and DA of what is kept."""
        matched = kept.copy()
        away, _ = cKDTree(self.xyz[kept]).query(
            self.xyz[~kept], distance_upper_bound=MATCH_DISTANCE
        )
        matched[~kept] = np.isfinite(away)
        return DynamicMapAccuracy.of(Tally().add(self.labels, matched), MATCH_DISTANCE)


def labelled_map(settings: list[str]) -> LabelledMap:
    """Simulate a map; `settings` are `key=value` of `SimulationParameters`."""
    made = simulate(load_parameters(SimulationParameters, None, settings))
    xyz = made.xyz.astype(np.float64)
    moving = made.moving == 1
    to_truth = np.zeros(len(xyz))
    to_truth[moving], _ = cKDTree(xyz[~moving]).query(xyz[moving])
    labels = np.where(moving, Truth.DYNAMIC, Truth.STATIC).astype(np.int8)
    return LabelledMap(xyz, labels, to_truth)
