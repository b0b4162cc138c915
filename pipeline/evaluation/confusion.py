"""Right and wrong decisions, point by point: what moved must go, what is static must stay.

"Positive" means removed: a false positive is a piece of wall that is gone, a false negative a ghost
that is left. So a method that removes less has fewer false positives, as the DynaHull paper (arXiv
2401.07541) says of its adaptive threshold.
"""

import math
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from pipeline.evaluation.labels import Labels, Truth


def percentage(part: int, whole: int) -> float | None:
    """Return 100 part / whole; None, undefined, where `whole` is 0."""
    return 100 * part / whole if whole else None


def harmonic_mean(first: float | None, second: float | None) -> float | None:
    """Return 2 a b / (a + b); 0 where both are 0, None where one is undefined."""
    if first is None or second is None:
        return None
    return 2 * first * second / (first + second) if first + second else 0.0


class Tally:
    """Points, counted by their truth and by something that is so or not, batch by batch."""

    def __init__(self) -> None:
        self._counts = np.zeros(2 * len(Truth), np.int64)

    def add(self, labels: Labels, so: NDArray[np.bool_]) -> Self:
        """Count some more: their truth, (n,), and whether it is so, (n,)."""
        self._counts += np.bincount(2 * labels.astype(np.intp) + so, minlength=len(self._counts))
        return self

    def of(self, truth: Truth) -> tuple[int, int]:
        """Return of how many points of a truth it is not so, and of how many it is."""
        return int(self._counts[2 * truth]), int(self._counts[2 * truth + 1])


class Confusion(BaseModel, frozen=True):
    """The four counts over the labelled points of the original map, and their shares in percent.

    A share with nothing to be a share of is None.
    """

    true_positives: int
    false_positives: int
    false_negatives: int
    true_negatives: int
    """TP: moved, removed. FP: static, removed. FN: moved, kept. TN: static, kept."""
    false_positive_percent: float | None
    """100 FP / (FP + TN), of the static points."""
    false_negative_percent: float | None
    """100 FN / (FN + TP), of the points that moved."""
    false_positive_percent_of_all: float | None
    false_negative_percent_of_all: float | None
    """The same counts as shares of all labelled points."""
    precision: float | None
    """100 TP / (TP + FP), of what was removed."""
    recall: float | None
    """100 TP / (TP + FN), of what moved."""
    f1: float | None
    """Harmonic mean of precision and recall."""

    def summary(self) -> str:
        """Return the two shares that say most, in words."""
        shares = [
            "undefined" if value is None else f"{value:.1f} %"
            for value in (self.precision, self.recall)
        ]
        return (
            f"precision {shares[0]} (of what was removed, what had moved), "
            f"recall {shares[1]} (of what had moved, what was removed)"
        )

    @classmethod
    def of(cls, decisions: "Tally") -> "Confusion":
        """Take them of the labelled points, counted by truth and by whether they were removed."""
        (tn, fp), (fn, tp) = decisions.of(Truth.STATIC), decisions.of(Truth.DYNAMIC)
        precision, recall = percentage(tp, tp + fp), percentage(tp, tp + fn)
        return cls(
            true_positives=tp,
            false_positives=fp,
            false_negatives=fn,
            true_negatives=tn,
            false_positive_percent=percentage(fp, fp + tn),
            false_negative_percent=percentage(fn, fn + tp),
            false_positive_percent_of_all=percentage(fp, tp + fp + fn + tn),
            false_negative_percent_of_all=percentage(fn, tp + fp + fn + tn),
            precision=precision,
            recall=recall,
            f1=harmonic_mean(precision, recall),
        )


class DynamicMapAccuracy(BaseModel, frozen=True):
    """The figures of the DynamicMap benchmark, in percent.

    Zhang, Duberg, Geng, Jia, Wang, Jensfelt: A Dynamic Points Removal Benchmark in Point Cloud Maps
    (ITSC 2023, arXiv 2307.07260), as its code computes them (KTH-RPL/DynamicMap_Benchmark,
    `export_eval_pcd.cpp` and `evaluate_all.py`): a labelled point counts as kept if the cleaned
    map has a point within `match_distance` of it, its own or another's. So a ghost that touches a
    wall is never removed, whatever a method does.
    """

    static_accuracy: float | None
    """SA, static points kept / static points."""
    dynamic_accuracy: float | None
    """DA, points that moved and are not kept / points that moved."""
    associated_accuracy: float | None
    """AA, sqrt(SA DA)."""
    harmonic_accuracy: float | None
    """HA, 2 SA DA / (SA + DA)."""
    match_distance: float
    """Metres."""

    @classmethod
    def of(cls, matches: "Tally", match_distance: float) -> "DynamicMapAccuracy":
        """Take them of points counted by truth and by whether the cleaned map has one so near."""
        static, moved = matches.of(Truth.STATIC), matches.of(Truth.DYNAMIC)
        sa, da = percentage(static[1], sum(static)), percentage(moved[0], sum(moved))
        return cls(
            static_accuracy=sa,
            dynamic_accuracy=da,
            associated_accuracy=None if sa is None or da is None else math.sqrt(sa * da),
            harmonic_accuracy=harmonic_mean(sa, da),
            match_distance=match_distance,
        )
