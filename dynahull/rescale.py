"""Step 5: the removal percentage of each cluster, rescaled from its point count (Eq. 1)."""

from collections.abc import Sequence
from fractions import Fraction
from math import floor


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
