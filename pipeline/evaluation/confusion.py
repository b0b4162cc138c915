"""Right and wrong decisions, point by point: what moved must go, what is static must stay.

"Positive" means removed: a false positive is a piece of wall that is gone, a false negative a ghost
that is left. So a method that removes less has fewer false positives, as the DynaHull paper (arXiv
2401.07541) says of its adaptive threshold.
"""

import math

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

from pipeline.evaluation.labels import Labels, Truth


def percentage(part: int, whole: int) -> float | None:
    """Return 100 part / whole; None, undefined, where `whole` is 0."""
    return 100 * part / whole if whole else None


def harmonic_mean(first: float | None, second: float | None) -> float | None:
    """Return 2 a b / (a + b); 0 where both are 0, None where one is undefined."""
    if first is None or second is None:
        return None
    return 2 * first * second / (first + second) if first + second else 0.0


class Confusion(BaseModel):
    """The four counts over the labelled points of the original map, and their shares in percent.

    A share with nothing to be a share of is None.

    Attributes
    ----------
    true_positives, false_positives, false_negatives, true_negatives : int
        TP: moved, removed. FP: static, removed. FN: moved, kept. TN: static, kept.
    false_positive_percent : float or None
        100 FP / (FP + TN), of the static points.
    false_negative_percent : float or None
        100 FN / (FN + TP), of the points that moved.
    false_positive_percent_of_all, false_negative_percent_of_all : float or None
        The same counts as shares of all labelled points.
    precision : float or None
        100 TP / (TP + FP), of what was removed.
    recall : float or None
        100 TP / (TP + FN), of what moved.
    f1 : float or None
        Harmonic mean of precision and recall.
    """

    model_config = ConfigDict(frozen=True)

    true_positives: int
    false_positives: int
    false_negatives: int
    true_negatives: int
    false_positive_percent: float | None
    false_negative_percent: float | None
    false_positive_percent_of_all: float | None
    false_negative_percent_of_all: float | None
    precision: float | None
    recall: float | None
    f1: float | None

    @classmethod
    def of(cls, labels: Labels, removed: NDArray[np.bool_]) -> "Confusion":
        """Count the decisions.

        Parameters
        ----------
        labels : (n,) int8 array
            Of `Truth`; points of unknown truth are not counted.
        removed : (n,) bool array
        """
        moved, static = labels == Truth.DYNAMIC, labels == Truth.STATIC
        tp, fp = _count(moved & removed), _count(static & removed)
        fn, tn = _count(moved & ~removed), _count(static & ~removed)
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


class DynamicMapAccuracy(BaseModel):
    """The figures of the DynamicMap benchmark, in percent.

    Zhang, Duberg, Geng, Jia, Wang, Jensfelt: A Dynamic Points Removal Benchmark in Point Cloud Maps
    (ITSC 2023, arXiv 2307.07260), as its code computes them (KTH-RPL/DynamicMap_Benchmark,
    `export_eval_pcd.cpp` and `evaluate_all.py`): a labelled point counts as kept if the cleaned
    map has a point within `match_distance` of it, its own or another's. So a ghost that touches a
    wall is never removed, whatever a method does.

    Attributes
    ----------
    static_accuracy : float or None
        SA, static points kept / static points.
    dynamic_accuracy : float or None
        DA, points that moved and are not kept / points that moved.
    associated_accuracy : float or None
        AA, sqrt(SA DA).
    harmonic_accuracy : float or None
        HA, 2 SA DA / (SA + DA).
    match_distance : float
        Metres.
    """

    model_config = ConfigDict(frozen=True)

    static_accuracy: float | None
    dynamic_accuracy: float | None
    associated_accuracy: float | None
    harmonic_accuracy: float | None
    match_distance: float

    @classmethod
    def of(
        cls, labels: Labels, matched: NDArray[np.bool_], match_distance: float
    ) -> "DynamicMapAccuracy":
        """Take them of labels, (n,), and of whether the cleaned map has a point that near, (n,)."""
        moved, static = labels == Truth.DYNAMIC, labels == Truth.STATIC
        sa = percentage(_count(static & matched), _count(static))
        da = percentage(_count(moved & ~matched), _count(moved))
        return cls(
            static_accuracy=sa,
            dynamic_accuracy=da,
            associated_accuracy=None if sa is None or da is None else math.sqrt(sa * da),
            harmonic_accuracy=harmonic_mean(sa, da),
            match_distance=match_distance,
        )


def _count(chosen: NDArray[np.bool_]) -> int:
    return int(np.count_nonzero(chosen))
