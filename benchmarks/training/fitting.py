"""Two rounds of boosted trees.

The second learns from what a first round made of a map that it had not seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sklearn.ensemble import HistGradientBoostingClassifier
from threadpoolctl import threadpool_limits

from benchmarks.training.maps import MOVED, STATIC, TrainingMap
from dynahull.evidence.forest import Forest
from dynahull.evidence.model import KEPT_TERMS, SECOND_TERMS, EvidenceModel
from dynahull.evidence.pooling import pooled_terms
from dynahull.evidence.summaries import summarise_odds
from dynahull.evidence.terms import TERMS

_KEPT = np.array([TERMS.index(name) for name in KEPT_TERMS])
_BATCH = 100_000


@dataclass(frozen=True, slots=True)
class FitOptions:
    """How much is learnt.

    Attributes
    ----------
    points : int
        Of each map, at most a third of them moved.
    first_trees, second_trees, first_leaves, second_leaves : int
    """

    points: int = 6_000
    first_trees: int = 120
    first_leaves: int = 24
    second_trees: int = 60
    second_leaves: int = 12


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


def fit(
    maps: Sequence[TrainingMap], options: FitOptions, without: Sequence[str] = ()
) -> dict[str, Any]:
    """Fit both rounds, and return what the model's data file holds.

    Parameters
    ----------
    maps : sequence of TrainingMap
    options : FitOptions
    without : sequence of str
        Terms that are kept from the model, for an ablation.
    """
    random = np.random.default_rng(0)
    samples = [Sample.of(each.truth, options.points, random) for each in maps]
    seeds = sorted({each.name[:-1] for each in maps})
    halves = [set(seeds[::2]), set(seeds[1::2])]
    odds: list[NDArray[np.float32]] = [np.zeros(0, np.float32)] * len(maps)
    for half in halves:
        chosen = [number for number, each in enumerate(maps) if each.name[:-1] in half]
        other = Forest.of(_first(maps, samples, chosen, options, without))
        for number in set(range(len(maps))) - set(chosen):
            odds[number] = first_odds(other, maps[number])
    second = [
        second_terms(each, found)[sample.rows]
        for each, found, sample in zip(maps, odds, samples, strict=True)
    ]
    return {
        "first": _first(maps, samples, range(len(maps)), options, without),
        "second": _fitted(
            _blanked(np.concatenate(second), SECOND_TERMS, without),
            np.concatenate([m.truth[s.rows] == MOVED for m, s in zip(maps, samples, strict=True)]),
            np.concatenate([sample.weights for sample in samples]),
            SECOND_TERMS,
            options.second_trees,
            options.second_leaves,
        ),
    }


def judged(model: EvidenceModel, each: TrainingMap) -> NDArray[np.float32]:
    """Return the logarithms of odds that a model gives the points of a map."""
    return model.second.log_odds(second_terms(each, first_odds(model.first, each)), threads=2)


def first_odds(forest: Forest, each: TrainingMap) -> NDArray[np.float32]:
    """Return what a first round makes of a map."""
    begins = range(0, len(each.terms), _BATCH)
    parts = [np.ascontiguousarray(each.terms[begin : begin + _BATCH]) for begin in begins]
    return np.concatenate([forest.log_odds(part, threads=2) for part in parts])


def second_terms(each: TrainingMap, odds: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the terms of the second round of all points."""
    pooled = pooled_terms(each.xyz, summarise_odds(each.xyz, odds))
    return np.column_stack([odds, pooled, each.terms[:, _KEPT]])


def _first(
    maps: Sequence[TrainingMap],
    samples: Sequence[Sample],
    chosen: Sequence[int],
    options: FitOptions,
    without: Sequence[str],
) -> dict[str, Any]:
    return _fitted(
        _blanked(np.concatenate([maps[n].terms[samples[n].rows] for n in chosen]), TERMS, without),
        np.concatenate([maps[n].truth[samples[n].rows] == MOVED for n in chosen]),
        np.concatenate([samples[n].weights for n in chosen]),
        TERMS,
        options.first_trees,
        options.first_leaves,
    )


def _blanked(
    terms: NDArray[np.float32], names: Sequence[str], without: Sequence[str]
) -> NDArray[np.float32]:
    for name in without:
        if name in names:
            terms[:, names.index(name)] = 0.0
    return terms


def _fitted(
    terms: NDArray[np.float32],
    moved: NDArray[np.bool_],
    weights: NDArray[np.float64],
    names: Sequence[str],
    trees: int,
    leaves: int,
) -> dict[str, Any]:
    model = HistGradientBoostingClassifier(
        max_iter=trees,
        max_leaf_nodes=leaves,
        learning_rate=0.1,
        min_samples_leaf=60,
        l2_regularization=1.0,
        early_stopping=False,
        random_state=0,
    )
    with threadpool_limits(1):  # threads that wait for each other take more time than they save
        model.fit(terms, moved, sample_weight=weights)
    # scikit-learn has no public way to read its trees; the tests compare ours with its own odds.
    return {
        "terms": list(names),
        "baseline": round(float(model._baseline_prediction.ravel()[0]), 6),
        "trees": [_nodes(predictor.nodes, names) for (predictor,) in model._predictors],
    }


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
        limit = round(float(node["num_threshold"]), 6)
        found[place] = [names[node["feature_idx"]], limit, second, missing, round(mean, 4)]
        return float(mean)

    walk(0)
    return found
