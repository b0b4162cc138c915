"""Where points were removed: groups that touch on a lattice, summed tile by tile.

All that is summed are integers over voxels anchored at the origin of the coordinates, so the
places of a map are the same however it is cut. A tile hands on a whole place as one row, and only
of places that may go on in other tiles the voxels.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from dynahull.evidence.reasons import REASONS
from dynahull.evidence.voxels import Cells, Floats, Integers, Voxels, added, cells_of

SCORE_STEPS = 100
"""Steps of a score that are counted, each a hundredth."""


class PlaceReason(BaseModel, frozen=True):
    """Why points were removed, and what share of those of the place; from 0 to 1."""

    words: str
    share: float


class Place(BaseModel, frozen=True):
    """A connected group of removed points."""

    number: int
    """From 1, the place of most points."""
    points: int
    """Removed there."""
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    """Corners of the box around it, metres; whole voxels."""
    score: float | None
    """Mean probability of having moved; None where no evidence was weighed."""
    reasons: tuple[PlaceReason, ...]
    """Of most points first."""

    @property
    def middle(self) -> tuple[float, float, float]:
        """The middle of its box, metres."""
        x, y, z = (0.5 * (low + high) for low, high in zip(self.low, self.high, strict=True))
        return x, y, z

    @property
    def size(self) -> tuple[float, float, float]:
        """The sides of its box, metres."""
        x, y, z = (high - low for low, high in zip(self.low, self.high, strict=True))
        return x, y, z


@dataclass(frozen=True, slots=True)
class Decision:
    """What was decided."""

    places: tuple[Place, ...]
    """Those of most points."""
    place_count: int
    """All there are."""
    scattered: int
    """Removed points in groups too small to be a place."""
    uncertain: int
    """Points that were kept with half of the confidence asked for, at least."""
    scores: NDArray[np.int64]
    """(101,): points of a score of 0, 0.01 ... 1, and less than a step above it; none without
    evidence."""

    def removed_at(self) -> NDArray[np.int64]:
        """Return how many points go at a confidence of 0, 0.01 ... 1, (101,)."""
        return np.asarray(self.scores[::-1].cumsum()[::-1])


SIDE = 0.4
"""Of the voxels, metres."""

FEWEST = 20
"""Points of a place; those of smaller groups are scattered."""

MOST_LISTED = 100
"""Places that are told one by one, those of most points."""

UNCERTAIN = 0.5
"""Of the confidence asked for: a point that is kept with a higher score is uncertain."""

SURROUNDINGS = "the points around it look like a ghost"
"""What is said where the own terms of points say nothing."""

DENSITY = "sparser than the rest of its cluster"
"""What is said where a share of each cluster goes."""

_WORDS = (*REASONS, SURROUNDINGS, DENSITY)
_MOST_REASONS = 3
_LEAST_SHARE = 0.05
"""Of the points of a place, for a reason to be told beside the first."""

_THOUSANDTHS = 1_000

_POINTS, _SCORE, _REASONS = 0, 1, 2
_LOW = _REASONS + len(_WORDS)
_HIGH, _WIDTH = _LOW + 3, _LOW + 6
_LATTICE = np.array([[-np.inf, -np.inf], [np.inf, np.inf]])
NOWHERE = np.zeros((2, 2))
"""A core in which no place ends: of points that lie anywhere."""

_MANY = 100_000
"""Rows and voxels that are gathered before they are added up."""


@dataclass(frozen=True, slots=True)
class DecisionSums:
    """What the tiles say of the decision; the sums of a map are those of its tiles, added up."""

    open: Voxels
    """Of groups that may go on elsewhere: points, scores in thousandths, points of each reason."""
    whole: Integers
    """(P, W): places, those of most points first: the same sums, then the lowest and the highest
    cell."""
    counts: Integers
    """(3,): whole places, also those that are not listed, scattered points, uncertain points."""
    scores: Integers
    """(101,): see `Decision.scores`."""

    @classmethod
    def empty(cls) -> Self:
        """Return the sums of no points."""
        none = Voxels(np.empty((0, 3), np.int32), np.empty((0, _LOW), np.int64))
        counts, scores = np.zeros(3, np.int64), np.zeros(SCORE_STEPS + 1, np.int64)
        return cls(none, np.empty((0, _WIDTH), np.int64), counts, scores)

    @classmethod
    def of(
        cls,
        xyz: Floats,
        score: NDArray[np.float32],
        reason: NDArray[np.uint8],
        confidence: float,
        core: Floats = _LATTICE,
    ) -> Self:
        """Sum up the points of a tile, or of a map.

        Parameters
        ----------
        xyz : (n, 3) float64 array
            Metres.
        score : (n,) float32 array
            NaN where a point is not scored.
        reason : (n,) uint8 array
        confidence : float
            The least score that goes.
        core : (2, 2) float64 array
            Corners of the box, half-open and seen from above, that holds these points alone.
        """
        gone = score >= confidence
        uncertain = int(np.count_nonzero((score >= UNCERTAIN * confidence) & ~gone))
        steps = (np.arange(1, SCORE_STEPS + 1) / SCORE_STEPS).astype(np.float32)
        place = np.searchsorted(steps, score[~np.isnan(score)], side="right")
        values = np.zeros((int(np.count_nonzero(gone)), _LOW), np.int64)
        values[:, _POINTS] = 1
        values[:, _SCORE] = np.rint(score[gone].astype(np.float64) * _THOUSANDTHS)
        column = _REASONS + np.minimum(reason[gone], len(REASONS)).astype(np.intp)
        values[np.arange(len(values)), column] = 1
        scores = np.bincount(place, minlength=SCORE_STEPS + 1).astype(np.int64)
        return cls._of_removed(xyz[gone], values, uncertain, scores, core)

    @classmethod
    def by_density(cls, removed: Floats, core: Floats = _LATTICE) -> Self:
        """Sum up what a share of each cluster takes of a tile, (n, 3); see `of`."""
        values = np.zeros((len(removed), _LOW), np.int64)
        values[:, _POINTS] = values[:, _REASONS + _WORDS.index(DENSITY)] = 1
        return cls._of_removed(removed, values, 0, np.zeros(SCORE_STEPS + 1, np.int64), core)

    @classmethod
    def _of_removed(
        cls, removed: Floats, values: Integers, uncertain: int, scores: Integers, core: Floats
    ) -> Self:
        voxels = Voxels.of(cells_of(removed, SIDE), values)
        counts = np.array([0, 0, uncertain])
        return cls(voxels, np.empty((0, _WIDTH), np.int64), counts, scores)._with_whole(core)

    @classmethod
    def merged(cls, parts: Iterable[Self]) -> Self:
        """Add up the sums of parts of a map; of these few are held at a time."""
        total = cls.empty()
        waiting: list[Self] = []
        held = 0
        for part in parts:
            waiting.append(part)
            held += len(part)
            if held > max(_MANY, len(total)):
                total, waiting, held = cls._added([total, *waiting]), [], 0
        return cls._added([total, *waiting])

    @classmethod
    def _added(cls, parts: Sequence[Self]) -> Self:
        return cls(
            Voxels.merged([part.open for part in parts]),
            _largest(np.concatenate([part.whole for part in parts])),
            np.sum([part.counts for part in parts], axis=0),
            np.sum([part.scores for part in parts], axis=0),
        )

    def __len__(self) -> int:
        return len(self.open) + len(self.whole)

    def decision(self) -> Decision:
        """Return what was decided, these being the sums of a whole map."""
        rest = _groups(self.open, self.open.connected())
        large = rest[:, _POINTS] >= FEWEST
        listed = _largest(np.concatenate([self.whole, rest[large]]))
        return Decision(
            tuple(_place(number, row) for number, row in enumerate(listed, 1)),
            int(self.counts[0]) + int(np.count_nonzero(large)),
            int(self.counts[1]) + int(rest[~large, _POINTS].sum()),
            int(self.counts[2]),
            self.scores,
        )

    def cells_of(self, numbers: Sequence[int]) -> Cells:
        """Return the voxels of places that `decision` lists, (n, 3), of sums without whole ones."""
        groups = self.open.connected()
        rows = _groups(self.open, groups)
        large = np.flatnonzero(rows[:, _POINTS] >= FEWEST)
        listed = large[_by_size(rows[large])]
        return self.open.cells[np.isin(groups, listed[np.array(numbers) - 1])]

    def to_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the sums as arrays, for a file that hands them from a task to the run."""
        arrays = (self.open.cells, self.open.sums, self.whole, self.counts, self.scores)
        return dict(zip(ARRAY_NAMES, arrays, strict=True))

    @classmethod
    def from_arrays(cls, cells: NDArray[np.int32], sums: Integers, *others: Integers) -> Self:
        """Return what `to_arrays` gave away, in the order of `ARRAY_NAMES`."""
        return cls(Voxels(cells, sums), *others)

    def _with_whole(self, core: Floats) -> Self:
        """Put places together of which no voxel, nor one beside it, lies on the core's edge."""
        groups = self.open.connected()
        rows = _groups(self.open, groups)
        first, last = cells_of(np.column_stack([core, [0.0, 0.0]]), SIDE)[:, :2]
        flat = self.open.cells[:, :2]
        amid = ((flat > first + 1) & (flat < last - 1)).all(axis=1)
        ended = np.ones(len(rows), np.bool_)
        ended[groups[~amid]] = False
        large = rows[:, _POINTS] >= FEWEST
        going_on = ~ended[groups]
        return type(self)(
            Voxels(self.open.cells[going_on], self.open.sums[going_on]),
            _largest(rows[ended & large]),
            self.counts + [np.count_nonzero(ended & large), rows[ended & ~large, _POINTS].sum(), 0],
            self.scores,
        )


ARRAY_NAMES = tuple(f"decision_{name}" for name in ("cells", "sums", "whole", "counts", "scores"))
"""Of what `DecisionSums.to_arrays` returns."""


def _groups(voxels: Voxels, groups: NDArray[np.intp]) -> Integers:
    """Return a row for each group of voxels: sums, lowest and highest cell."""
    count = int(groups.max(initial=-1)) + 1
    rows = np.zeros((count, _WIDTH), np.int64)
    rows[:, :_LOW] = added(voxels.sums, groups.astype(np.int32), count, 0)
    rows[:, _LOW:_HIGH], rows[:, _HIGH:] = np.iinfo(np.int64).max, np.iinfo(np.int64).min
    np.minimum.at(rows[:, _LOW:_HIGH], groups, voxels.cells)
    np.maximum.at(rows[:, _HIGH:], groups, voxels.cells)
    return rows


def _largest(rows: Integers) -> Integers:
    return np.asarray(rows[_by_size(rows)])


def _by_size(rows: Integers) -> NDArray[np.intp]:
    """Return which places to list: those of most points first, and of as many by their cells."""
    # Each column decides where those before it are the same: no two rows in another order differ.
    keys = [-rows[:, _POINTS], *rows[:, _LOW:].T, *rows[:, _SCORE:_LOW].T]
    return np.lexsort(keys[::-1])[:MOST_LISTED]


def _place(number: int, row: Integers) -> Place:
    points = int(row[_POINTS])
    by_reason = row[_REASONS:_LOW].tolist()
    order = sorted(range(len(_WORDS)), key=lambda reason: -by_reason[reason])[:_MOST_REASONS]
    low, high = (row[_LOW:_HIGH] * SIDE).tolist(), ((row[_HIGH:] + 1) * SIDE).tolist()
    return Place(
        number=number,
        points=points,
        low=_millimetres(low),
        high=_millimetres(high),
        score=None
        if _WORDS[order[0]] == DENSITY
        else round(int(row[_SCORE]) / (points * _THOUSANDTHS), 3),
        reasons=tuple(
            PlaceReason(words=_WORDS[reason], share=round(by_reason[reason] / points, 3))
            for rank, reason in enumerate(order)
            if rank == 0 or by_reason[reason] >= _LEAST_SHARE * points
        ),
    )


def _millimetres(corner: list[float]) -> tuple[float, float, float]:
    x, y, z = (round(value, 3) for value in corner)
    return x, y, z
