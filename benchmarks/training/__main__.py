"""Train the model of the evidence from simulated scenes alone, and say how well it does.

    python -m benchmarks.training --out dynahull/evidence/model.json [--seeds 100] [--keep FOLDER]

Simulates a map a seed (`random_parameters`), cuts it to one size, and measures it as it is and once
more thinned, noisier or downsampled. Then each kind of scene is left out in turn: what a model of
the others makes of it is printed, with how often points of each probability moved. The model of all
kinds is written to `--out`. With `--keep`, maps are kept, and a later call goes on from there; it
takes some 40 MB a map.
"""

import argparse
import json
import os
import tempfile
import time
from collections.abc import Sequence
from datetime import date
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.density import machine
from benchmarks.training.fitting import FitOptions, fit, judged
from benchmarks.training.maps import MOVED, STATIC, TrainingMap, training_maps
from dynahull.evidence.model import EvidenceModel

_EDGES = (0.0, 0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
_FEW = 0.005
"""Share of moving points below which a map counts as one where nothing moves."""


def main() -> None:
    """Make maps, judge what is left out, and write the model."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=100)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--no-left-out", action="store_true", help="write the model only")
    arguments = parser.parse_args()
    print(f"{date.today()}, {machine()}")
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        begun = time.monotonic()
        maps = list(training_maps(seeds, folder, arguments.workers))
        points = sum(len(each.xyz) for each in maps)
        print(f"{len(maps)} maps, {points:,} scored points, {time.monotonic() - begun:.0f} s")
        options = FitOptions()
        if not arguments.no_left_out:
            _leave_out(maps, options)
        begun = time.monotonic()
        stored = fit(maps, options)
        arguments.out.write_text(json.dumps(stored, separators=(",", ":")) + "\n")
        print(f"model of all kinds: {arguments.out}, {time.monotonic() - begun:.0f} s")


def _leave_out(maps: Sequence[TrainingMap], options: FitOptions) -> None:
    """Judge each kind of scene by a model of all others."""
    found: list[NDArray[np.float32]] = []
    truths: list[NDArray[np.int8]] = []
    print("left out     maps  F1 median (least)  lost where nothing moves")
    for kind in sorted({each.kind for each in maps}):
        others = [each for each in maps if each.kind != kind]
        own = [each for each in maps if each.kind == kind]
        if not others:
            continue
        model = EvidenceModel.of(fit(others, options))
        odds = [judged(model, each) for each in own]
        found += odds
        truths += [each.truth for each in own]
        figures = [_figures(each, of_map) for each, of_map in zip(own, odds, strict=True)]
        scores = [f1 for f1, _, share in figures if share >= _FEW] or [np.nan]
        lost = [lost for _, lost, share in figures if share < _FEW] or [np.nan]
        print(
            f"{kind:<12} {len(own):4}  {np.median(scores):5.1f} ({min(scores):.1f})"
            f"        {np.median(lost):.2f} %",
            flush=True,
        )
    _calibration(np.concatenate(found), np.concatenate(truths))


def _figures(each: TrainingMap, odds: NDArray[np.float32]) -> tuple[float, float, float]:
    """Return F1 and the static points lost, in percent, and the share of points that moved."""
    removed = odds > 0
    moved, static = each.truth == MOVED, each.truth == STATIC
    hit = int((removed & moved).sum())
    false = int((removed & static).sum())
    all_moved = int(moved.sum()) + each.unscored_moved
    all_static = int(static.sum()) + each.unscored_static
    f1 = 200 * hit / max(hit + false + all_moved, 1)
    return f1, 100 * false / max(all_static, 1), all_moved / max(all_moved + all_static, 1)


def _calibration(odds: NDArray[np.float32], truth: NDArray[np.int8]) -> None:
    """Print how many points of each probability moved."""
    known = truth > 0
    probability = 1 / (1 + np.exp(-odds[known].astype(np.float64)))
    moved = truth[known] == MOVED
    print("probability  points      moved")
    for low, high in pairwise(_EDGES):
        chosen = (probability >= low) & (probability < high if high < 1 else True)
        share = moved[chosen].mean() if chosen.any() else np.nan
        print(f"{low:.1f} to {high:.1f}   {int(chosen.sum()):10,}  {share:.3f}")


if __name__ == "__main__":
    main()
