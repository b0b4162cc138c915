"""What other settings would take: the numbers behind the slider of the report.

The slider is `removal.max_percent`; `removal.min_percent` goes with it, in the run's own ratio.
Eq. 1 is linear in the two, so that R_i is in proportion to the slider, and each scored point has
one percentage from which on it is removed. Where the evidence decides, the slider is
`removal.confidence`, and the percentage is what it lacks of certainty.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.labels import Label
from pipeline.outputs.map_sample import MapSample
from pipeline.outputs.run_report import ClusterReport
from pipeline.places import SCORE_STEPS, Decision

NEVER = np.inf
"""Of points that no setting removes: ground, and points of infinite density."""

TABLE_STEP = 0.1
"""Percent between two entries of the table of removed points, by Eq. 1."""

_CUTS = np.arange(101.0)
"""Percentages of the entries of the table of cuts."""


@dataclass(frozen=True, slots=True)
class Percentages:
    """What each percentage takes."""

    own: float
    """The run's `removal.max_percent`, or what its `removal.confidence` lacks of certainty."""
    removed_from: NDArray[np.float64]
    """(n,): for each sampled point the percentage from which on it goes; `NEVER` is possible. What
    the run removed is at or below `own`, and the rest above it."""
    step: float
    """Percent between two entries of `removed_points`."""
    removed_points: NDArray[np.int64]
    """(T,): points of the whole map that go at 0, 0.1 ... 100 %: R_i of N_i by Eq. 1, as far as
    points of finite density last, whose share of a cluster is that in the sample. By evidence, at
    0, 1 ... 100 %, exactly."""
    cuts: dict[int, NDArray[np.float64]]
    """(101,): for each cluster the density of the densest point that goes at 0, 1 ... 100 %, from
    the sample; NaN where none goes."""
    margin: float
    """Percent of its points by which the cut of a cluster in the sample may be off (95 %)."""


def removal_percentages(
    sample: MapSample, clusters: Sequence[ClusterReport], removal: dict[str, Any]
) -> Percentages:
    """Find what each percentage takes of a run's clusters, by `removal` of its configuration."""
    own = float(removal["max_percent"])
    steps = np.arange(round(100 / TABLE_STEP) + 1) * TABLE_STEP
    removed_from = np.full(len(sample), NEVER)
    removed = np.zeros(len(steps))
    margin = 0.0
    cuts = {}
    members_of = _members(sample)
    for cluster in clusters:
        members = members_of.get(cluster.index, np.empty(0, np.intp))
        density = sample.density[members]
        order = members[np.lexsort((sample.rows[members], density))]
        order = order[np.isfinite(sample.density[order])]
        rate = _share_per_percent(cluster, removal)
        finite = _removable(cluster, len(order), len(members), rate * own)
        gone = int(np.count_nonzero(sample.labels[order] == Label.DYNAMIC))
        percentage = _percentages_in_order(len(order), gone, cluster, finite, rate)
        removed_from[order[:gone]] = np.minimum(percentage[:gone], own)
        removed_from[order[gone:]] = np.maximum(percentage[gone:], np.nextafter(own, np.inf))
        removed += np.minimum(np.floor(rate * steps * cluster.count + 1e-6), finite)
        cuts[cluster.index] = _cut_table(sample.density[order], removed_from[order])
        if len(members):
            share = cluster.removed / max(cluster.count, 1)
            margin = max(margin, 196 * float(np.sqrt(share * (1 - share) / len(members))))
    if len(sample) == sample.total:
        margin = 0.0
    return Percentages(own, removed_from, TABLE_STEP, removed.astype(np.int64), cuts, margin)


def confidence_percentages(
    sample: MapSample, clusters: Sequence[ClusterReport], confidence: float, decision: Decision
) -> Percentages:
    """Find what each confidence takes, beside the run's own, where the evidence decides."""
    own = 100 * (1 - confidence)
    lacking = 100 * (1 - sample.score.astype(np.float64))
    gone = sample.labels == Label.DYNAMIC
    protected = ~gone & (sample.score >= confidence)
    lacking = np.where(
        gone, np.minimum(lacking, own), np.maximum(lacking, np.nextafter(own, NEVER))
    )
    return Percentages(
        own,
        np.where(np.isnan(sample.score) | protected, NEVER, lacking),
        100 / SCORE_STEPS,
        decision.removed_at()[::-1],
        {cluster.index: np.full(len(_CUTS), np.nan) for cluster in clusters},
        0.0,
    )


def _members(sample: MapSample) -> dict[int, NDArray[np.intp]]:
    """Return, for each cluster, the indices of its sampled points."""
    order = np.argsort(sample.cluster, kind="stable")
    found, starts = np.unique(sample.cluster[order], return_index=True)
    return dict(zip(found.tolist(), np.split(order, starts[1:]), strict=True)) if len(found) else {}


def _share_per_percent(cluster: ClusterReport, removal: dict[str, Any]) -> float:
    """Return the share of a cluster that each percent of the slider takes."""
    if removal["max_percent"] == 0:
        return 0.01  # there is no ratio to keep
    share = cluster.removal_percent / 100
    if removal["threshold"] == "stepped" and cluster.removed:
        share = cluster.removed / cluster.count  # the last step takes more than R_i
    return float(share / removal["max_percent"])


def _removable(cluster: ClusterReport, finite: int, sampled: int, share: float) -> float:
    """Estimate how many points of a cluster have a finite density."""
    if cluster.removed < np.floor(share * cluster.count + 1e-6) - 1:
        return cluster.removed  # all there were
    if finite == sampled:
        return cluster.count
    return max(cluster.removed, cluster.count * finite / sampled)


def _percentages_in_order(
    count: int, gone: int, cluster: ClusterReport, finite: float, rate: float
) -> NDArray[np.float64]:
    """Return the percentages of a cluster's sampled points in the order in which they go.

    Those that the run removed stand for all that it removed, the rest for the rest.
    """
    if rate == 0 or cluster.count == 0:
        return np.full(count, NEVER)
    ranks = np.empty(count)
    ranks[:gone] = (np.arange(gone) + 0.5) * cluster.removed / max(gone, 1)
    left = count - gone
    ranks[gone:] = cluster.removed + (np.arange(left) + 0.5) * (
        (finite - cluster.removed) / max(left, 1)
    )
    percentages = ranks / cluster.count / rate
    return np.where(percentages <= 100, percentages, NEVER)


def _cut_table(
    density: NDArray[np.float64], removed_from: NDArray[np.float64]
) -> NDArray[np.float64]:
    if not len(density):
        return np.full(len(_CUTS), np.nan)
    count = np.searchsorted(removed_from, _CUTS, side="right")
    return np.where(count > 0, density[np.maximum(count - 1, 0)], np.nan)
