"""The page itself: what the run reports, put in place."""

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from pathlib import Path
from typing import Any, Self

import numpy as np
import yaml
from markupsafe import Markup

from dynahull.parameters import RemovalParameters
from dynahull.result import ClusterSummary
from pipeline.configuration.quantities import in_time, in_units
from pipeline.outputs.map_sample import MapSample
from pipeline.outputs.run_report import ClusterReport, RunReport, share_of
from pipeline.places import Decision
from pipeline.report_page.charts import (
    MOST_HISTOGRAMS,
    Axis,
    DensityChart,
    TileChart,
    TileWork,
    density_charts,
    equation_axes,
)
from pipeline.report_page.encoding import EncodedSample, encode, icon
from pipeline.report_page.percentages import (
    Percentages,
    confidence_percentages,
    removal_percentages,
)
from pipeline.showing import printable
from pipeline.templates import package_text, render

_ASSETS = "report_page/assets"
_SCRIPTS = ("three.bundle.js", "data.js", "scene.js", "views.js", "page.js")

_MOST_CLUSTERS = 100
"""Rows of the table of clusters, the largest clusters first."""


_MOST_FILES = 1_000
"""Of a map of more, the views go to the first."""


@dataclass(frozen=True, slots=True)
class Views:
    """What of a page takes time: measured before the rest, which tells how long it took."""

    sample: MapSample
    """What the views show."""
    percentages: Percentages
    encoded: EncodedSample
    densities: list[DensityChart]

    @classmethod
    def of(
        cls,
        sample: MapSample,
        summaries: Sequence[ClusterSummary],
        removal: RemovalParameters,
        decision: Decision,
    ) -> Self:
        """Prepare the views of a run, from its sample, its clusters and how it was decided."""
        clusters = [ClusterReport.of(summary) for summary in summaries]
        if removal.weighs_evidence:
            percentages = confidence_percentages(sample, clusters, removal.confidence, decision)
        else:
            percentages = removal_percentages(sample, clusters, removal.model_dump())
        densities = density_charts(sample, clusters, percentages)
        return cls(sample, percentages, encode(sample, percentages), densities)


def render_page(report: RunReport, views: Views, tiles: TileWork | None) -> str:
    """Return the page of a run, as HTML.

    Every figure of it is one of the report, or is told to be an estimate. There are no tiles where
    the map was one, cleaned in memory.
    """
    removal = report.configuration["removal"]
    by_evidence = removal["decision"] == "auto"
    least, most = removal["min_percent"], removal["max_percent"]
    largest = sorted(report.clusters, key=lambda each: (-each.count, each.index))[:_MOST_CLUSTERS]
    facts = views.encoded.facts | {
        "removed": report.counts["dynamic"],
        "removed_points": views.percentages.removed_points.tolist(),
        "table_step": views.percentages.step,
        "confidence": removal["confidence"] if by_evidence else None,
        "min_ratio": least / most if most else 1.0,
        "min_percent": least,
        "apply": shlex.join(["dynahull-pipeline", "apply", report.output])
        if report.configuration["output"]["labels"]
        else None,
        "files": _files(report, views.sample),
    }
    return render(
        f"{_ASSETS}/page.html",
        title=_title(report),
        icon=icon(views.sample),
        style=_asset("page.css"),
        scripts=[_asset(name) for name in _SCRIPTS],
        report=report,
        removal=removal,
        by_evidence=by_evidence,
        figures=_figures(report),
        share_of=share_of,
        sample=views.sample,
        most_percent=min(100, ceil(max(3 * most, 20))),
        margin=views.percentages.margin,
        densities=views.densities,
        most_histograms=MOST_HISTOGRAMS,
        axes=equation_axes(report.clusters, most),
        clusters=sorted(largest, key=lambda each: each.index),
        tiles=tiles,
        work_time=None if tiles is None else _seconds(float(tiles.seconds.sum())),
        tile_chart=None if tiles is None else TileChart.of(tiles),
        stage_axis=Axis(0, max([*report.seconds.values(), 1e-3]), 96, 380),
        configuration=yaml.safe_dump(report.configuration, sort_keys=False),
        facts=facts,
        arrays=views.encoded.arrays,
    )


def _files(report: RunReport, sample: MapSample) -> list[dict[str, Any]]:
    """Return the files of a map of several, and where their sampled points lie."""
    if len(report.files) == 1:
        return []
    starts = np.searchsorted(sample.rows, [file.first_row for file in report.files])
    parts = zip(report.files, np.split(sample.xyz, starts[1:]), strict=True)
    return [
        {
            "name": printable(Path(file.path).name),
            "low": xyz.min(axis=0).tolist(),
            "high": xyz.max(axis=0).tolist(),
        }
        for file, xyz in parts
        if len(xyz)
    ][:_MOST_FILES]


def _asset(name: str) -> Markup:
    return Markup(package_text(f"{_ASSETS}/{name}"))


def _title(report: RunReport) -> str:
    name = printable(Path(report.files[0].path).name)
    return name if len(report.files) == 1 else f"{name} and {len(report.files) - 1} more files"


def _figures(report: RunReport) -> list[tuple[str, str, str]]:
    """Return the name of each figure, its value, and what there is to say of it."""
    counts = report.counts
    removed, ground = counts["dynamic"], counts["ground"]
    figures = [
        ("points in the map", f"{report.points:,}", ""),
        ("removed", f"{removed:,}", f"{_percent(removed, report.points)} of the map"),
        ("static, kept", f"{counts['static']:,}", ""),
        ("ground, kept", f"{ground:,}", _percent(ground, report.points)),
    ]
    for label in ("above", "unscored", "invalid"):
        if counts[label]:
            figures.append((f"{label}, kept", f"{counts[label]:,}", ""))
    if report.place_count is not None:
        uncertain = report.uncertain_points
        kept = "" if uncertain is None else f"{uncertain:,} points uncertain, kept"
        figures.append(("places", f"{report.place_count:,}", kept))
    if report.time is not None:
        known = report.time != "none"
        figures.append(("scans", "known" if known else "unknown", report.time if known else ""))
    figures.append(("clusters", f"{len(report.clusters):,}", ""))
    figures.append(("wall time", _seconds(sum(report.seconds.values())), "all stages below"))
    peak, whose = report.peak_memory_all_bytes, "of all processes together, at most"
    if peak is None:
        peak, whose = report.peak_memory_bytes, "of the main process"
    figures.append(("peak memory", in_units(peak), whose))
    return figures


def _percent(part: int, whole: int) -> str:
    return share_of(part, whole) if part else "0 %"


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 120 else in_time(seconds)
