"""Two rounds of boosted trees; the second learns from what a first round made of unseen kinds."""

import json
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingClassifier, HistGradientBoostingRegressor
from threadpoolctl import threadpool_limits

from benchmarks.training.maps import MOVED, STATIC, TrainingMap
from dynahull.evidence.model import FIRST_ODDS, MAP_ONLY, AskedTerms, pooled_terms
from dynahull.evidence.staged_forest import StagedForest
from dynahull.evidence.summaries import FINEST, summarise_odds
from dynahull.evidence.terms import FALLING, RISING, places_of
from dynahull.evidence.voxels import cells_of

_BATCH = 100_000

_SURE = 9.0
"""A logarithm of odds."""

FOLDS = (
    ("office", "corridor"),
    ("lobby", "room"),
    ("warehouse", "garage"),
    ("street", "park", "boxes_street"),
    ("stairs", "boxes_indoor", "boxes_storeys", "boxes_ramp"),
)
"""Kinds of scenes that are left out together: those that are most alike."""

Stored = dict[str, Any]


class _OfAKind(Protocol):
    @property
    def kind(self) -> str: ...


def fold_of(each: _OfAKind) -> int:
    """Return the fold that a map is left out with."""
    return next(number for number, kinds in enumerate(FOLDS) if each.kind in kinds)


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How much is learnt.

    Attributes
    ----------
    points : int
        Of each map, at most a third of them moved.
    first_trees, second_trees, first_leaves, second_leaves : int
    quick_trees : int
        Of the first round: asked about all points.
    doubtful : float
        Logarithm of odds above which the other trees of the first round are asked as well.
    dense_trees, dense_leaves : int
        Of the first round among dense surroundings.
    """

    points: int = 4_000
    first_trees: int = 300
    first_leaves: int = 32
    quick_trees: int = 60
    doubtful: float = -3.5
    dense_trees: int = 100
    dense_leaves: int = 16
    second_trees: int = 100
    second_leaves: int = 16


@dataclass(frozen=True, slots=True)
class Sample:
    """Some points of a map, and weights that give each map the same say and its own shares."""

    rows: NDArray[np.intp]
    weights: NDArray[np.float64]

    @classmethod
    def of(cls, truth: NDArray[np.int8], points: int, random: np.random.Generator) -> "Sample":
        """Draw."""
        rows, weights = [np.zeros(0, np.intp)], [np.zeros(0)]
        moved, static = (np.flatnonzero(truth == label) for label in (MOVED, STATIC))
        few = min(len(moved), points // 3)
        for members, count in ((moved, few), (static, min(len(static), points - few))):
            rows.append(random.choice(members, count, replace=False))
            weights.append(np.full(count, len(members) / max(count, 1)))
        weight = np.concatenate(weights)
        order = np.argsort(np.concatenate(rows))
        return cls(np.concatenate(rows)[order], (weight * points / max(weight.sum(), 1))[order])


@dataclass(frozen=True, slots=True)
class Lesson:
    """What is learnt from: terms of sampled points, whether each moved, and its weight."""

    terms: NDArray[np.float32]
    moved: NDArray[np.bool_]
    weights: NDArray[np.float64]

    @classmethod
    def joined(cls, parts: Sequence["Lesson"]) -> "Lesson":
        """Put those of several maps together."""
        return cls(
            np.concatenate([part.terms for part in parts]),
            np.concatenate([part.moved for part in parts]),
            np.concatenate([part.weights for part in parts]),
        )

    def every(self, step: int) -> "Lesson":
        """Return some of the points."""
        return Lesson(self.terms[::step], self.moved[::step], self.weights[::step])


@dataclass(frozen=True, slots=True)
class DenseLesson:
    """What a scene teaches of points among dense surroundings."""

    kind: str
    lesson: Lesson


DENSE_TERM, DENSE = "returns_2.4", 8.0
"""Logarithm of the returns an occupied voxel of 0.1 m, within 1.2 m: some 3,000 of them."""


@dataclass(frozen=True, slots=True)
class Training:
    """Maps, and what a first round that has not seen their kind makes of them.

    Attributes
    ----------
    maps : sequence of TrainingMap
    first : list of dict
        A first round for each fold, fitted without it.
    lessons : list of Lesson
        For the first round, a map each.
    second : list of Lesson
        For the second round.
    odds : list of (n,) float32 arrays
        What the first round that has not seen its kind makes of each map.
    asked : AskedTerms
    """

    maps: Sequence[TrainingMap]
    first: list[Stored]
    lessons: list[Lesson]
    second: list[Lesson]
    odds: list[NDArray[np.float32]]
    asked: AskedTerms


def train(
    maps: Sequence[TrainingMap],
    options: FitOptions,
    workers: int,
    asked: AskedTerms = MAP_ONLY,
    dense: Sequence[DenseLesson] = (),
) -> Training:
    """Fit a first round without each fold, and let it judge that fold."""
    samples = [
        Sample.of(each.truth, options.points, np.random.default_rng(number))
        for number, each in enumerate(maps)
    ]
    lessons = [
        Lesson(
            each.terms[sample.rows, : len(asked.first)],
            each.truth[sample.rows] == MOVED,
            sample.weights,
        )
        for each, sample in zip(maps, samples, strict=True)
    ]
    with ThreadPoolExecutor(workers) as pool:
        folds = range(len(FOLDS))
        one_fold = partial(_one_fold, maps, samples, lessons, dense, options, asked)
        done = list(pool.map(one_fold, folds))
    judged = {number: found for _, of_fold in done for number, found in of_fold.items()}
    numbers = range(len(maps))
    return Training(
        maps,
        [first for first, _ in done],
        lessons,
        [judged[number][0] for number in numbers],
        [judged[number][1] for number in numbers],
        asked,
    )


def _one_fold(
    maps: Sequence[TrainingMap],
    samples: list[Sample],
    lessons: list[Lesson],
    dense: Sequence[DenseLesson],
    options: FitOptions,
    asked: AskedTerms,
    fold: int,
) -> tuple[Stored, dict[int, tuple[Lesson, NDArray[np.float32]]]]:
    others = [lessons[n] for n, each in enumerate(maps) if fold_of(each) != fold]
    first = fit_first(others or lessons, options, asked)
    others_dense = [each for each in dense if fold_of(each) != fold]
    if others_dense:
        first["dense"] = fit_dense(others_dense, options, asked)
    forest = StagedForest.of(first)
    found = {}
    for number, each in enumerate(maps):
        if fold_of(each) == fold:
            rows, lesson = samples[number].rows, lessons[number]
            odds = first_odds(forest, each)
            terms = second_terms(each, odds, asked, rows)
            found[number] = Lesson(terms, lesson.moved, lesson.weights), odds
    return first, found


def fit_first(lessons: Sequence[Lesson], options: FitOptions, asked: AskedTerms) -> Stored:
    """Fit a first round, and return what the data file holds of it."""
    model = boosted(Lesson.joined(lessons), asked.first, options.first_trees, options.first_leaves)
    stages = {"quick": options.quick_trees, "doubtful": options.doubtful}
    return stages | stored(model, asked.first)


def fit_dense(dense: Sequence[DenseLesson], options: FitOptions, asked: AskedTerms) -> Stored:
    """Fit what judges points among dense surroundings in place of the first round."""
    lessons = []
    for each in dense:  # each with the same say, however many of its points are learnt from
        weights = each.lesson.weights * options.points / each.lesson.weights.sum()
        lessons.append(replace(each.lesson, weights=weights))
    learnt = Lesson.joined(lessons)
    model = boosted(learnt, asked.first, options.dense_trees, options.dense_leaves)
    return {"term": DENSE_TERM, "above": DENSE} | stored(model, asked.first)


def fit_seconds(training: Training, options: FitOptions, workers: int) -> list[Stored]:
    """Fit a second round for each fold, without it."""
    folds = [fold_of(each) for each in training.maps]

    def fit(fold: int) -> Stored:
        paired = zip(training.second, folds, strict=True)
        others = [lesson for lesson, left_out in paired if left_out != fold]
        return fit_second(others or training.second, options, training.asked)

    with ThreadPoolExecutor(workers) as pool:
        return list(pool.map(fit, range(len(FOLDS))))


def averaged(models: Sequence[Stored]) -> Stored:
    """Return the model whose odds are the geometric mean of those of others.

    Each of them has not seen some kinds of scenes: where they differ, it is less sure. The quick
    trees of all come first.
    """

    def shared(node: list[Any]) -> list[Any]:
        return [*node[:-1], round(node[-1] / len(models), 6)]

    quick = models[0].get("quick", 0)  # a second round has no stages
    stages = [slice(None, quick), slice(quick, None)]
    trees = [tree for stage in stages for model in models for tree in model["trees"][stage]]
    mean = models[0] | {
        "baseline": sum(model["baseline"] for model in models) / len(models),
        "trees": [[shared(node) for node in tree] for tree in trees],
    }
    if quick:
        mean["quick"] = quick * len(models)
    if "dense" in models[0]:
        mean["dense"] = averaged([model["dense"] for model in models])
    return mean


def fit_second(lessons: Sequence[Lesson], options: FitOptions, asked: AskedTerms) -> Stored:
    """Fit a second round, and return what the data file holds of it."""
    model = boosted(
        Lesson.joined(lessons), asked.second, options.second_trees, options.second_leaves
    )
    return stored(model, asked.second)


def first_odds(forest: StagedForest, each: TrainingMap) -> NDArray[np.float32]:
    """Return what a first round makes of a map."""
    begins = range(0, len(each.terms), _BATCH)
    own = slice(0, len(forest.terms))
    parts = [np.ascontiguousarray(each.terms[begin : begin + _BATCH, own]) for begin in begins]
    return np.concatenate([forest.log_odds(part) for part in parts])


def second_terms(
    each: TrainingMap,
    odds: NDArray[np.float32],
    asked: AskedTerms,
    rows: NDArray[np.intp] | slice = slice(None),
) -> NDArray[np.float32]:
    """Return the terms of the second round of some points, or of all."""
    summed = summarise_odds(each.xyz, odds)
    at = places_of(cells_of(each.xyz[rows], FINEST), summed.cells, summed.table)
    pooled = pooled_terms(summed).take(at, axis=0)
    return np.column_stack([odds[rows], pooled, each.terms[rows][:, asked.kept]])


def boosted(
    lesson: Lesson, names: Sequence[str], trees: int, leaves: int
) -> HistGradientBoostingClassifier:
    """Fit trees that keep to what physics says of single terms."""
    model = HistGradientBoostingClassifier(**_boosting(names, trees, leaves))
    with threadpool_limits(1):  # threads that wait for each other take more time than they save
        model.fit(lesson.terms, lesson.moved, sample_weight=lesson.weights)
    return model


def retold(
    terms: NDArray[np.float32],
    odds: NDArray[np.float32],
    names: Sequence[str],
    trees: int,
    leaves: int,
) -> HistGradientBoostingRegressor:
    """Fit trees to logarithms of odds that others gave, the closer the nearer to even odds.

    Beyond `_SURE` it does not matter how sure the others were.
    """
    model = HistGradientBoostingRegressor(**_boosting(names, trees, leaves))
    probability = 1 / (1 + np.exp(-odds.astype(np.float64)))
    weights = 0.1 + 4 * probability * (1 - probability)
    model.fit(terms, np.clip(odds, -_SURE, _SURE), sample_weight=weights)
    return model


def _boosting(names: Sequence[str], trees: int, leaves: int) -> dict[str, Any]:
    rising = (*RISING, FIRST_ODDS)
    return {
        "max_iter": trees,
        "max_leaf_nodes": leaves,
        "learning_rate": 0.1,
        "min_samples_leaf": 100,
        "l2_regularization": 1.0,
        "early_stopping": False,
        "monotonic_cst": [1 if n in rising else -1 if n in FALLING else 0 for n in names],
        "random_state": 0,
    }


def stored(
    model: HistGradientBoostingClassifier | HistGradientBoostingRegressor, names: Sequence[str]
) -> Stored:
    """Return what the data file holds: scikit-learn has no public way to read its trees."""
    return {
        "terms": list(names),
        "baseline": round(float(np.ravel(model._baseline_prediction)[0]), 6),
        "trees": [_nodes(predictor.nodes, names) for (predictor,) in model._predictors],
    }


def write_model(model: Stored, path: Path) -> None:
    """Write a data file."""
    path.write_text(json.dumps(model, separators=(",", ":")) + "\n")


def _nodes(nodes: NDArray[Any], names: Sequence[str]) -> list[list[Any]]:
    """Return a tree's nodes in depth-first order: see `dynahull.evidence.forest`.

    [value] of a leaf, or [term, limit, right, missing, mean].
    """
    found: list[list[Any]] = []

    def walk(number: int) -> float:
        node = nodes[number]
        if node["is_leaf"]:
            found.append([round(float(node["value"]), 5)])
            return float(node["value"])
        place = len(found)
        found.append([])
        left, right = nodes[node["left"]], nodes[node["right"]]
        mean = walk(node["left"]) * left["count"]
        second = len(found)
        mean = (mean + walk(node["right"]) * right["count"]) / node["count"]
        missing = "left" if node["missing_go_to_left"] else "right"
        limit = float(f"{node['num_threshold']:.9g}")  # tells any two float32 numbers apart
        found[place] = [names[node["feature_idx"]], limit, second, missing, round(mean, 4)]
        return float(mean)

    walk(0)
    return found
