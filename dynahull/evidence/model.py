"""The model that weighs the evidence: two rounds of trees, in a data file beside this module.

The first round judges each point by its own terms. The second knows what the first made of the
points around. It was learnt from simulated scenes alone; `python -m benchmarks.training` makes such
a file.
"""

import hashlib
import json
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled
from dynahull.errors import InvalidParametersError
from dynahull.evidence.forest import Forest
from dynahull.evidence.range_images import Returns, Views
from dynahull.evidence.reasons import NO_REASON, reasons
from dynahull.evidence.staged_forest import StagedForest
from dynahull.evidence.summaries import (
    FINEST,
    LEVELS,
    ScoredPoints,
    summarise_ground,
    summarise_odds,
    summarise_points,
)
from dynahull.evidence.surroundings import Surroundings, Terms
from dynahull.evidence.terms import BOXES, TERMS, TIMED_TERMS, evidence, places_of
from dynahull.evidence.viewpoints import Viewpoints
from dynahull.evidence.visits import Scans
from dynahull.evidence.voxels import (
    Cells,
    Floats,
    Integers,
    Voxels,
    cells_of,
    find_cell,
    order_of,
)
from dynahull.threads import over_ranges

POOLED_TERMS = (
    *(f"pooled_{box}" for box in BOXES),
    *(f"likely_{box}" for box in BOXES),
    "pooled_column",
)
"""Mean logarithm of the odds, and share of points more likely to have moved than not, over each
box; the mean over 2 m up and down in a column 0.4 m wide."""

_COLUMN_LEVEL, _COLUMN_STEPS = 2, 5


def pooled_terms(odds: Voxels) -> Terms:
    """Return what was made of the points around each voxel, (V, len(POOLED_TERMS)).

    Parameters
    ----------
    odds : Voxels
        Of all points within `summaries.REACH`: see `summaries.summarise_odds`.
    """
    terms = np.empty((len(odds), len(POOLED_TERMS)), np.float32)
    level, at = odds, np.arange(len(odds), dtype=np.int32)
    for number in range(LEVELS):
        if number:
            level, parents = level.coarser()
            at = parents.take(at)
        sums = level.around()
        terms[:, number] = _mean_odds(sums).take(at)
        terms[:, LEVELS + number] = (sums[:, 1] / sums[:, 0]).take(at)
        if number == _COLUMN_LEVEL:
            terms[:, 2 * LEVELS] = _mean_odds(
                _column_sums(level.cells, level.sums, level.table)
            ).take(at)
    return terms


def _mean_odds(sums: Integers) -> npt.NDArray[np.float64]:
    return np.asarray(sums[:, 2] / (256.0 * sums[:, 0]))


@compiled
def _column_sums(cells: Cells, sums: Integers, table: npt.NDArray[np.int32]) -> Integers:
    found = np.zeros((len(cells), 3), np.int64)
    for v in range(len(cells)):
        for dk in range(-_COLUMN_STEPS, _COLUMN_STEPS + 1):
            n = find_cell(cells[v, 0], cells[v, 1], cells[v, 2] + dk, cells, table)
            if n >= 0:
                for column in range(3):
                    found[v, column] += sums[n, column]
    return found


FIRST_ODDS = "first"
"""The term of the second round that is the outcome of the first."""

KEPT_TERMS = (
    "thickness", "scale", "height", "aloft", "over", "under", "ground_seen", "ground_near",
    "density_2.4", "thickness_2.4", "density_4.8", "returns_0.3", "returns_2.4", "thickness_least",
    "box_thin_0.3", "box_thin_0.6", "box_thin_1.2", "box_flat_0.6", "box_flat_1.2",
)  # fmt: skip
"""Terms of the first round that the second looks at again."""

TIMED_KEPT_TERMS = (
    *KEPT_TERMS,
    "scans_1_0.3", "scans_8_0.3", "scans_1_1.2", "scans_8_1.2", "scans_1_4.8", "scans_8_4.8",
    "clearly_0.1", "met_0.1", "clear_share_0.3", "through_share_0.3", "clear_share_1.2",
)  # fmt: skip
"""The same, of a map whose scans are known."""


@dataclass(frozen=True, slots=True)
class AskedTerms:
    """What the two rounds are told."""

    first: tuple[str, ...]
    second: tuple[str, ...]

    @classmethod
    def of(cls, first: tuple[str, ...], kept: tuple[str, ...]) -> Self:
        """Let the second round look at some terms of the first again."""
        return cls(first, (FIRST_ODDS, *POOLED_TERMS, *kept))

    @property
    def kept(self) -> npt.NDArray[np.intp]:
        """Which terms of the first round the second looks at again."""
        return np.array([self.first.index(name) for name in self.second[1 + len(POOLED_TERMS) :]])


MAP_ONLY = AskedTerms.of(TERMS, KEPT_TERMS)
TIMED = AskedTerms.of(TIMED_TERMS, TIMED_KEPT_TERMS)
"""What is asked of a map whose scans are known."""

MAP_FILE, TIMED_FILE, POSED_FILE = "model.json", "timed_model.json", "posed_model.json"
MODELS = {MAP_FILE: MAP_ONLY, TIMED_FILE: TIMED, POSED_FILE: TIMED}
"""The models that come with the package, for maps whose scans, or also their poses, are known."""

_BATCH = 50_000
"""Points whose terms are held at a time."""


@dataclass(frozen=True, slots=True)
class FirstRound:
    """What the first round made of some points.

    Attributes
    ----------
    log_odds : (n,) float32 array
    kept : (n, len(AskedTerms.kept)) float32 array
        What the second round looks at again.
    reason : (n,) uint8 array
        Which of `reasons.REASONS` speaks most for a ghost.
    """

    log_odds: npt.NDArray[np.float32]
    kept: Terms
    reason: npt.NDArray[np.uint8]

    @classmethod
    def nothing(cls, count: int, kept: int) -> Self:
        """Return room for what is made of some points."""
        return cls(
            np.empty(count, np.float32),
            np.empty((count, kept), np.float32),
            np.empty(count, np.uint8),
        )

    def put(self, chosen: npt.NDArray[np.bool_] | npt.NDArray[np.intp], found: Self) -> None:
        """Take in what was made of some of the points."""
        self.log_odds[chosen], self.kept[chosen] = found.log_odds, found.kept
        self.reason[chosen] = found.reason


@dataclass(frozen=True, slots=True)
class EvidenceModel:
    """Two rounds of trees.

    Attributes
    ----------
    first : StagedForest
    second : Forest
        Over the terms of `MAP_ONLY` or of `TIMED`.
    """

    first: StagedForest
    second: Forest

    @property
    def asked(self) -> AskedTerms:
        """What the rounds are told."""
        return AskedTerms(self.first.terms, self.second.terms)

    @classmethod
    def of(cls, stored: dict[str, Any]) -> Self:
        """Build from what the data file holds.

        Raises
        ------
        InvalidParametersError
            When it asks for terms that there are not.
        """
        first, second = StagedForest.of(stored["first"]), Forest.of(stored["second"])
        model = cls(first, second)
        if model.asked not in MODELS.values():
            raise InvalidParametersError(
                "evidence model: expected the terms of this version, found others"
            )
        return model

    def first_round(
        self, points: ScoredPoints, k: int, surroundings: Surroundings, threads: int = 1
    ) -> FirstRound:
        """Judge points by their own terms.

        Parameters
        ----------
        k : int
            Neighbours of each.
        surroundings : Surroundings
            Of all points within `summaries.REACH`.
        """
        kept = self.asked.kept
        found = FirstRound.nothing(len(points), len(kept))
        order = order_of(cells_of(points.xyz, FINEST))  # what is read about points stays in caches

        def judge(begin: int, end: int) -> None:
            own = order[begin:end]
            terms = evidence(points.part(own), k, surroundings)
            log_odds = self.first.log_odds(terms)
            why = reasons(self.first, terms, log_odds)
            found.put(own, FirstRound(log_odds, terms[:, kept], why))

        over_ranges(judge, _bounds(len(points)), threads)
        return found

    def second_round(
        self, xyz: Floats, found: FirstRound, odds: Voxels, threads: int = 1
    ) -> npt.NDArray[np.float32]:
        """Judge points once more, by what was made of those around; return logarithms of odds.

        Parameters
        ----------
        xyz : (n, 3) float64 array
        found : FirstRound
            Of the same points.
        odds : Voxels
            Of all points within `summaries.REACH`: see `summaries.summarise_odds`.
        """
        pooled, cells = pooled_terms(odds), cells_of(xyz, FINEST)
        log_odds, order = np.empty(len(xyz), np.float32), order_of(cells)

        def judge(begin: int, end: int) -> None:
            own = order[begin:end]
            at = places_of(cells[own], odds.cells, odds.table)
            blocks = [found.log_odds[own, None], pooled.take(at, axis=0), found.kept[own]]
            log_odds[own] = self.second.log_odds(np.concatenate(blocks, axis=1))

        over_ranges(judge, _bounds(len(xyz)), threads)
        return log_odds


@dataclass(frozen=True, slots=True)
class Judged:
    """What the evidence makes of some points.

    Attributes
    ----------
    score : (n,) float32 array
        Probability of having moved; NaN where there is no density.
    reason : (n,) uint8 array
        Which of `reasons.REASONS` speaks most for a ghost.
    """

    score: npt.NDArray[np.float32]
    reason: npt.NDArray[np.uint8]

    @classmethod
    def nothing(cls, count: int) -> Self:
        """Return what is known of points that were not weighed."""
        return cls(np.full(count, np.nan, np.float32), np.full(count, NO_REASON, np.uint8))


def judge_points(
    points: ScoredPoints,
    unscored: Floats,
    k: int,
    threads: int = 1,
    unscored_scan: Scans | None = None,
    viewpoints: Viewpoints | None = None,
) -> Judged:
    """Judge all points of a map.

    Parameters
    ----------
    points : ScoredPoints
        All of the map.
    unscored : (m, 3) float64 array
        Ground, and what lies too high to be scored.
    k : int
        Neighbours of each point.
    unscored_scan : (m,) int32 array, optional
        Their scans, if those of the points are known.
    viewpoints : Viewpoints, optional
        Of the scans, if these are known.
    """
    views = None
    if points.scan is not None and unscored_scan is not None and viewpoints is not None:
        sensor = viewpoints.places
        of_points = Returns.of(points.xyz, viewpoints.rows(points.scan), sensor)
        of_others = Returns.of(unscored, viewpoints.rows(unscored_scan), sensor)
        views = Views(sensor, Returns.joined([of_points, of_others]).images)
    model = evidence_model(model_file(viewpoints))
    # Nothing else holds the voxels: they are most of what a map takes here, and go when they can.
    surroundings = Surroundings.of(
        Voxels.merged([summarise_points(points), summarise_ground(unscored, unscored_scan)]),
        views,
        threads,
    )
    found = model.first_round(points, k, surroundings, threads)
    del surroundings
    odds = summarise_odds(points.xyz, found.log_odds)
    score = final_scores(model, points.xyz, points.density, found, odds, threads)
    return Judged(score, found.reason)


def final_scores(
    model: EvidenceModel,
    xyz: Floats,
    density: Floats,
    found: FirstRound,
    odds: Voxels,
    threads: int = 1,
) -> npt.NDArray[np.float32]:
    """Judge points once more, and return the probability that each moved; see `second_round`.

    Returns
    -------
    (n,) float32 array
        NaN where there is no density: the point is in a cluster of too few.
    """
    score = probabilities(model.second_round(xyz, found, odds, threads))
    score[np.isnan(density)] = np.nan
    return score


@compiled
def probabilities(log_odds: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    """Return the probability that each point moved, (n,), from the logarithm of its odds."""
    found = np.empty(len(log_odds), np.float32)
    for i in range(len(log_odds)):
        found[i] = 1.0 / (1.0 + np.exp(-np.float64(log_odds[i])))
    return found


def model_file(viewpoints: Viewpoints | None) -> str:
    """Return the name of the model for what is known of a map's scans."""
    if viewpoints is None:
        return MAP_FILE
    return POSED_FILE if viewpoints.are_told else TIMED_FILE


@lru_cache(maxsize=3)
def evidence_model(name: str = MAP_FILE) -> EvidenceModel:
    """Return one of `MODELS`."""
    return EvidenceModel.of(json.loads(_data_file(name)))


def models_digest() -> str:
    """Return a hash of all `MODELS`: scores of others are not to be mixed with theirs."""
    return hashlib.sha256(b"".join(map(_data_file, MODELS))).hexdigest()


def _data_file(name: str) -> bytes:
    return files("dynahull.evidence").joinpath(name).read_bytes()


def _bounds(count: int) -> list[int]:
    return [*range(0, max(count, 1), _BATCH), count]
