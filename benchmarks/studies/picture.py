"""The plots of the studies."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["draw"]

Floats = NDArray[np.float64]


def draw(path: Path, times: Floats, distances: Floats, ranges: Floats) -> None:
    """Draw all three, side by side.

    Parameters
    ----------
    path : Path
        SVG or PNG.
    times : (n, 2) float64 array
        k; microseconds a point.
    distances : (seeds, m, 4) float64 array
        Clusters; mean, mm; variance, mm²; removed, percent.
    ranges : (seeds, r, 4) float64 array
        Bounds of Eq. 1, percent; SA and DA, percent.
    """
    import matplotlib as mpl  # noqa: PLC0415 (optional, and slow to import)

    mpl.use("agg")
    mpl.rcParams["svg.hashsalt"] = "studies"  # the same bytes again
    from matplotlib import pyplot as plt  # noqa: PLC0415

    figure, (by_k, by_count, by_range) = plt.subplots(1, 3, figsize=(13, 4), layout="constrained")
    by_k.plot(*times.T, "o-")
    by_k.set(xlabel="neighbours k", ylabel="processor time, µs a point", ylim=0)
    _draw_distances(by_count, distances)
    _draw_ranges(by_range, ranges)
    figure.savefig(path, dpi=90, metadata={"Date": None} if path.suffix == ".svg" else None)
    plt.close(figure)


def _draw_distances(axes: Any, distances: Floats) -> None:
    counts = distances[0, :, 0]
    for axis, column, label, colour in (
        (axes, 1, "mean, mm", "C0"),
        (axes.twinx(), 2, "variance, mm²", "C1"),
    ):
        values = distances[:, :, column]
        axis.plot(counts, values.mean(axis=0), "o-", color=colour)
        axis.fill_between(counts, values.min(axis=0), values.max(axis=0), color=colour, alpha=0.15)
        axis.set_ylabel(f"distance to the truth: {label}", color=colour)
    axes.set_xlabel("clusters")


def _draw_ranges(axes: Any, ranges: Floats) -> None:
    low, high, sa, da = ranges.mean(axis=0).T
    for smallest in np.unique(low):
        rows = low == smallest
        axes.plot(da[rows], sa[rows], "o-", label=f"from {smallest:g} %")
        for x, y, bound in zip(da[rows], sa[rows], high[rows], strict=True):
            axes.annotate(f"{bound:g}", (x, y), xytext=(3, 3), textcoords="offset points", size=7)
    axes.set(xlabel="DA, %", ylabel="SA, %", title="numbers: largest removal, %")
    axes.title.set_size("small")
    axes.legend(title="smallest removal", fontsize="small")
