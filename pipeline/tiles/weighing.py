"""The task that weighs the evidence of one tile, and what its second look makes of it.

A tile reduces its points to voxels once, and reads those of the tiles around: see
`dynahull.evidence.summaries`. Points of other tiles are never looked at.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.evidence.model import (
    EvidenceModel,
    FirstRound,
    Judged,
    evidence_model,
    final_scores,
    model_file,
)
from dynahull.evidence.range_images import Returns, Views
from dynahull.evidence.summaries import (
    REACH,
    ScoredPoints,
    TimedVoxels,
    about_middles,
    around,
    summarise_odds,
)
from dynahull.evidence.surroundings import Surroundings
from dynahull.evidence.voxels import Voxels
from dynahull.warn import wide_neighbourhoods
from pipeline.tiles.borders import Region
from pipeline.tiles.density import RETURNS, VOXELS, divided, scores_of
from pipeline.tiles.ground import heights_of, own_points, summaries
from pipeline.work.folder import TaskReport
from pipeline.work.job import IMAGING, Job
from pipeline.work.kept_returns import gather, kept_returns
from tiling.ledger import noting

_ODDS = "odds"
_FIRST = ("log_odds", "reason", "ranks")


def weigh_tile(job: Job, tile: int, sides: int = 1) -> TaskReport:
    """Judge the points of a tile's core by their own terms, and sum up the outcome.

    Where the memory does not suffice for the tile, `sides` x `sides` parts of it are done one
    after the other. The report counts the points with wide neighbourhoods, and all.
    """
    xyz = own_points(job, tile).xyz
    (spread,) = job.work.load("spread", tile, "spread")
    _, density = scores_of(job, tile)
    points = ScoredPoints(xyz, density, spread, heights_of(job, tile, xyz))
    everywhere = Region(np.full(2, -np.inf), np.full(2, np.inf))
    if sides == 1:
        found = _first_round(job, tile, everywhere, points)
    else:
        found = FirstRound.nothing(len(points), len(_model(job).asked.kept))
        for box in divided(everywhere, xyz, sides):
            own = box.holds(xyz)
            found.put(own, _first_round(job, tile, box, points.part(own)))
    odds = summarise_odds(xyz, found.log_odds)
    first = (found.log_odds, found.reason, _model(job).second.ranks(found.kept))
    counts = (wide_neighbourhoods(spread), len(xyz))
    del points, xyz, density, spread, found  # to compress the rest takes memory
    kept: dict[str, NDArray[Any]] = dict(zip(_FIRST, first, strict=True))
    job.work.save("evidence", tile, **kept, **odds.to_arrays(_ODDS))
    return TaskReport(int(job.store.layout.counts[tile]), counts)


def _first_round(job: Job, tile: int, box: Region, points: ScoredPoints) -> FirstRound:
    """Judge the points of a tile in a box by their own terms."""
    kind = Voxels if job.scan_source is None else TimedVoxels
    # Nothing else holds the voxels: they are most of what a tile takes, and go when they can.
    surroundings = Surroundings.of(
        about_middles(_around(job, tile, box, "spread", VOXELS, kind), -1), scan_views(job)
    )
    return _model(job).first_round(points, job.configuration.neighbours.k, surroundings)


def judge_tile(job: Job, tile: int) -> Judged:
    """Judge the scored points of a tile's core once more, all tiles being weighed."""
    xyz = own_points(job, tile).xyz
    _, density = scores_of(job, tile)
    model = _model(job)
    log_odds, reason, ranks = job.work.load("evidence", tile, *_FIRST)
    found = FirstRound(log_odds, model.second.of_ranks(ranks), reason)
    del ranks  # twice as many bytes are left of them
    layout = job.store.layout
    core = Region(layout.low[tile], layout.high[tile])
    odds = _around(job, tile, core, "evidence", _ODDS, Voxels)
    return Judged(final_scores(model, xyz, density, found, odds), found.reason)


def gather_returns(job: Job) -> None:
    """Gather what the tiles say of the range images of all scans: see `range_images`."""
    if job.viewpoints is None or job.work.has_done(IMAGING) or job.is_spent("spread"):
        return
    with noting() as written:
        gather(job.root, len(job.viewpoints.places), lambda: _returns_of_tiles(job))
    job.work.finish_step(IMAGING, written)


def _returns_of_tiles(job: Job) -> Iterator[Returns]:
    for tile in range(len(job.store.layout)):
        yield Returns(*job.work.load("spread", tile, *RETURNS))


def scan_views(job: Job) -> Views | None:
    """Return what the scans saw, once their returns are gathered; None where none are known."""
    if job.viewpoints is None:
        return None
    return Views(job.viewpoints.places, kept_returns(job.root).images)


def _model(job: Job) -> EvidenceModel:
    return evidence_model(model_file(job.viewpoints))


def _around(job: Job, tile: int, box: Region, stage: str, name: str, kind: type[Voxels]) -> Voxels:
    """Return the voxels that decide about a tile's points in a box; they are those of all tiles."""
    layout = job.store.layout
    low, high = np.maximum(layout.low[tile], box.low), np.minimum(layout.high[tile], box.high)
    parts = []
    for near in layout.near(low - REACH, high + REACH).tolist():
        (kept,) = summaries(job, stage, near, name)
        few = around(kept, low, high)
        parts.append(kind(few.cells.astype(np.int32), few.values.astype(np.int64)))
    return Voxels.merged(parts)
