"""The table of places: where points were removed, how many, how surely, and why."""

from html import escape

from pipeline.decision import Place
from pipeline.outputs.run_report import RunReport, share_of


def place_section(report: RunReport) -> str:
    """Return the section of the page that names the places; nothing where there are none."""
    if not report.counts["dynamic"] or report.place_count is None:
        return ""
    return (
        '<section aria-labelledby="places-title"><h2 id="places-title">Where and why</h2>'
        f"{_table(report)}{_rest(report)}</section>"
    )


def _table(report: RunReport) -> str:
    if not report.places:
        return ""
    rows = "".join(_row(place, report.counts["dynamic"]) for place in report.places)
    return (
        '<div class="wide places" tabindex="0"><table><thead><tr><th>place</th><th>points</th>'
        "<th>of all removed</th><th>size, m</th><th>mean score</th><th>why</th></tr></thead>"
        f"<tbody>{rows}</tbody></table></div>"
    )


def _row(place: Place, removed: int) -> str:
    number = place.number
    size = " × ".join(f"{value:,.1f}" for value in place.size)  # noqa: RUF001
    why = "; ".join(f"{why.words} ({100 * why.share:.0f} %)" for why in place.reasons)
    return (
        f'<tr><td><button type="button" data-place="{number}" disabled '
        f'aria-label="Show place {number}">{number}</button></td>'
        f"<td>{place.points:,}</td><td>{share_of(place.points, removed)}</td><td>{size}</td>"
        f"<td>{place.score:.2f}</td><td>{escape(why)}</td></tr>"
    )


def _rest(report: RunReport) -> str:
    """Return what is not in the table, in words."""
    count, listed = report.place_count or 0, len(report.places)
    confidence = report.configuration["removal"]["confidence"]
    lines = [f"The largest {listed} of {count:,} places."] if count > listed else []
    if report.places:
        lines.append("A number shows its place in the 3D view and in the sections.")
    if report.scattered_points:
        lines.append(
            f"{report.scattered_points:,} removed points are scattered: their groups are too small."
        )
    if report.uncertain_points:
        lines.append(
            f"{report.uncertain_points:,} points are uncertain and kept: their score is below "
            f"{confidence:g}, but at least half of it. Move the slider to see them go."
        )
    return f'<p class="hint">{escape(" ".join(lines))}</p>' if lines else ""
