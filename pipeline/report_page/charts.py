"""The charts that do not move: Eq. 1, densities of each cluster, seconds of each stage."""

from collections.abc import Mapping, Sequence
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import NDArray

from dynahull.labels import Label
from pipeline.configuration.quantities import in_time
from pipeline.outputs.map_sample import MapSample, magnitude
from pipeline.outputs.run_report import ClusterReport
from pipeline.report_page.amounts import Amounts
from pipeline.report_page.svg import Axis, frame, picture, power_of_ten, short, text

MOST_HISTOGRAMS = 12
"""Clusters whose densities are drawn, the largest first."""

_MOST_DOTS = 2_000
_BINS = 60


def rescale_chart(clusters: Sequence[ClusterReport], removal: dict[str, Any]) -> str:
    """Draw Eq. 1: R_i of each cluster over its N_i."""
    counts = [cluster.count for cluster in clusters if cluster.count]
    x = Axis(0, max(counts, default=1) * 1.05, 64, 470)
    y = Axis(0, max(removal["max_percent"] * 1.15, 1), 250, 16)
    low, high = removal["min_percent"], removal["max_percent"]
    parts = [
        frame(
            x,
            y,
            ("N_i, points in the cluster", "R_i, share removed, %"),
            (short, lambda value: f"{value:g}"),
        )
    ]
    if counts and min(counts) < max(counts):
        parts.append(
            f'<path d="M{x.at(min(counts))} {y.at(low)}L{x.at(max(counts))} {y.at(high)}" '
            'class="equation"/>'
        )
    for cluster in sorted(clusters, key=lambda each: -each.count)[:_MOST_DOTS]:
        at_x, at_y = x.at(cluster.count), y.at(cluster.removal_percent)
        parts.append(
            f'<circle cx="{at_x}" cy="{at_y}" r="5" class="dot"><title>cluster {cluster.index}: '
            f"{cluster.count:,} points, R_i = {cluster.removal_percent:.2f} %</title></circle>"
        )
        if len(clusters) <= MOST_HISTOGRAMS:
            parts.append(text(at_x, at_y - 10, str(cluster.index), "note"))
    return picture(490, 296, "Eq. 1: the share removed from each cluster, by its size", parts)


def density_charts(
    sample: MapSample, clusters: Sequence[ClusterReport], amounts: Amounts
) -> list[str]:
    """Draw the densities of the largest clusters, a chart each, on one scale."""
    drawn = [cluster for cluster in clusters if cluster.count]
    drawn = sorted(drawn, key=lambda each: (-each.count, each.index))[:MOST_HISTOGRAMS]
    drawn.sort(key=lambda each: each.index)
    finite = sample.density[np.isfinite(sample.density)]
    if not len(finite):
        return []
    low, high = np.quantile(magnitude(finite), [0.001, 0.999]).tolist()
    thresholds = [_magnitude(each.threshold) for each in drawn if _is_drawn(each.threshold)]
    low, high = min([low, *thresholds]) - 0.05, max([high, *thresholds]) + 0.05
    edges = np.linspace(low, high, _BINS + 1)
    return [_density_chart(sample, cluster, amounts, edges) for cluster in drawn]


def _is_drawn(threshold: float | None) -> TypeGuard[float]:
    return threshold is not None and np.isfinite(threshold)


def _magnitude(density: float) -> float:
    return float(magnitude(np.array([density]))[0])


def _density_chart(
    sample: MapSample, cluster: ClusterReport, amounts: Amounts, edges: NDArray[np.float64]
) -> str:
    members = sample.cluster == cluster.index
    density, labels = sample.density[members], sample.labels[members]
    scale = cluster.count / max(len(density), 1)
    finite = np.isfinite(density)
    place = np.clip(magnitude(density[finite]), edges[0], edges[-1])
    every, _ = np.histogram(place, edges)
    gone, _ = np.histogram(place[labels[finite] == Label.DYNAMIC], edges)
    x = Axis(edges[0], edges[-1], 58, 380)
    y = Axis(0, max(every.max(initial=0) * scale * 1.12, 1), 170, 34)
    parts = [
        frame(x, y, ("density k / v, points per m³", "points"), (power_of_ten, short)),
        text(58, 16, f"Cluster {cluster.index}", "heading", "start"),
        text(
            380,
            16,
            f"N_i {cluster.count:,} \u00b7 R_i {cluster.removal_percent:.2f} % \u00b7 "
            f"removed {cluster.removed:,}",
            "note",
            "end",
        ),
        _bars(x, y, edges, (every - gone) * scale, gone * scale, "static"),
        _bars(x, y, edges, gone * scale, np.zeros(len(gone)), "removed"),
    ]
    if _is_drawn(cluster.threshold):
        at = x.at(_magnitude(cluster.threshold))
        parts.append(f'<path d="M{at} 170V28" class="threshold"/>')
        anchor = "start" if at < 250 else "end"
        beside = at + 5 if at < 250 else at - 5
        parts.append(text(beside, 32, f"threshold {cluster.threshold:.4g}", "note", anchor))
    cuts = amounts.cuts[cluster.index]
    places = [None if np.isnan(cut) else min(max(x.at(_magnitude(cut)), 58), 380) for cut in cuts]
    listed = ",".join("" if place is None else f"{place:g}" for place in places)
    parts.append(f'<path d="M0 0" class="cut" data-places="{listed}" data-line="170 34"/>')
    flat = int(np.count_nonzero(np.isposinf(density)))
    if flat:
        note = f"about {100 * flat / len(density):.2g} % without volume"
        parts.append(text(380, 46, note, "note", "end"))
    return picture(396, 210, f"Densities of cluster {cluster.index}", parts)


def _bars(
    x: Axis,
    y: Axis,
    edges: NDArray[np.float64],
    heights: NDArray[np.float64],
    bases: NDArray[np.float64],
    kind: str,
) -> str:
    """Draw bars that stand on others."""
    path = []
    for low, high, height, base in zip(edges[:-1], edges[1:], heights, bases, strict=True):
        if height:
            top, bottom = y.at(height + base), y.at(base)
            path.append(f"M{x.at(low)} {bottom}V{top}H{x.at(high)}V{bottom}z")
    return f'<path d="{"".join(path)}" class="{kind}"/>'


def stage_chart(seconds: Mapping[str, float]) -> str:
    """Draw the wall time of each stage."""
    total = sum(seconds.values())
    height = 26 * len(seconds) + 8
    x = Axis(0, max([*seconds.values(), 1e-3]), 96, 380)
    parts = []
    for number, (stage, value) in enumerate(seconds.items()):
        top = 26 * number + 6
        share = f" ({100 * value / total:.0f} %)" if total else ""
        parts.append(text(88, top + 14, stage, "tick", "end"))
        parts.append(
            f'<rect x="96" y="{top}" width="{max(x.at(value) - 96, 1):.1f}" height="18" '
            'class="bar"/>'
        )
        written = f"{value:.2f} s" if value < 120 else in_time(value)
        parts.append(text(x.at(value) + 6, top + 14, written + share, "note", "start"))
    return picture(490, height, "Wall time of each stage", parts)
