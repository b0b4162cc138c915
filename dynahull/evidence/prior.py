"""How much of a map moved, judged from the map itself.

The trees know what share of a training map moves. A map may hold a hundred times as much, or nothing
at all; the share is found by expectation maximisation over the odds of all its points (Saerens,
Latinne and Decaestecker, "Adjusting the outputs of a classifier to new a priori probabilities",
Neural Computation 14, 2002), and the odds are shifted to it.
"""

import numpy as np
import numpy.typing as npt

from dynahull.evidence.lattice import Integers

BINS = 512
"""Of the logarithm of the odds, from -LIMIT to LIMIT."""

LIMIT = 16.0

_ROUNDS = 200
_LEAST_SHARE, _MOST_SHARE = 1e-4, 0.6


def odds_counts(log_odds: npt.NDArray[np.float32]) -> Integers:
    """Count points by the logarithm of their odds, (BINS,): of parts of a map, to be added up."""
    scaled = (log_odds.astype(np.float64) + LIMIT) * (BINS / (2 * LIMIT))
    return np.bincount(np.clip(scaled, 0, BINS - 1).astype(np.int64), minlength=BINS)


def prior_shift(counts: Integers, share: float) -> float:
    """Return what is to be added to the logarithms of odds of a map's points.

    Parameters
    ----------
    counts : (BINS,) int64 array
        See `odds_counts`, of all points of the map.
    share : float
        Of points that moved, that the odds were made for.
    """
    total = int(counts.sum())
    if not total:
        return 0.0
    middles = (np.arange(BINS) + 0.5) * (2 * LIMIT / BINS) - LIMIT
    known = float(np.log(share / (1 - share)))
    shift = 0.0
    for _ in range(_ROUNDS):
        moved = float((counts / (1 + np.exp(-(middles + shift)))).sum()) / total
        found = min(max(moved, _LEAST_SHARE), _MOST_SHARE)
        shift = float(np.log(found / (1 - found))) - known
    return shift
