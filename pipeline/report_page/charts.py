"""What the charts that do not move show; `assets/charts.html` draws them as SVG."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import ceil, floor, isfinite, log10
from typing import Self, TypeGuard

import numpy as np
from numpy.typing import NDArray

from dynahull.labels import Label
from pipeline.outputs.map_sample import MapSample, magnitude
from pipeline.outputs.run_report import ClusterReport
from pipeline.report_page.percentages import Percentages

MOST_HISTOGRAMS = 12
"""Clusters whose densities are drawn, the largest first."""

MOST_TILES = 2_000
"""Tiles that are drawn, each with its numbers; more would not be told apart."""

_SHADES = 6
_BINS = 60


def short(value: float) -> str:
    """Write a number as people read it on an axis: 1.2 k, 35 M."""
    for size, unit in ((1e9, " G"), (1e6, " M"), (1e3, " k")):
        if abs(value) >= size:
            return f"{value / size:.3g}{unit}"
    return f"{value:.3g}"


def power_of_ten(exponent: float) -> str:
    """Write 10 to a power as a number where that is short."""
    return short(10.0**exponent) if -3 < exponent < 9 else f"1e{exponent:g}"


@dataclass(frozen=True, slots=True)
class Axis:
    """A straight scale between two numbers, along some pixels."""

    low: float
    high: float
    """What is at the ends."""
    begin: float
    end: float
    """Pixels of the ends."""
    title: str = ""
    write: Callable[[float], str] = short
    """Writes a number beside the axis."""

    def at(self, value: float) -> float:
        """Return the pixel of a value, to a tenth."""
        span = (self.high - self.low) or 1.0
        return round(self.begin + (value - self.low) / span * (self.end - self.begin), 1)

    def ticks(self, count: int = 5) -> list[float]:
        """Return about `count` round numbers on the axis."""
        span = self.high - self.low
        if self.write is power_of_ten and span > 0:
            return self._powers(count)
        if span <= 0:
            return [self.low]
        rough = span / max(count, 1)
        if not isfinite(rough):
            raise ValueError(f"expected an axis of finite limits, found {self.low} to {self.high}")
        size = 10.0 ** floor(log10(rough))
        step = next(size * factor for factor in (1, 2, 5, 10) if size * factor >= rough * 0.999)
        first, last = ceil(self.low / step - 1e-9), floor(self.high / step + 1e-9)
        return [round(number * step, 12) for number in range(first, last + 1)]

    def _powers(self, count: int) -> list[float]:
        """Return the logarithms of round numbers: powers of ten, or 1, 2 and 5 times them."""
        decades = range(floor(self.low) - 1, ceil(self.high) + 1)
        for parts in ((1, 2, 5), (1, 3), (1,)):
            places = [decade + log10(part) for decade in decades for part in parts]
            ticks = [place for place in places if self.low <= place <= self.high]
            if len(ticks) <= count + 1:
                return ticks
        return ticks[:: -(-len(ticks) // count)]


def equation_axes(clusters: Sequence[ClusterReport], most_percent: float) -> tuple[Axis, Axis]:
    """Return the axes of Eq. 1: R_i of each cluster over its N_i."""
    largest = max((cluster.count for cluster in clusters), default=0) or 1
    return (
        Axis(0, largest * 1.05, 64, 470, "N_i, points in the cluster"),
        Axis(0, max(most_percent * 1.15, 1), 250, 16, "R_i, share removed, %", "{:g}".format),
    )


@dataclass(frozen=True, slots=True)
class DensityChart:
    """The densities of a cluster, as a histogram."""

    cluster: ClusterReport
    x: Axis
    y: Axis
    kept: str
    removed: str
    """Outlines of the bars; those that are kept stand on those that were removed."""
    threshold_at: float | None
    """Pixel of the run's threshold, where it is drawn."""
    cuts: str
    """Pixels of the cut at 0, 1 ... 100 %, by commas."""
    flat_percent: float
    """Share of the sampled points whose neighbourhood has no volume."""

    @classmethod
    def of(
        cls,
        sample: MapSample,
        cluster: ClusterReport,
        percentages: Percentages,
        edges: NDArray[np.float64],
    ) -> Self:
        """Count the sampled points of a cluster between edges, scaled to the whole cluster."""
        members = sample.cluster == cluster.index
        density, labels = sample.density[members], sample.labels[members]
        scale = cluster.count / max(len(density), 1)
        finite = np.isfinite(density)
        place = np.clip(magnitude(density[finite]), edges[0], edges[-1])
        every, _ = np.histogram(place, edges)
        gone, _ = np.histogram(place[labels[finite] == Label.DYNAMIC], edges)
        x = Axis(edges[0], edges[-1], 58, 380, "density k / v, points per m³", power_of_ten)
        y = Axis(0, max(every.max(initial=0) * scale * 1.12, 1), 170, 34, "points")
        cuts = [
            "" if np.isnan(cut) else f"{min(max(x.at(_magnitude(cut)), 58), 380):g}"
            for cut in percentages.cuts[cluster.index]
        ]
        return cls(
            cluster,
            x,
            y,
            kept=_bars(x, y, edges, (every - gone) * scale, gone * scale),
            removed=_bars(x, y, edges, gone * scale, np.zeros(len(gone))),
            threshold_at=x.at(_magnitude(cluster.threshold))
            if _is_drawn(cluster.threshold)
            else None,
            cuts=",".join(cuts),
            flat_percent=100 * int(np.isposinf(density).sum()) / max(len(density), 1),
        )


def density_charts(
    sample: MapSample, clusters: Sequence[ClusterReport], percentages: Percentages
) -> list[DensityChart]:
    """Return the densities of the largest clusters, on one scale; none where none was scored."""
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
    return [DensityChart.of(sample, cluster, percentages, edges) for cluster in drawn]


def _is_drawn(threshold: float | None) -> TypeGuard[float]:
    return threshold is not None and np.isfinite(threshold)


def _magnitude(density: float) -> float:
    return float(magnitude(np.array([density]))[0])


def _bars(
    x: Axis,
    y: Axis,
    edges: NDArray[np.float64],
    heights: NDArray[np.float64],
    bases: NDArray[np.float64],
) -> str:
    """Return the outline of bars that stand on others."""
    path = []
    for low, high, height, base in zip(edges[:-1], edges[1:], heights, bases, strict=True):
        if height:
            top, bottom = y.at(height + base), y.at(base)
            path.append(f"M{x.at(low)} {bottom}V{top}H{x.at(high)}V{bottom}z")
    return "".join(path)


@dataclass(frozen=True, slots=True)
class TileWork:
    """What the tiles of a run took."""

    low: NDArray[np.float64]
    high: NDArray[np.float64]
    """(T, 2): cores, metres."""
    points: NDArray[np.int64]
    """(T,): in each core."""
    seconds: NDArray[np.float64]
    """(T,): of all tasks about the tile, on its worker."""
    resumed: NDArray[np.bool_]
    """(T,): whether the densities were found by an earlier run, which did not end."""
    overfull: NDArray[np.bool_]
    """(T,): whether a tile holds more points than wanted, being a single column of the lattice."""

    def __len__(self) -> int:
        return len(self.points)


@dataclass(frozen=True, slots=True)
class TileChart:
    """The cores of the tiles seen from above, coloured by the time that they took."""

    work: TileWork
    x: Axis
    y: Axis
    limits: list[float]
    """Seconds at the ends of the shades, one more than there are shades."""
    shades: list[int]
    """Of each tile."""

    @classmethod
    def of(cls, work: TileWork) -> Self | None:
        """Lay out the tiles; None where there are none, or too many to be drawn."""
        if not 0 < len(work) <= MOST_TILES:
            return None
        low, high = np.nan_to_num(work.low), np.nan_to_num(work.high)
        least, most = low.min(axis=0), high.max(axis=0)
        width, height = np.maximum(most - least, 1e-9).tolist()
        scale = min(400 / width, 340 / height)
        written = "{:,.10g}".format
        x = Axis(least[0], most[0], 70, 70 + width * scale, "x, m", written)
        y = Axis(least[1], most[1], 12 + height * scale, 12, "y, m", written)
        limits = np.linspace(0, max(float(work.seconds.max(initial=0)), 1e-3), _SHADES + 1)
        found = np.searchsorted(limits, work.seconds, side="left") - 1
        shades = np.clip(found, 0, _SHADES - 1)
        return cls(work, x, y, limits.tolist(), shades.tolist())
