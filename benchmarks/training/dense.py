"""Scenes of sensors that stand indoors and see the same places thousands of times.

What the trees for such places learn from: a map of millions of points for each seed, of which
only a sample is measured, and only what lies among dense surroundings is learnt from.
"""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.training.fitting import DENSE, DENSE_TERM, DenseLesson, Lesson, Sample
from benchmarks.training.maps import (
    MOVED,
    PARAMETERS,
    Random,
    made_of_meshes,
    scored,
    thinned,
    window,
)
from dynahull.evidence.summaries import summarise_ground, summarise_points
from dynahull.evidence.surroundings import Surroundings
from dynahull.evidence.terms import TERMS, evidence
from dynahull.evidence.voxels import Voxels
from pipeline.simulation.meshes import (
    DriveMode,
    MeshParameters,
    MeshSceneKind,
    random_parameters,
)

_KINDS = (
    "room", "office", "room", "corridor", "lobby", "room", "office", "room", "stairs", "room",
    "garage", "lobby", "room", "corridor", "warehouse",
)  # fmt: skip
_MOST = 3_000_000
"""Points of a map."""

_MEASURED, _FEWEST = 24_000, 1_500
"""Points whose terms are measured, and of them among dense surroundings, or nothing is learnt."""


def dense_lessons(seeds: range, folder: Path, workers: int) -> Iterator[DenseLesson]:
    """Simulate scenes and measure them, or read those that lie in the folder already."""
    folder.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(workers) as pool:
        for path in pool.map(partial(_make, folder), seeds):
            with np.load(path) as kept:
                lesson = Lesson(kept["terms"], kept["moved"], kept["weights"])
                kind = str(kept["kind"])
            if len(lesson.terms) >= _FEWEST:
                yield DenseLesson(kind, lesson)


def standing_parameters(seed: int) -> MeshParameters:
    """Draw a scene that a sensor on one spot sees in some hundred scans, while few people walk."""
    random = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(77,)))
    kind = MeshSceneKind(_KINDS[seed % len(_KINDS)])
    drawn: dict[str, Any] = random_parameters(seed, kind, mode=DriveMode.STAND).model_dump()
    scans = int(np.exp(random.uniform(np.log(120), np.log(400))))
    rays = int(np.exp(random.uniform(np.log(1.5e6), np.log(6e6)))) // scans
    few = random.random()
    crowd = 40 if kind in (MeshSceneKind.LOBBY, MeshSceneKind.OFFICE) else 16
    drawn["people"] = int(random.integers(1, 6) if few < 0.6 else random.integers(4, crowd))
    if few < 0.12:
        drawn |= {"people": 0, "vehicles": 0, "seated": 0}
    drawn |= {
        "scans": scans,
        "rays": int(np.clip(rays, 8_000, 40_000)),
        "interval": float(random.choice([0.1, 0.2, 0.5, 1.0])),
        "key_distance": 0.0,
        "lingering": float(random.uniform(0, 1)),
        "scan_voxel": 0.0,
        "voxel": 0.0,
        "keep": 1.0,
    }
    return MeshParameters.model_validate(drawn)


def _make(folder: Path, seed: int) -> Path:
    path = folder / f"dense_{seed:05d}.npz"
    if not path.exists():
        random = np.random.default_rng(seed)
        parameters = standing_parameters(seed)
        lesson = _lesson(parameters, random)
        temporary = path.with_suffix(".part.npz")
        np.savez(
            temporary,
            terms=lesson.terms,
            moved=lesson.moved,
            weights=lesson.weights,
            kind=np.array(str(parameters.kind)),
        )
        temporary.replace(path)
    return path


def _lesson(parameters: MeshParameters, random: Random) -> Lesson:
    made = window(replace(made_of_meshes(parameters), scan=None), random, _MOST)
    if random.random() < 0.4:
        made = thinned(made, random.uniform(0.3, 1), random)
    xyz = np.ascontiguousarray(made.xyz)
    points, rows = scored(xyz, PARAMETERS)
    sample = Sample.of(made.truth[rows], _MEASURED, random)
    ground = np.delete(xyz, rows, axis=0)
    voxels = Voxels.merged([summarise_points(points), summarise_ground(ground)])
    chosen = np.zeros(len(rows), np.bool_)
    chosen[sample.rows] = True
    terms = evidence(points.part(chosen), PARAMETERS.neighbours.k, Surroundings.of(voxels))
    dense = terms[:, TERMS.index(DENSE_TERM)] > DENSE
    moved = made.truth[rows][sample.rows] == MOVED
    return Lesson(terms[dense], moved[dense], sample.weights[dense])
