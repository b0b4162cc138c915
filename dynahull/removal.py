"""Step 6: the least dense points of each cluster are dynamic.

`rank` takes exactly the share that Eq. 1 gives. `stepped` is the paper's wording of Algorithm 1:
from zero, the threshold rises by a step set by the spread of the densities until the share is
reached, so it may take more than the share, never less.
"""

from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor, inf
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from dynahull.rescale import removal_count

STEPS_PER_SPREAD = 100
"""Steps of the `stepped` threshold in one interquartile range of the densities."""


@dataclass(frozen=True, slots=True)
class Removal:
    """What a cluster loses.

    Attributes
    ----------
    dynamic : (n,) bool array
        The points removed.
    threshold : float or None
        `rank`: the density of the densest point removed, None where none is. `stepped`: the
        threshold reached; the points below it are removed.
    """

    dynamic: NDArray[np.bool_]
    threshold: float | None


def remove_least_dense(
    density: NDArray[np.float64],
    rows: NDArray[np.int64],
    percentage: Fraction,
    threshold: Literal["rank", "stepped"],
) -> Removal:
    """Find the dynamic points of one cluster.

    Points of infinite density (a hull of no volume) are dense and kept, even where the percentage
    would reach them; points of no density (NaN, unscored) are kept.

    Parameters
    ----------
    density : (n,) float64 array
        k / v of every point of the cluster.
    rows : (n,) int64 array
        Row numbers; of equally dense points the one with the smaller goes first.
    percentage : Fraction
        R_i of Eq. 1.
    threshold : {"rank", "stepped"}
        How the threshold is found.

    Returns
    -------
    Removal
    """
    if threshold == "rank":
        return _by_rank(density, rows, percentage)
    return _by_steps(density, percentage)


def _by_rank(
    density: NDArray[np.float64], rows: NDArray[np.int64], percentage: Fraction
) -> Removal:
    dynamic = np.zeros(len(density), np.bool_)
    removable = int(np.count_nonzero(np.isfinite(density)))
    count = min(removal_count(percentage, len(density)), removable)
    if count == 0:
        return Removal(dynamic, None)
    # NaN and infinity sort last, so the count-th value is a finite density.
    last = np.partition(density, count - 1)[count - 1]
    dynamic[density < last] = True
    tied = np.flatnonzero(density == last)
    missing = count - int(np.count_nonzero(dynamic))
    dynamic[tied[np.argsort(rows[tied])[:missing]]] = True
    return Removal(dynamic, float(last))


def _by_steps(density: NDArray[np.float64], percentage: Fraction) -> Removal:
    finite = np.sort(density[np.isfinite(density)])
    wanted = min(ceil(percentage * len(density) / 100), len(finite))
    step = _step(finite)
    if wanted == 0 or step == 0:
        return Removal(np.zeros(len(density), np.bool_), None)
    reached = _first_step_above(float(finite[wanted - 1]), step)
    return Removal(density < reached, reached)


def _step(finite: NDArray[np.float64]) -> float:
    """Return the step: a hundredth of the interquartile range, of the whole range where that is 0.

    The quartiles are densities that occur, so that they can be selected exactly over many tiles; a
    standard deviation would depend on the order of a sum, and a few nearly flat hulls of huge
    density would decide it.
    """
    if not len(finite):
        return 0.0
    last = len(finite) - 1
    quartile_range = finite[3 * last // 4] - finite[last // 4]
    spread = quartile_range or finite[-1] - finite[0]
    return float(spread) / STEPS_PER_SPREAD


def _first_step_above(density: float, step: float) -> float:
    """Return the first multiple of the step above a density: the loop of Algorithm 1, at once."""
    steps = density / step
    if steps >= 2.0**52:
        # Steps finer than the density's own rounding: the next number is the next step.
        return float(np.nextafter(density, inf))
    number = floor(steps)
    while number * step <= density:
        number += 1
    return number * step
