"""Why a point was taken for a ghost: which terms raised its odds most, in words."""

import numpy as np
import numpy.typing as npt

from dynahull.evidence.staged_forest import StagedForest
from dynahull.evidence.terms import TIMED_TERMS

REASONS: dict[str, tuple[str, ...]] = {
    "no surface: its neighbours fill a volume": (
        "fill", "thickness", "flatness", "linearity", "offset", "thick", "box_thin", "box_flat",
        "box_linear", "upright", "box_normal",
    ),
    "thicker than what is around": ("thickness_0.6", "thickness_1.2", "thickness_2.4",
                                    "thickness_4.8", "thickness_least"),
    "sparser than what is around": ("density", "density_most", "scale"),
    "seldom met by rays": ("returns", "spread", "growth"),
    "stands free on the floor, at the height of people": ("height", "aloft", "over", "under"),
    "the floor beneath was seen through it": ("ground_seen", "ground_near"),
    "nothing close above or below": ("run", "gap", "filled"),
    "seen by fewer scans than what is around": ("scans",),
    "scans saw through it": ("clearly", "through", "met", "clear_share", "through_share"),
}  # fmt: skip
"""What is said, and the terms that say it: by name, or by the name without the side of a box."""

NO_REASON = 255
"""Of a point whose own terms do not speak for a ghost."""

CANDIDATE = -1.0
"""Logarithm of odds; reasons are looked for from here on: to look for more takes time."""


def _reason_of(term: str) -> int:
    for names in ((term,), (term.rpartition("_")[0], term.partition("_")[0])):
        for number, said_by in enumerate(REASONS.values()):
            if any(name in said_by for name in names):
                return number
    raise ValueError(f"{term}: expected a reason, found none")


_FAMILY = np.array([_reason_of(term) for term in TIMED_TERMS], np.int32)


def reasons(
    forest: StagedForest, terms: npt.NDArray[np.float32], log_odds: npt.NDArray[np.float32]
) -> npt.NDArray[np.uint8]:
    """Return which of `REASONS` raised the odds of each point most, (n,).

    Each question of a tree changes what the tree expects; the changes are added up by reason
    (Saabas 2014).

    Parameters
    ----------
    forest : StagedForest
        Over `TERMS` or `TIMED_TERMS`.
    terms : (n, len(forest.terms)) float32 array
    log_odds : (n,) float32 array
    """
    found = np.full(len(terms), NO_REASON, np.uint8)
    chosen = np.flatnonzero(log_odds > CANDIDATE)
    shares = forest.contributions(terms[chosen], _FAMILY[: len(forest.terms)], len(REASONS))
    found[chosen] = np.where(shares.max(axis=1, initial=0) > 0, shares.argmax(axis=1), NO_REASON)
    return found
