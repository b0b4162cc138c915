"""The task that weighs the evidence of one tile, and what its second look makes of it.

A tile reduces its points to voxels once, and reads those of the tiles around: see
`dynahull.evidence.summaries`. Points of other tiles are never looked at.
"""

import numpy as np

from dynahull.evidence.lattice import Voxels
from dynahull.evidence.model import (
    EvidenceModel,
    FirstRound,
    Judged,
    evidence_model,
    final_scores,
)
from dynahull.evidence.summaries import (
    REACH,
    ScoredPoints,
    TimedVoxels,
    around,
    summarise_odds,
)
from dynahull.evidence.surroundings import Surroundings
from dynahull.warn import wide_neighbourhoods
from pipeline.tiles.borders import Region
from pipeline.tiles.density import VOXELS, scores_of
from pipeline.tiles.division import divided
from pipeline.tiles.ground import heights_of, own_points, summaries
from pipeline.work.folder import TaskReport
from pipeline.work.job import Job

_ODDS = "odds"
_FIRST = ("log_odds", "kept", "reason")


def weigh_tile(job: Job, tile: int, sides: int = 1) -> TaskReport:
    """Judge the points of a tile's core by their own terms, and sum up the outcome.

    Where the memory does not suffice for the tile, `sides` x `sides` parts of it are done one
    after the other. The report counts the points with wide neighbourhoods, and all.
    """
    xyz = own_points(job, tile).xyz
    (spread,) = job.work.load("spread", tile, "spread")
    _, density = scores_of(job, tile)
    points = ScoredPoints(xyz, density, spread, heights_of(job, tile, xyz))
    model, k = _model(job), job.configuration.neighbours.k
    found = FirstRound.nothing(len(points), len(model.asked.kept))
    kind = Voxels if job.scan_source is None else TimedVoxels
    everywhere = Region(np.full(2, -np.inf), np.full(2, np.inf))
    for box in divided(everywhere, xyz, sides):
        own = box.holds(xyz)
        surroundings = Surroundings.of(_around(job, tile, box, "spread", VOXELS, kind))
        found.put(own, model.first_round(points.part(own), k, surroundings))
    kept = {name: getattr(found, name) for name in _FIRST}
    odds = summarise_odds(xyz, found.log_odds)
    job.work.save("evidence", tile, **kept, **odds.to_arrays(_ODDS))
    counts = (wide_neighbourhoods(spread), len(points))
    return TaskReport(int(job.store.layout.counts[tile]), counts)


def judge_tile(job: Job, tile: int) -> Judged:
    """Judge the scored points of a tile's core once more, all tiles being weighed."""
    xyz = own_points(job, tile).xyz
    _, density = scores_of(job, tile)
    found = FirstRound(*job.work.load("evidence", tile, *_FIRST))
    layout = job.store.layout
    core = Region(layout.low[tile], layout.high[tile])
    odds = _around(job, tile, core, "evidence", _ODDS, Voxels)
    return Judged(final_scores(_model(job), xyz, density, found, odds), found.reason)


def _model(job: Job) -> EvidenceModel:
    return evidence_model(timed=job.scan_source is not None)


def _around(job: Job, tile: int, box: Region, stage: str, name: str, kind: type[Voxels]) -> Voxels:
    """Return the voxels that decide about a tile's points in a box; they are those of all tiles."""
    layout = job.store.layout
    low, high = np.maximum(layout.low[tile], box.low), np.minimum(layout.high[tile], box.high)
    parts = []
    for near in layout.near(low - REACH, high + REACH).tolist():
        (kept,) = summaries(job, stage, near, name)
        voxels = kind(kept.cells.astype(np.int32), kept.values.astype(np.int64))
        parts.append(around(voxels, low, high))
    return Voxels.merged(parts)
