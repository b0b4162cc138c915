"""The page to look at in the morning: every map, what became of it, and its report."""

from datetime import UTC, datetime
from html import escape
from pathlib import Path
from urllib.parse import quote

from pipeline.nightly.results import begun
from pipeline.nightly.summary import FAILURES, MapLine, MapOutcome, NightSummary
from pipeline.showing import printable
from tiling.atomic import atomic_file

INDEX_FILE = "index.html"

_OWN_TITLE = "<title>dynahull-pipeline: night of "

_PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
{title}{night}</title>
<style>
:root {{ color-scheme: light dark; }}
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 75rem;
  padding: 0 1rem; }}
table {{ border-collapse: collapse; width: 100%; }}
th, td {{ text-align: left; vertical-align: top; padding: .35rem .6rem;
  border-bottom: 1px solid #8884; }}
td.number, th.number {{ text-align: right; font-variant-numeric: tabular-nums; }}
td.map {{ overflow-wrap: anywhere; }}
.bad {{ color: #c62828; font-weight: 600; }}
.reason {{ color: #888; overflow-wrap: anywhere; }}
@media (max-width: 50rem) {{
  thead {{ display: none; }}
  tr {{ display: block; padding: .5rem 0; border-bottom: 1px solid #8884; }}
  td, td.number {{ display: block; text-align: left; padding: 0; border: 0; }}
  td:empty {{ display: none; }}
  td.map {{ font-weight: 600; }}
  td[data-of]::before {{ content: attr(data-of) ": "; color: #888; }}
}}
</style>
</head>
<body>
<h1>Night of {night}</h1>
<p>{text}. Exit code {code}.</p>
{problems}<table>
<thead><tr><th>map</th><th>tonight</th><th>last good result</th><th class="number">points</th>
<th class="number">removed</th><th class="number">seconds</th></tr></thead>
<tbody>
{rows}
</tbody>
</table>
<p><a href="nightly.json">nightly.json</a> · <a href="nightly.jsonl">nightly.jsonl</a> ·
dynahull-pipeline {version}</p>
</body>
</html>
"""

_MINUTE = "%Y-%m-%d %H:%M UTC"

_BAD = (*FAILURES, MapOutcome.SET_ASIDE)


def write_index(folder: Path, summary: NightSummary) -> None:
    """Replace `index.html`, which opens from the disk and needs nothing else."""
    with atomic_file(folder / INDEX_FILE) as temporary:
        temporary.write_text(index_page(summary), encoding="utf-8")


def is_index(path: Path) -> bool:
    """Tell whether a file is a page that a night wrote."""
    try:
        return _OWN_TITLE in path.read_text(encoding="utf-8")
    except (OSError, ValueError):
        return False


def index_page(summary: NightSummary) -> str:
    """Return the page: what went wrong first, then the maps by name."""
    lines = sorted(summary.maps, key=lambda line: (line.outcome not in _BAD, line.map))
    problems = "".join(f'<p class="bad">{escape(each)}</p>\n' for each in summary.problems)
    return _PAGE.format(
        title=_OWN_TITLE,
        night=f"{datetime.fromisoformat(summary.night):{_MINUTE}}",
        text=escape(summary.to_text()),
        code=summary.exit_code,
        problems=problems,
        rows="\n".join(_row(line) for line in lines),
        version=escape(summary.version),
    )


def _row(line: MapLine) -> str:
    outcome = f'<span class="bad">{line.outcome}</span>' if line.outcome in _BAD else line.outcome
    if line.reason:
        tries = f" ({line.attempts} nights)" if line.attempts > 1 else ""
        outcome += f'<div class="reason">{escape(printable(line.reason))}{tries}</div>'
    result = ""
    if line.run and line.report:
        result = f'<a href="{quote(line.report)}">report of {_run_time(line.run)}</a>'
        result += f' · <a href="{quote(line.run)}/">files</a>'
    points = "" if line.points is None else f"{line.points:,}"
    removed = ""
    if line.points and line.removed is not None:
        removed = f"{line.removed:,} ({100 * line.removed / line.points:.1f}&nbsp;%)"
    seconds = "" if line.seconds is None else f"{line.seconds:,.0f}"
    return (
        f'<tr><td class="map">{escape(printable(line.map))}</td><td>{outcome}</td><td>{result}</td>'
        f'<td class="number" data-of="points">{points}</td>'
        f'<td class="number" data-of="removed">{removed}</td>'
        f'<td class="number" data-of="seconds">{seconds}</td></tr>'
    )


def _run_time(run: str) -> str:
    return f"{datetime.fromtimestamp(begun(Path(run)), UTC):{_MINUTE}}"
