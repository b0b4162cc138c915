"""How far a map lies from the truth: nearest-point distances and what is made of them.

All of them take the distances from each point of one map to its nearest point in the other.
"""

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict


class DistanceStatistics(BaseModel):
    """Distances d of the cleaned map's points to their nearest points in the truth.

    The DynaHull paper (Habibiroudkenar, Ojala, Tammi 2024, arXiv 2401.07541) reports them; in
    metres, the variance in square metres.

    Attributes
    ----------
    count : int
        n, points of the cleaned map that are compared.
    mean_absolute_error : float
        MAE, sum(d) / n.
    variance : float
        sum((d - MAE)^2) / n: of the points at hand, not an estimate for others (no n - 1).
    root_mean_square_error : float
        RMSE, sqrt(sum(d^2) / n); its square is variance + MAE^2.
    percentile_90 : float
        A tenth of the points is farther away; linear between the two nearest in rank.
    largest : float
        The one-sided Hausdorff distance.
    """

    model_config = ConfigDict(frozen=True)

    count: int
    mean_absolute_error: float
    variance: float
    root_mean_square_error: float
    percentile_90: float
    largest: float

    @classmethod
    def of(cls, distances: NDArray[np.float64]) -> "DistanceStatistics":
        """Take them of (n,) distances, n > 0."""
        mean = float(distances.mean())
        return cls(
            count=len(distances),
            mean_absolute_error=mean,
            variance=float(distances.var()),
            root_mean_square_error=math.sqrt(float(np.square(distances).mean())),
            percentile_90=float(np.percentile(distances, 90)),
            largest=float(distances.max()),
        )


class DirectedChamfer(BaseModel):
    """One direction of the Chamfer distance: from each point to its nearest in the other map.

    Attributes
    ----------
    squared : float
        Mean of the squared distances, square metres.
    unsquared : float
        Mean of the distances, metres.
    """

    model_config = ConfigDict(frozen=True)

    squared: float
    unsquared: float

    @classmethod
    def of(cls, batches: Iterable[NDArray[np.float64]]) -> "DirectedChamfer":
        """Take the means over distances that come in batches, together at least one."""
        counts, sums, squares = [], [], []
        for distances in batches:
            counts.append(len(distances))
            sums.append(float(distances.sum()))
            squares.append(float(np.square(distances).sum()))
        count = sum(counts)
        return cls(squared=math.fsum(squares) / count, unsquared=math.fsum(sums) / count)


class ChamferDistance(BaseModel):
    """The Chamfer distance between the cleaned map C and the truth T.

    mean over c of min over t of |c - t|^2, plus mean over t of min over c of |t - c|^2: the form
    of Fan, Su, Guibas (CVPR 2017), by means in place of their sums, so that it does
    not grow with the number of points. Published code and text differ in the square, in adding or
    averaging the directions, and in taking one direction only, so all parts are here.

    Attributes
    ----------
    squared : float
        Both directions added, square metres.
    unsquared : float
        The same of plain distances, metres.
    cleaned_to_truth : DirectedChamfer
        What the cleaned map has too much.
    truth_to_cleaned : DirectedChamfer
        What it lacks.
    """

    model_config = ConfigDict(frozen=True)

    squared: float
    unsquared: float
    cleaned_to_truth: DirectedChamfer
    truth_to_cleaned: DirectedChamfer

    @classmethod
    def of(
        cls, cleaned_to_truth: DirectedChamfer, truth_to_cleaned: DirectedChamfer
    ) -> "ChamferDistance":
        """Add the two directions."""
        return cls(
            squared=cleaned_to_truth.squared + truth_to_cleaned.squared,
            unsquared=cleaned_to_truth.unsquared + truth_to_cleaned.unsquared,
            cleaned_to_truth=cleaned_to_truth,
            truth_to_cleaned=truth_to_cleaned,
        )
