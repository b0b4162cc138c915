"""Steps 5 and 6: which share of each cluster goes (Eq. 1), and which of its points.

`rank` takes exactly the share that Eq. 1 gives: the least dense points. `stepped` is the paper's
wording of Algorithm 1: from zero, the threshold rises by a step set by the spread of the densities
until the share is reached, so it may take more than the share; less only where all densities are
equal.

The other way to decide, by evidence, takes the points that are likely to have moved.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor, inf
from typing import Literal

import numpy as np
from numpy.typing import NDArray


def removal_percentages(
    counts: Sequence[int], min_percent: float, max_percent: float, neighbours: int = 1
) -> tuple[Fraction, ...]:
    """Rescale point counts to removal percentages (Eq. 1 of the paper).

    R_i = (N_i - N_min) / (N_max - N_min) * (max_percent - min_percent) + min_percent

    Parameters
    ----------
    counts : sequence of int
        N_i, the points of each cluster of the whole map.
    min_percent, max_percent : float
        The percentages of the smallest and of the largest cluster.
    neighbours : int
        k. A cluster of fewer points is not the smallest one, unless all clusters are so small:
        it is a few strays, or a rest, and must not decide how much the others lose.

    Returns
    -------
    tuple of Fraction
        R_i in percent, exact; `min_percent` for all where all counts are equal, and for clusters
        of fewer than k points; zero for empty clusters.
    """
    # The decimal the user wrote, not the binary fraction nearest to it: 0.1 is one tenth.
    low, high = Fraction(str(min_percent)), Fraction(str(max_percent))
    populated = [count for count in counts if count > 0]
    if not populated:
        return tuple(Fraction(0) for _ in counts)
    smallest, largest = smallest_counted(populated, neighbours), max(populated)
    spread = max(largest - smallest, 1)
    return tuple(
        Fraction(max(count - smallest, 0), spread) * (high - low) + low
        if count > 0
        else Fraction(0)
        for count in counts
    )


def smallest_counted(populated: Sequence[int], neighbours: int) -> int:
    """Return N_min of Eq. 1: of the clusters of at least k points, or of all if there are none."""
    return min((count for count in populated if count >= neighbours), default=min(populated))


def removal_count(percentage: Fraction, count: int) -> int:
    """Return floor(R_i / 100 * N_i), the points that a cluster loses."""
    return floor(percentage * count / 100)


STEPS_PER_SPREAD = 100
"""Steps of the `stepped` threshold in one interquartile range of the densities."""


@dataclass(frozen=True, slots=True)
class Removal:
    """What a cluster loses."""

    dynamic: NDArray[np.bool_]
    """(n,): the points removed."""
    threshold: float | None
    """`rank`: the density of the densest point removed, None where none is. `stepped`: the
    threshold reached; the points below it are removed. None where the evidence decides."""


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
    """
    if threshold == "rank":
        return _by_rank(density, rows, percentage)
    return _by_steps(density, percentage)


def remove_likely(score: NDArray[np.float32], confidence: float) -> Removal:
    """Find the points of one cluster whose evidence says that they moved: NaN is kept."""
    return Removal(np.asarray(score >= confidence), None)


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
    wanted = removable_count(percentage, len(density), len(finite))
    if wanted == 0:
        return Removal(np.zeros(len(density), np.bool_), None)
    statistics = [float(finite[rank]) for rank in (*stepped_quartiles(len(finite)), wanted - 1)]
    reached = stepped_threshold(*statistics)
    if reached is None:
        return Removal(np.zeros(len(density), np.bool_), None)
    return Removal(density < reached, reached)


def removable_count(percentage: Fraction, count: int, finite: int) -> int:
    """Return the points that a rising threshold must reach: R_i of N_i, rounded up, if it can."""
    return min(ceil(percentage * count / 100), finite)


def stepped_quartiles(finite: int) -> tuple[int, int, int, int]:
    """Return the ranks, from zero, that set the step: minimum, both quartiles, and maximum.

    They are ranks of densities that occur, so that they can be selected exactly over many tiles.
    """
    last = finite - 1
    return 0, last // 4, 3 * last // 4, last


def stepped_threshold(
    lowest: float, lower_quartile: float, upper_quartile: float, highest: float, wanted: float
) -> float | None:
    """Raise the threshold from zero until it exceeds the density `wanted` (Algorithm 1).

    The step is a hundredth of the interquartile range, or of the whole range where that is zero. A
    standard deviation would depend on the order of a sum, and a few nearly flat hulls of huge
    density would decide it.

    Returns
    -------
    float or None
        The threshold; None where all densities are equal and no step can be taken.
    """
    spread = (upper_quartile - lower_quartile) or (highest - lowest)
    step = spread / STEPS_PER_SPREAD
    return _first_step_above(wanted, step) if step > 0 else None


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
