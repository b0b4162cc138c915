"""The task that weighs the evidence of one tile, and what its second look makes of it.

A tile reduces its points to voxels once, and reads those of the tiles around: see
`dynahull.evidence.summaries`. Points of other tiles are never looked at.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.evidence.lattice import Voxels
from dynahull.evidence.model import FirstRound, Judged, evidence_model, final_scores
from dynahull.evidence.summaries import (
    REACH,
    ScoredPoints,
    around,
    summarise_ground,
    summarise_odds,
    summarise_points,
)
from dynahull.evidence.surroundings import Surroundings
from dynahull.warn import wide_neighbourhoods
from pipeline.tiles.borders import Region
from pipeline.tiles.division import divided
from pipeline.work.folder import TaskReport
from pipeline.work.job import Job

_UNSCORED, _SCORED, _ODDS = "unscored", "scored", "odds"
_POINTS = ("own_xyz", "own_height")
_FIRST = ("log_odds", "kept", "reason")


def unscored_voxels(xyz: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Return what the ground task keeps of points that are not scored."""
    return _arrays(_UNSCORED, summarise_ground(xyz))


def scored_voxels(
    job: Job, tile: int, density: NDArray[np.float64], spread: NDArray[np.float32]
) -> dict[str, NDArray[Any]]:
    """Return what the density task keeps of points that are scored."""
    xyz, height = job.work.load("ground", tile, *_POINTS)
    points = ScoredPoints(xyz, density, spread, height)
    return {"spread": spread} | _arrays(_SCORED, summarise_points(points))


def weigh_tile(job: Job, tile: int, sides: int = 1) -> TaskReport:
    """Judge the points of a tile's core by their own terms, and sum up the outcome.

    Where the memory does not suffice for the tile, `sides` x `sides` parts of it are done one
    after the other. The report counts the points with wide neighbourhoods, and all.
    """
    xyz, height = job.work.load("ground", tile, *_POINTS)
    density, spread = job.work.load("density", tile, "density", "spread")
    points = ScoredPoints(xyz, density, spread, height)
    model, k = evidence_model(), job.configuration.neighbours.k
    found = FirstRound.nothing(len(points))
    everywhere = Region(np.full(2, -np.inf), np.full(2, np.inf))
    for box in divided(everywhere, xyz, sides):
        own = box.holds(xyz)
        voxels = _around(job, tile, box, {"ground": _UNSCORED, "density": _SCORED})
        found.put(own, model.first_round(points.part(own), k, Surroundings.of(voxels)))
    odds = summarise_odds(xyz, found.log_odds)
    kept = {name: getattr(found, name) for name in _FIRST} | _arrays(_ODDS, odds)
    job.work.save("evidence", tile, **kept)
    counts = (wide_neighbourhoods(spread), len(points))
    return TaskReport(int(job.store.layout.counts[tile]), counts)


def judge_tile(job: Job, tile: int) -> Judged:
    """Judge the scored points of a tile's core once more, all tiles being weighed."""
    xyz, _ = job.work.load("ground", tile, *_POINTS)
    (density,) = job.work.load("density", tile, "density")
    found = FirstRound(*job.work.load("evidence", tile, *_FIRST))
    layout = job.store.layout
    core = Region(layout.low[tile], layout.high[tile])
    odds = _around(job, tile, core, {"evidence": _ODDS})
    return Judged(final_scores(evidence_model(), xyz, density, found, odds), found.reason)


def _arrays(name: str, voxels: Voxels) -> dict[str, NDArray[Any]]:
    return {f"{name}_cells": voxels.cells, f"{name}_sums": voxels.sums}


def _around(job: Job, tile: int, box: Region, names: Mapping[str, str]) -> Voxels:
    """Return the voxels that decide about a tile's points in a box, by stage and name.

    They are those of all tiles.
    """
    layout = job.store.layout
    low, high = np.maximum(layout.low[tile], box.low), np.minimum(layout.high[tile], box.high)
    map_array: Callable[..., NDArray[Any]] = job.work.map
    parts = [
        around(
            Voxels(map_array(stage, near, f"{name}_cells"), map_array(stage, near, f"{name}_sums")),
            low,
            high,
        )
        for near in layout.near(low - REACH, high + REACH).tolist()
        for stage, name in names.items()
    ]
    return Voxels.merged(parts)
