"""Train the models of the evidence from simulated scenes alone, and say how well they do.

    python -m benchmarks.training --out dynahull/evidence [--seeds 340] [--keep FOLDER]
                                  [--dense-seeds 220] [--few-seeds 120] [--models posed_model.json]

Simulates a map a seed, cuts a window out of it, and measures that as it is and once more thinned,
noisier or downsampled. Each group of kinds is left out in turn: what a model of the others
makes of it is printed, with how often points of each probability moved and what each term earns.
The mean of these models is sturdier on scenes unlike all of them than one model of all kinds. For
maps without scans, few trees are then put before it: see `benchmarks.training.distilling`. Further
scenes, of sensors that stand indoors, teach what is a ghost in places that were seen thousands of
times. Models for maps whose scans, and whose poses, are known are learnt from those of the maps.
With `--keep`, maps are kept, and that mean; a later call goes on from there; it takes some 150 MB
a seed.
"""

import argparse
import os
import tempfile
import time
from collections.abc import Sequence
from datetime import date
from pathlib import Path

from benchmarks.density import machine
from benchmarks.training.dense import dense_lessons
from benchmarks.training.distilling import distil
from benchmarks.training.fitting import (
    DenseLesson,
    FitOptions,
    Stored,
    averaged,
    fit_seconds,
    train,
    write_model,
)
from benchmarks.training.judging import (
    Judged,
    ablation,
    by_confidence,
    dense_figures,
    figures,
    judge,
    reliability,
)
from benchmarks.training.maps import TrainingMap, training_maps
from dynahull.evidence.model import MAP_FILE, MAP_ONLY, MODELS, AskedTerms
from dynahull.parameters import RemovalParameters


def main() -> None:
    """Make maps, judge what is left out, and write the model."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder of the data files")
    parser.add_argument("--seeds", type=int, default=340)
    parser.add_argument("--first-seed", type=int, default=0)
    parser.add_argument("--dense-seeds", type=int, default=220)
    parser.add_argument("--few-seeds", type=int, default=120, help="further ones, to distil from")
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--workers", type=int, default=len(os.sched_getaffinity(0)))
    models = list(MODELS)
    parser.add_argument("--models", nargs="+", choices=models, default=models)
    parser.add_argument("--plot", type=Path, help="write the reliability plot there (extra: plot)")
    arguments = parser.parse_args()
    print(f"{date.today()}, {machine()}")
    seeds = range(arguments.first_seed, arguments.first_seed + arguments.seeds)
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        begun = time.monotonic()
        wants_scans = arguments.models != [MAP_FILE]
        maps = list(training_maps(seeds, folder, arguments.workers, wants_scans))
        points = sum(len(each.xyz) for each in maps)
        seconds = time.monotonic() - begun
        print(f"{len(maps)} maps, {points:,} scored points, {seconds:.0f} s", flush=True)
        dense_seeds = range(arguments.dense_seeds if MAP_FILE in arguments.models else 0)
        dense = list(dense_lessons(dense_seeds, folder, arguments.workers))
        print(f"{len(dense)} dense scenes, {time.monotonic() - begun:.0f} s", flush=True)
        timed = [each for each in maps if each.is_timed]
        posed = [each.posed() for each in timed]
        for name, known in zip(MODELS, (maps, timed, posed), strict=True):
            if name in arguments.models:
                print(f"\n{name}: {len(known)} maps, {time.monotonic() - begun:.0f} s")
                asked = MODELS[name]
                own = dense if asked is MAP_ONLY else []
                many = learn(known, own, asked, arguments)
                if asked is not MAP_ONLY:
                    write_model(many, arguments.out / name)
                    continue
                write_model(many, folder / name)
                further = range(seeds.stop, seeds.stop + arguments.few_seeds)
                distil(many, arguments.out / name, further, arguments.workers)
        print(f"{time.monotonic() - begun:.0f} s")


def learn(
    maps: Sequence[TrainingMap],
    dense: Sequence[DenseLesson],
    asked: AskedTerms,
    arguments: argparse.Namespace,
) -> Stored:
    """Learn from maps, judge what is left out, and return the mean of all models."""
    # Where scans are known, what they saw takes time as well.
    options = FitOptions() if asked is MAP_ONLY else FitOptions(first_trees=120, quick_trees=40)
    workers = arguments.workers
    training = train(maps, options, workers, asked, dense)
    seconds = fit_seconds(training, options, workers)
    judged = judge(training, seconds, workers)
    confidence = RemovalParameters().confidence
    print(*figures(judged, confidence), sep="\n", flush=True)
    print(*by_confidence(judged), sep="\n")
    if dense:
        print(*dense_figures(training, dense, confidence), sep="\n", flush=True)
    _print_reliability(judged)
    if arguments.plot and asked is MAP_ONLY:
        _plot(judged, arguments.plot)
    print(*ablation(training, workers), sep="\n", flush=True)
    return {"first": averaged(training.first), "second": averaged(seconds)}


def _print_reliability(judged: list[Judged]) -> None:
    """Print how many points of each probability moved, on kinds left out; then by sensor."""
    print("given   moved   points")
    for given, moved, points in reliability(judged):
        print(f"{given:5.2f}   {moved:5.2f}   {points:,}")
    print("sensor     of points given 0.8 or more moved")
    for sensor in sorted({each.sensor for each in judged}):
        of_sensor = [each for each in judged if each.sensor == sensor]
        sure = reliability(of_sensor)[-2:]
        total = max(sum(points for _, _, points in sure), 1)
        print(f"{sensor:<10} {sum(moved * points for _, moved, points in sure) / total:.2f}")


def _plot(judged: list[Judged], path: Path) -> None:
    """Draw the share that moved against the probability given."""
    from matplotlib.figure import Figure  # noqa: PLC0415

    figure = Figure(figsize=(5, 4.5), layout="constrained")
    axes = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="0.7", linewidth=1)
    found = reliability(judged)
    axes.plot([each[0] for each in found], [each[1] for each in found], "o-", label="all maps")
    for sensor in sorted({each.sensor for each in judged}):
        found = reliability([each for each in judged if each.sensor == sensor])
        axes.plot(
            [each[0] for each in found], [each[1] for each in found], linewidth=0.8, label=sensor
        )
    axes.set_xlabel("probability given, on kinds of scenes left out")
    axes.set_ylabel("share that moved")
    axes.legend(fontsize=8)
    figure.savefig(path, dpi=150)


if __name__ == "__main__":
    main()
