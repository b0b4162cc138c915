"""What a decision comes to: the places that lose points, and how sure it was."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict

SCORE_STEPS = 100
"""Steps of a score that are counted, each a hundredth."""


class PlaceReason(BaseModel):
    """Why points were removed, and what share of those of the place; from 0 to 1."""

    model_config = ConfigDict(frozen=True)

    words: str
    share: float


class Place(BaseModel):
    """A connected group of removed points.

    Attributes
    ----------
    number : int
        From 1, the place of most points.
    points : int
        Removed there.
    low, high : (x, y, z)
        Corners of the box around it, metres; whole voxels.
    score : float or None
        Mean probability of having moved; None where no evidence was weighed.
    reasons : tuple of PlaceReason
        Of most points first.
    """

    model_config = ConfigDict(frozen=True)

    number: int
    points: int
    low: tuple[float, float, float]
    high: tuple[float, float, float]
    score: float | None
    reasons: tuple[PlaceReason, ...]

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
    """What was decided.

    Attributes
    ----------
    places : tuple of Place
        Those of most points.
    place_count : int
        All there are.
    scattered : int
        Removed points in groups too small to be a place.
    uncertain : int
        Points that were kept with half of the confidence asked for, at least.
    scores : (101,) int64 array
        Points of a score of 0, 0.01 ... 1, and less than a step above it; none without evidence.
    """

    places: tuple[Place, ...]
    place_count: int
    scattered: int
    uncertain: int
    scores: NDArray[np.int64]

    def removed_at(self) -> NDArray[np.int64]:
        """Return how many points go at a confidence of 0, 0.01 ... 1, (101,)."""
        return np.asarray(self.scores[::-1].cumsum()[::-1])
