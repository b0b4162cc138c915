"""The three studies: each varies one parameter and leaves the others at the paper's values."""

from collections.abc import Iterator, Sequence
from time import process_time

import numpy as np
from numpy.typing import NDArray

from benchmarks.studies.labelled import LabelledMap
from dynahull import MethodParameters, clean
from dynahull.removal import removal_percentages, remove_least_dense
from dynahull.result import CleaningResult

__all__ = ["over_clusters", "over_neighbours", "over_ranges"]

ROUNDS = 2


def over_neighbours(made: LabelledMap, choices: Sequence[int]) -> Iterator[tuple[int, float]]:
    """Yield k and the processor time of all steps, microseconds a point, the best of some rounds.

    One thread; the ground step is left out, since k does not matter to it.
    """
    for k in choices:
        sections = {"ground": {"method": "none"}, "neighbours": {"k": k}}
        parameters = MethodParameters.chosen("paper", sections)
        taken = []
        for _ in range(ROUNDS):
            begun = process_time()
            clean(made.xyz, parameters)
            taken.append(process_time() - begun)
        yield k, 1e6 * min(taken) / len(made.xyz)


def over_clusters(
    made: LabelledMap, choices: Sequence[int]
) -> Iterator[tuple[int, float, float, float]]:
    """Yield the number of clusters, mean and variance of the distance to the truth, % removed.

    Eq. 1 removes more or less as clusters differ in size, one alone `min_percent`: the distances
    are to be read beside what was removed.
    """
    for count in choices:
        parameters = MethodParameters.chosen("paper", {"clustering": {"count": count}})
        kept = clean(made.xyz, parameters).kept
        yield count, *made.distances(kept), 100 * float(np.mean(~kept))


def over_ranges(
    made: LabelledMap, choices: Sequence[tuple[float, float]]
) -> Iterator[tuple[float, float, float, float]]:
    """Yield the bounds of Eq. 1, percent, and SA and DA; densities are computed once."""
    cleaned = clean(made.xyz, "paper")
    for low, high in choices:
        accuracy = made.accuracy(_kept(cleaned, low, high))
        assert accuracy.static_accuracy is not None and accuracy.dynamic_accuracy is not None
        yield low, high, accuracy.static_accuracy, accuracy.dynamic_accuracy


def _kept(cleaned: CleaningResult, low: float, high: float) -> NDArray[np.bool_]:
    """Return what other bounds would have kept: steps 5 and 6 once more."""
    percentages = removal_percentages([each.count for each in cleaned.clusters], low, high)
    kept = np.ones(len(cleaned.labels), np.bool_)
    for cluster, percentage in zip(cleaned.clusters, percentages, strict=True):
        rows = np.flatnonzero(cleaned.cluster == cluster.index)
        removal = remove_least_dense(cleaned.density[rows], rows, percentage, "rank")
        kept[rows[removal.dynamic]] = False
    return kept
