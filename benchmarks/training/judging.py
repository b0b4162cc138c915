"""What a model is worth on kinds of scenes that it has not seen, and what each term earns there."""

from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from benchmarks.training.fitting import (
    FOLDS,
    DenseLesson,
    Lesson,
    Stored,
    Training,
    fold_of,
    second_terms,
)
from benchmarks.training.maps import MOVED, STATIC, TrainingMap
from dynahull.evidence.forest import Forest
from dynahull.evidence.staged_forest import StagedForest

_EDGES = np.array([0.0, 0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0])
_STEPS = 200
_ABLATED_EACH = 5
_STILL = 0.0002
_FEW, _FEW_DENSE = 0.01, 0.002
"""Shares of moving points: below the first nothing moves, and from the others on F1 is asked for;
the last where each place is seen so often that few of its points are of who passed by."""


@dataclass(frozen=True, slots=True)
class Judged:
    """What a model that has not seen its kind makes of a map.

    Attributes
    ----------
    name, kind, sensor : str
    moved, static : (200,) int64 arrays
        Scored points of each probability, in steps of half a hundredth.
    all_moved, all_static : int
        Those that are not scored included.
    """

    name: str
    kind: str
    sensor: str
    moved: NDArray[np.int64]
    static: NDArray[np.int64]
    all_moved: int
    all_static: int

    @classmethod
    def of(cls, each: TrainingMap, odds: NDArray[np.float32]) -> "Judged":
        """Count."""
        step = np.clip((_STEPS / (1 + np.exp(-odds.astype(np.float64)))).astype(int), 0, _STEPS - 1)
        moved, static = (
            np.bincount(step[each.truth == label], minlength=_STEPS) for label in (MOVED, STATIC)
        )
        return cls(
            each.name,
            each.kind,
            each.sensor,
            moved,
            static,
            int(moved.sum()) + each.unscored_moved,
            int(static.sum()) + each.unscored_static,
        )

    @property
    def share(self) -> float:
        """Share of the points that moved."""
        return self.all_moved / max(self.all_moved + self.all_static, 1)

    def f1(self, confidence: float) -> float:
        """Return F1 in percent."""
        first = round(_STEPS * confidence)
        hit, false = int(self.moved[first:].sum()), int(self.static[first:].sum())
        return 200 * hit / max(hit + false + self.all_moved, 1)

    def best_f1(self) -> float:
        """Return F1 at the confidence that would have been best for this map."""
        return max(self.f1(step / _STEPS) for step in range(_STEPS))

    def accuracy(self, confidence: float) -> float:
        """Return AA in percent: the geometric mean of what stays of static and what goes."""
        gone = float(self.moved[round(_STEPS * confidence) :].sum()) / max(self.all_moved, 1)
        return 100 * float(np.sqrt(gone * (1 - self.lost(confidence) / 100)))

    def lost(self, confidence: float) -> float:
        """Return the static points lost, in percent."""
        false = int(self.static[round(_STEPS * confidence) :].sum())
        return 100 * false / max(self.all_static, 1)


def judge(training: Training, seconds: Sequence[Stored], workers: int) -> list[Judged]:
    """Judge the maps of each fold by the two rounds that have not seen it."""
    folds = [fold_of(each) for each in training.maps]

    def of_fold(fold: int) -> list[Judged]:
        forest = Forest.of(seconds[fold])
        return [
            Judged.of(each, forest.log_odds(second_terms(each, odds, training.asked)))
            for each, odds, left_out in zip(training.maps, training.odds, folds, strict=True)
            if left_out == fold
        ]

    with ThreadPoolExecutor(workers) as pool:
        return [each for found in pool.map(of_fold, range(len(FOLDS))) for each in found]


def figures(judged: Sequence[Judged], confidence: float) -> Iterator[str]:
    """Yield a table: a line for each kind of scene, and one for all."""
    yield (
        f"{'left out':<14}{'maps':>5}{'F1 mean':>9}{'median':>8}{'worst':>7}{'best':>7}"
        f"{'AA':>6}  lost where nothing moves"
    )
    kinds = sorted({each.kind for each in judged})
    groups = {kind: [each for each in judged if each.kind == kind] for kind in kinds}
    for name, members in (groups | {"all": list(judged)}).items():
        moving = [each for each in members if each.share >= _FEW]
        f1 = [each.f1(confidence) for each in moving] or [np.nan]
        best = [each.best_f1() for each in moving] or [np.nan]
        accuracy = [each.accuracy(confidence) for each in moving] or [np.nan]
        still = [each.lost(confidence) for each in members if each.share < _STILL] or [np.nan]
        yield (
            f"{name:<14}{len(members):>5}{np.mean(f1):>9.1f}{np.median(f1):>8.1f}{min(f1):>7.1f}"
            f"{np.mean(best):>7.1f}{np.mean(accuracy):>6.1f}  {np.mean(still):.2f} %, "
            f"at most {max(still):.2f}"
        )


def by_confidence(judged: Sequence[Judged]) -> Iterator[str]:
    """Yield what other confidences would give: F1 where something moves, and what is lost else."""
    moving = [each for each in judged if each.share >= _FEW]
    still = [each for each in judged if each.share < _STILL]
    yield "confidence  F1 mean  median  AA mean  lost where nothing moves: mean, median"
    for confidence in (0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9):
        f1 = [each.f1(confidence) for each in moving] or [np.nan]
        accuracy = [each.accuracy(confidence) for each in moving] or [np.nan]
        lost = [each.lost(confidence) for each in still] or [np.nan]
        yield (
            f"{confidence:<10.1f}{np.mean(f1):>9.1f}{np.median(f1):>8.1f}{np.mean(accuracy):>9.1f}"
            f"  {np.mean(lost):.2f} %, {np.median(lost):.2f} %"
        )


def reliability(judged: Sequence[Judged]) -> list[tuple[float, float, int]]:
    """Return, for each range of probabilities, its mean, the share that moved, and the points.

    Each map has the same say, but one of which nothing is known has none.
    """
    judged = [each for each in judged if each.moved.any() or each.static.any()]
    moved = sum(
        (each.moved / (each.moved + each.static).sum() for each in judged), np.zeros(_STEPS)
    )
    static = sum(
        (each.static / (each.moved + each.static).sum() for each in judged), np.zeros(_STEPS)
    )
    counts = sum((each.moved + each.static for each in judged), np.zeros(_STEPS, np.int64))
    middle = (np.arange(_STEPS) + 0.5) / _STEPS
    found = []
    for low, high in pairwise(np.rint(_EDGES * _STEPS).astype(int).tolist()):
        both = moved[low:high] + static[low:high]
        total = max(float(both.sum()), 1e-300)
        found.append(
            (
                float((both * middle[low:high]).sum()) / total,
                float(moved[low:high].sum()) / total,
                int(counts[low:high].sum()),
            )
        )
    return found


def dense_figures(
    training: Training, dense: Sequence[DenseLesson], confidence: float
) -> Iterator[str]:
    """Yield what first rounds make of points among dense surroundings, of kinds left out.

    By the trees for such points, and by those for all others. F1 is the mean over scenes of whose
    points `_FEW_DENSE` moved.
    """
    limit = np.log(confidence / (1 - confidence))
    forests = [StagedForest.of(first) for first in training.first]
    yield f"{'among dense surroundings':<26}{'scenes':>7}{'F1 mean':>9}  lost where nothing moves"
    for name, asked in (("the trees for them", True), ("the trees for all", False)):
        f1, still = [], []
        for each in dense:
            forest, lesson = forests[fold_of(each)], each.lesson
            forest = forest if asked else replace(forest, dense=None)
            removed, weights = forest.log_odds(lesson.terms) >= limit, lesson.weights
            moved, gone = float(weights[lesson.moved].sum()), float(weights[removed].sum())
            hit, total = float(weights[removed & lesson.moved].sum()), float(weights.sum())
            if moved >= _FEW_DENSE * total:
                f1.append(200 * hit / (gone + moved))
            elif moved < _STILL * total:
                still.append(100 * gone / total)
        mean, lost = np.mean(f1 or [np.nan]), np.mean(still or [np.nan])
        yield f"{name:<26}{len(dense):>7}{mean:>9.1f}  {lost:.2f} %"


def ablation(training: Training, workers: int) -> Iterator[str]:
    """Yield what each term earns: the loss of F1, in points, when its values are shuffled.

    Over some points of all maps of a fold, by the first round that has not seen the fold.
    """
    yield f"{'term':<18}" + "".join(f"{kinds[0]:>11}" for kinds in FOLDS) + f"{'mean':>8}"
    lessons = [
        [
            lesson
            for lesson, each in zip(training.lessons, training.maps, strict=True)
            if fold_of(each) == fold
        ]
        for fold in range(len(FOLDS))
    ]
    present = [
        (StagedForest.of(stored), Lesson.joined(of_fold).every(_ABLATED_EACH))
        for stored, of_fold in zip(training.first, lessons, strict=True)
        if of_fold
    ]
    whole = [_f1(forest, lesson, lesson.terms, workers) for forest, lesson in present]
    random = np.random.default_rng(0)
    rows = []
    for number, name in enumerate(training.asked.first):
        earned = []
        for (forest, lesson), full in zip(present, whole, strict=True):
            shuffled = lesson.terms.copy()
            shuffled[:, number] = random.permutation(shuffled[:, number])
            earned.append(full - _f1(forest, lesson, shuffled, workers))
        rows.append((float(np.mean(earned)), name, earned))
    for mean, name, earned in sorted(rows, reverse=True):
        yield f"{name:<18}" + "".join(f"{each:>11.1f}" for each in earned) + f"{mean:>8.1f}"


def _f1(forest: StagedForest, lesson: Lesson, terms: NDArray[np.float32], workers: int) -> float:
    removed = forest.log_odds(terms, workers) > 0
    weights = lesson.weights
    hit = weights[removed & lesson.moved].sum()
    return float(200 * hit / max(weights[removed].sum() + weights[lesson.moved].sum(), 1e-9))
