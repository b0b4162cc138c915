"""Let few trees find the points that the many trees of a model judge in the first round.

    python -m benchmarks.training.distilling MANY.json --out dynahull/evidence/model.json
                                             [--seeds 120]

The mean of five models has five times the trees of one. What it says of a point is known without
any truth: so few trees are learnt from what it says of many points of further simulated scenes
(Bucila, Caruana, Niculescu-Mizil: Model Compression, KDD 2006). What they find likely, the many
judge. Prints how the model does, before and after, on scenes that neither has learnt from. The
second round and the trees for dense surroundings stay as they are. `benchmarks.training` ends with
it; by itself, it takes a model that is there.
"""

import argparse
import json
import os
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.density import machine
from benchmarks.training.fitting import (
    FitOptions,
    Stored,
    first_odds,
    retold,
    second_terms,
    stored,
    write_model,
)
from benchmarks.training.judging import Judged, figures
from benchmarks.training.maps import TrainingMap, training_maps
from dynahull.evidence.model import EvidenceModel
from dynahull.evidence.staged_forest import StagedForest
from dynahull.parameters import RemovalParameters

FEW = FitOptions(points=16_000)

LIKELY = -1.0
"""Logarithm of the odds, by the few trees, above which the many are asked."""

FIRST_SEED = 340
"""The first of the scenes that the models which are asked have not learnt from."""

_JUDGED_EVERY = 8
"""One seed in so many is judged, and not learnt from."""


@dataclass(frozen=True, slots=True)
class Told:
    """What a model says of some points: logarithms of odds, (n,), by terms, (n, T)."""

    terms: NDArray[np.float32]
    odds: NDArray[np.float32]

    @classmethod
    def joined(cls, parts: Sequence["Told"]) -> "Told":
        """Put what is said of several maps together."""
        return cls(
            np.concatenate([part.terms for part in parts]),
            np.concatenate([part.odds for part in parts]),
        )


def main() -> None:
    """Ask a model about further scenes, and learn what it says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("many", type=Path, help="the model that is asked")
    parser.add_argument("--out", type=Path, required=True, help="the model that is written")
    parser.add_argument("--seeds", type=int, default=120)
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    arguments = parser.parse_args()
    print(f"{date.today()}, {machine()}")
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    distil(json.loads(arguments.many.read_text()), arguments.out, seeds, arguments.workers)


def distil(many: Stored, out: Path, seeds: range, workers: int) -> None:
    """Put few trees before those of a model, write that, and print how both models do.

    Parameters
    ----------
    seeds : range
        Of the scenes that the model is asked about: it has learnt from none of them.
    """
    begun = time.monotonic()
    told: list[Told] = []
    judged: list[TrainingMap] = []
    with tempfile.TemporaryDirectory() as temporary:
        for each in training_maps(seeds, Path(temporary), workers, timed=False):
            if int(each.name[:-1]) % _JUDGED_EVERY == 0:
                judged.append(each)
                continue
            told.append(ask(each, many, FEW))
            for path in Path(temporary).glob(f"{each.name}.*"):
                path.unlink()  # all of them would take tens of GB
        few = learn(many, told, FEW)
        write_model(few, out)
        print(f"{out}, {time.monotonic() - begun:.0f} s; {len(judged)} further maps judge:")
        for name, model in (("the many", many), ("the few, then the many", few)):
            head, *_, total = _figures(judged, model)
            print(name, head, total, sep="\n", flush=True)


def ask(known: TrainingMap, model: Stored, options: FitOptions) -> Told:
    """Return what the first round of a model says of points of a map, a third of them doubtful."""
    asked = StagedForest.of(model["first"])
    odds = first_odds(asked, known)
    random = np.random.default_rng(len(odds))
    doubtful = np.flatnonzero(odds > options.doubtful)
    third = min(options.points // 3, len(doubtful))
    rows = random.choice(doubtful, third, replace=False)
    others = random.choice(len(odds), min(options.points - third, len(odds)), replace=False)
    rows = np.union1d(rows, others)
    return Told(np.asarray(known.terms[rows][:, : len(asked.terms)]), odds[rows])


def learn(model: Stored, told: Sequence[Told], options: FitOptions) -> Stored:
    """Return a model in which few trees, that say what a model's many said, come before these."""
    first, every = model["first"], Told.joined(told)
    names, trees, leaves = first["terms"], options.first_trees, options.first_leaves
    few = stored(retold(every.terms, every.odds, names, trees, leaves), names)
    likely = {"above": LIKELY} | {name: first[name] for name in few}
    return model | {"first": first | {"quick": options.quick_trees} | few | {"likely": likely}}


def _figures(maps: Sequence[TrainingMap], model: Stored) -> list[str]:
    asked = EvidenceModel.of(model)
    judged = []
    for each in maps:
        terms = second_terms(each, first_odds(asked.first, each), asked.asked)
        judged.append(Judged.of(each, asked.second.log_odds(terms)))
    return list(figures(judged, RemovalParameters().confidence))


if __name__ == "__main__":
    main()
