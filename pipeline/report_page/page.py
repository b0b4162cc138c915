"""The page itself: what the run reports, put in place."""

import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any, Self

import yaml

from dynahull.parameters import RemovalParameters
from dynahull.result import ClusterSummary
from pipeline.configuration.quantities import in_time, in_units
from pipeline.decision import Decision
from pipeline.outputs.map_sample import MapSample
from pipeline.outputs.run_report import ClusterReport, RunReport
from pipeline.report_page.amounts import (
    Amounts,
    confidence_amounts,
    removal_amounts,
)
from pipeline.report_page.charts import (
    MOST_HISTOGRAMS,
    density_charts,
    rescale_chart,
    stage_chart,
)
from pipeline.report_page.encoding import EncodedSample, encode
from pipeline.report_page.place_table import place_section
from pipeline.report_page.tile_chart import MOST_TILES, TileWork, shade_limits, tile_chart
from pipeline.showing import printable

_ASSETS = Path(__file__).resolve().parent / "assets"
_SCRIPTS = ("three.bundle.js", "data.js", "scene.js", "views.js", "page.js")

_MOST_CLUSTERS = 100
"""Rows of the table of clusters, the largest clusters first."""

_MOST_FILES = 100

_AMOUNT_KNOB = (
    '<label for="amount">Largest cluster loses <code>removal.max_percent</code></label>'
    '<input type="range" id="amount" min="0" max="100" step="0.1" disabled>'
)
_CONFIDENCE_KNOB = (
    '<label for="amount">Points go from a score of <code>removal.confidence</code></label>'
    '<input type="range" id="amount" min="0.05" max="0.95" step="0.01" disabled>'
)

# Nothing is loaded, from anywhere; scripts and styles are those within the page.
_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"
)


@dataclass(frozen=True, slots=True)
class Views:
    """What of a page takes time: measured before the rest, which tells how long it took.

    Attributes
    ----------
    sample : MapSample
        What the views show.
    amounts : Amounts
    encoded : EncodedSample
    densities : str
        HTML.
    """

    sample: MapSample
    amounts: Amounts
    encoded: EncodedSample
    densities: str

    @classmethod
    def of(
        cls,
        sample: MapSample,
        summaries: Sequence[ClusterSummary],
        removal: RemovalParameters,
        decision: Decision | None,
    ) -> Self:
        """Prepare the views of a run, from its sample, its clusters and how it was decided."""
        clusters = [ClusterReport.of(summary) for summary in summaries]
        if decision is None:
            amounts = removal_amounts(sample, clusters, removal.model_dump())
        else:
            amounts = confidence_amounts(sample, clusters, removal.confidence, decision)
        densities = _densities(sample, clusters, amounts)
        return cls(sample, amounts, encode(sample, amounts), densities)


def render_page(report: RunReport, views: Views, tiles: TileWork | None) -> str:
    """Return the page of a run, as HTML.

    Parameters
    ----------
    report : RunReport
        Every figure of the page is one of it, or is told to be an estimate.
    views : Views
    tiles : TileWork or None
        None where the map was one tile, cleaned in memory.
    """
    removal = report.configuration["removal"]
    weighs = removal["decision"] == "auto"
    contents = {
        "hidden": " hidden" if weighs else "",
        "question": f"What would another {'confidence' if weighs else 'amount'} take?",
        "knob": _CONFIDENCE_KNOB if weighs else _AMOUNT_KNOB,
        "score": '<option value="4">score: yellow is likely to have moved</option>'
        if weighs
        else "",
        "verdict": "".join(f"<p>{escape(line)}</p>" for line in report.verdict()),
        "places": place_section(report),
        "losses": "What each cluster loses" if weighs else "Eq. 1: how much each cluster loses",
        "title": escape(_title(report)),
        "subtitle": _subtitle(report),
        "figures": _figures(report),
        "warnings": _warnings(report),
        "files": _files(report),
        "note": _sample_note(views.sample, views.amounts, removal),
        "rescale": rescale_chart(report.clusters, removal),
        "equation": _confidence(removal) if weighs else _equation(removal),
        "clusters": _cluster_table(report),
        "densities": views.densities,
        "tiles": _tiles(report, tiles),
        "stages": stage_chart(report.seconds),
        "configuration": escape(yaml.safe_dump(report.configuration, sort_keys=False)),
        "policy": _POLICY,
        "style": _template("page.css"),
        "data": _data(report, views.encoded, views.amounts),
        "scripts": "\n".join(f"<script>\n{_template(name)}\n</script>" for name in _SCRIPTS),
    }
    # In one pass: nothing is looked for in what was put in.
    return re.sub(r"<!--(\w+)-->", lambda mark: contents[mark[1]], _template("page.html"))


def _template(name: str) -> str:
    return (_ASSETS / name).read_text(encoding="utf-8")


def _title(report: RunReport) -> str:
    name = printable(Path(report.files[0].path).name)
    return name if len(report.files) == 1 else f"{name} and {len(report.files) - 1} more files"


def _subtitle(report: RunReport) -> str:
    finished = report.finished.replace("T", " ").replace("+00:00", " UTC")
    return escape(
        f"Cleaned with DynaHull (arXiv 2401.07541) by dynahull-pipeline {report.version}, "
        f"{finished}"
    )


def _figures(report: RunReport) -> str:
    removed = report.counts["dynamic"]
    figures = [
        ("points in the map", f"{report.points:,}", ""),
        ("removed", f"{removed:,}", f"{_percent(removed, report.points)} of the map"),
        ("static, kept", f"{report.counts['static']:,}", ""),
        (
            "ground, kept",
            f"{report.counts['ground']:,}",
            _percent(report.counts["ground"], report.points),
        ),
    ]
    for label in ("above", "unscored", "invalid"):
        if report.counts[label]:
            figures.append((f"{label}, kept", f"{report.counts[label]:,}", ""))
    if report.place_count is not None:
        kept = f"{report.uncertain_points:,} points uncertain, kept"
        figures.append(("places", f"{report.place_count:,}", kept))
    figures.append(("clusters", f"{len(report.clusters):,}", ""))
    figures.append(("wall time", _seconds(sum(report.seconds.values())), "all stages below"))
    figures.append(("peak memory", in_units(report.peak_memory_bytes), "of the main process"))
    return "".join(
        f'<div class="figure"><dt>{escape(name)}</dt><dd>{escape(value)}'
        f"<small>{escape(more)}</small></dd></div>"
        for name, value, more in figures
    )


def _warnings(report: RunReport) -> str:
    if not report.warnings:
        return '<p class="fine">No warnings.</p>'
    lines = "".join(f"<li>{escape(printable(warning))}</li>" for warning in report.warnings)
    return f'<ul class="warnings" id="warnings">{lines}</ul>'


def _files(report: RunReport) -> str:
    rows = "".join(
        f"<tr><td>{_name(file.path)}</td><td>{escape(file.format)}</td><td>{file.points:,}</td>"
        f"<td>{in_units(file.size_bytes)}</td><td>{_name(', '.join(file.outputs))}</td></tr>"
        for file in report.files[:_MOST_FILES]
    )
    more = _more(len(report.files), _MOST_FILES, "files")
    return (
        '<div class="wide"><table><thead><tr><th>map</th><th>format</th><th>points</th>'
        "<th>size</th><th>written</th></tr></thead>"
        f"<tbody>{rows}</tbody></table>"
        f"</div>{more}<p>Output folder: <code>{_name(report.output)}</code>. SHA-256 of the "
        f"input: <code>{escape(report.input_hash)}</code></p>"
    )


def _name(name: str) -> str:
    return escape(printable(name))


def _sample_note(sample: MapSample, amounts: Amounts, removal: dict[str, Any]) -> str:
    if len(sample) == sample.total:
        shown = f"All {sample.total:,} points are shown."
        precise = "The cut of each cluster is exact."
    else:
        shown = (
            f"{len(sample):,} of {sample.total:,} points are shown, evenly drawn by row number "
            f"(1 in {sample.total / max(len(sample), 1):.1f})."
        )
        precise = (
            "Which points are red is estimated from the sample: the cut of a cluster is right to "
            f"about ± {amounts.margin:.2g} % of its points (95 %)."
        )
    if removal["decision"] == "auto":
        return (
            f"{shown} Red is what goes: a score of at least the confidence. Counts are exact, of "
            "the whole map, at every hundredth."
        )
    stepped = (
        " With the threshold <code>stepped</code> the count is that of the run, in proportion."
        if removal["threshold"] == "stepped"
        else ""
    )
    return (
        f"{shown} At the run's own setting the count is the run's. Elsewhere it is what Eq. 1 "
        "takes of the run's N_i; points whose neighbourhood has no volume are never removed, and "
        f"their share is that in the sample. {precise}{stepped}"
    )


def _equation(removal: dict[str, Any]) -> str:
    low, high = removal["min_percent"], removal["max_percent"]
    return (
        f"R_i = (N_i - N_min) / (N_max - N_min) × ({high:g} % - {low:g} %) + {low:g} %: "  # noqa: RUF001
        "the larger a cluster is, the larger the share of it that is removed."
    )


def _confidence(removal: dict[str, Any]) -> str:
    return (
        "Points go whose probability of having moved is at least "
        f"removal.confidence = {removal['confidence']:g}. R_i is what Eq. 1 would take."
    )


def _cluster_table(report: RunReport) -> str:
    largest = sorted(report.clusters, key=lambda each: (-each.count, each.index))[:_MOST_CLUSTERS]
    rows = []
    for cluster in sorted(largest, key=lambda each: each.index):
        threshold = "-" if cluster.threshold is None else f"{cluster.threshold:.4g}"
        centre = ", ".join(f"{value:,.1f}" for value in cluster.centroid)
        rows.append(
            f"<tr><td>{cluster.index}</td><td>{cluster.count:,}</td>"
            f"<td>{cluster.removal_percent:.2f}</td><td>{threshold}</td>"
            f"<td>{cluster.removed:,}</td><td>{centre}</td></tr>"
        )
    return (
        '<div class="wide"><table><thead><tr><th>cluster</th><th>N_i, points</th><th>R_i, %</th>'
        "<th>threshold, points per m³</th><th>removed</th><th>centroid x, y, z, m</th></tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>"
        + _more(len(report.clusters), _MOST_CLUSTERS, "clusters")
    )


def _densities(sample: MapSample, clusters: Sequence[ClusterReport], amounts: Amounts) -> str:
    charts = density_charts(sample, clusters, amounts)
    if not charts:
        return "<p>No point was scored.</p>"
    figures = "".join(f"<figure>{chart}</figure>" for chart in charts)
    populated = sum(1 for cluster in clusters if cluster.count)
    return f'<div class="charts">{figures}</div>' + _more(populated, MOST_HISTOGRAMS, "clusters")


def _tiles(report: RunReport, tiles: TileWork | None) -> str:
    if tiles is None:
        return (
            f"<p>One tile of {report.points:,} points, done in this run: a map this small is "
            "cleaned in memory.</p>"
        )
    words = f"{len(tiles):,} tiles, {_seconds(float(tiles.seconds.sum()))} of work in all"
    resumed, overfull = int(tiles.resumed.sum()), int(tiles.overfull.sum())
    states = [f"{len(tiles) - resumed:,} done in this run"]
    states += [f"{resumed:,} kept from an interrupted run (dashed)"] if resumed else []
    states += [f"{overfull:,} with more points than tiling.max_points (thick)"] if overfull else []
    if not 0 < len(tiles) <= MOST_TILES:
        return f"<p>{words}: {', '.join(states)}.</p>"
    limits = shade_limits(tiles.seconds)
    legend = "".join(
        f'<span><svg viewBox="0 0 14 14" aria-hidden="true"><rect width="14" height="14" '
        f'class="tile shade{number}"/></svg>to {limits[number + 1]:.2g} s</span>'
        for number in range(len(limits) - 1)
    )
    return (
        f"<p>{words}: {', '.join(states)}.</p><figure>{tile_chart(tiles)}</figure>"
        f'<p class="legend">{legend}</p>'
    )


def _data(report: RunReport, encoded: EncodedSample, amounts: Amounts) -> str:
    removal = report.configuration["removal"]
    facts = encoded.facts | {
        "removed": report.counts["dynamic"],
        "removed_points": amounts.removed_points.tolist(),
        "table_step": amounts.step,
        "confidence": removal["confidence"] if removal["decision"] == "auto" else None,
        "min_ratio": removal["min_percent"] / removal["max_percent"]
        if removal["max_percent"]
        else 1.0,
        "min_percent": removal["min_percent"],
    }
    arrays = "\n".join(
        f'<script type="text/plain" id="array-{name}">{text}</script>'
        for name, text in encoded.arrays.items()
    )
    run = report.model_dump(mode="json")
    return (
        f'<script type="application/json" id="facts">{_json(facts)}</script>\n'
        f'<script type="application/json" id="run">{_json(run)}</script>\n'
        f"{arrays}"
    )


def _json(value: Any) -> str:
    """Write JSON that no HTML parser takes for the end of the script it stands in."""
    return json.dumps(value).replace("<", "\\u003c")


def _more(count: int, shown: int, what: str) -> str:
    return f"<p>The largest {shown} of {count:,} {what}.</p>" if count > shown else ""


def _percent(part: int, whole: int) -> str:
    return f"{100 * part / whole:.1f} %" if whole else "0 %"


def _seconds(seconds: float) -> str:
    return f"{seconds:.1f} s" if seconds < 120 else in_time(seconds)
