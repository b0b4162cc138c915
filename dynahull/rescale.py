"""Step 5: the removal percentage of each cluster, rescaled from its point count (Eq. 1)."""

from collections.abc import Sequence
from fractions import Fraction
from math import floor


def removal_percentages(
    counts: Sequence[int], min_percent: float, max_percent: float
) -> tuple[Fraction, ...]:
    """Rescale point counts to removal percentages (Eq. 1 of the paper).

    R_i = (N_i - N_min) / (N_max - N_min) * (max_percent - min_percent) + min_percent

    Parameters
    ----------
    counts : sequence of int
        N_i, the points of each cluster of the whole map. Empty clusters take no part in the
        minimum: a cluster that does not exist is not the smallest one.
    min_percent, max_percent : float
        The percentages of the smallest and of the largest cluster.

    Returns
    -------
    tuple of Fraction
        R_i in percent, exact; `min_percent` for all where all counts are equal, zero for empty
        clusters.
    """
    # The decimal the user wrote, not the binary fraction nearest to it: 0.1 is one tenth.
    low, high = Fraction(str(min_percent)), Fraction(str(max_percent))
    populated = [count for count in counts if count > 0]
    if not populated:
        return tuple(Fraction(0) for _ in counts)
    smallest, largest = min(populated), max(populated)
    spread = max(largest - smallest, 1)
    return tuple(
        Fraction(count - smallest, spread) * (high - low) + low if count > 0 else Fraction(0)
        for count in counts
    )


def removal_count(percentage: Fraction, count: int) -> int:
    """Return floor(R_i / 100 * N_i), the points that a cluster loses."""
    return floor(percentage * count / 100)
