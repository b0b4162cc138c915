"""The tables, as Markdown: those of the paper, and that of the DynamicMap benchmark and ERASOR."""

from collections.abc import Iterator, Sequence
from itertools import groupby

from benchmarks.compare.results import Result, Spread, row_of

__all__ = ["tables"]

_TABLES = {
    "Accuracy: distances to the static map, mm; variance and Chamfer, mm²": {
        "MAE": 2,
        "variance": 0,
        "RMSE": 1,
        "90th percentile": 2,
        "Chamfer": 0,
        "EMD": 0,
    },
    "Decisions, percent of points; time": {
        "FP %": 2,
        "FN %": 2,
        "precision": 1,
        "recall": 1,
        "F1": 1,
        "removed %": 2,
        "s": 1,
        "µs a point": 1,
    },
    "DynamicMap benchmark (SA, DA, AA, HA) and ERASOR (PR, RR, F1), percent": {
        "SA": 1,
        "DA": 1,
        "AA": 1,
        "HA": 1,
        "PR": 1,
        "RR": 1,
        "PR-RR F1": 1,
    },
}
"""Columns of each table, and their decimals."""


def tables(results: Sequence[Result]) -> str:
    """Return the tables of each group of scenes, a row a method: means, and ranges."""
    by_group = sorted(results, key=lambda each: _first(results, each))
    return "\n".join(
        line
        for group, members in groupby(by_group, key=lambda each: each.group)
        for line in _group(group, list(members))
    )


def _first(results: Sequence[Result], result: Result) -> int:
    """Return where the group of a result was first seen, so that groups keep their order."""
    return next(number for number, each in enumerate(results) if each.group == result.group)


def _group(group: str, results: Sequence[Result]) -> Iterator[str]:
    names = dict.fromkeys(each.method for each in results)
    rows = [row_of([each for each in results if each.method == name]) for name in names]
    scenes = {each.scene: each.points for each in results}
    yield f"\n## {group}\n"
    yield f"{sum(scenes.values()):,} points: {'; '.join(scenes)}.\n"
    for title, columns in _TABLES.items():
        yield f"### {title}\n"
        yield "| method | needs | scenes | " + " | ".join(columns) + " |"
        yield "|---|---|---|" + "---|" * len(columns)
        for row in rows:
            if row.figures:
                cells = [_cell(row.figures[name], digits) for name, digits in columns.items()]
                found = f"{row.scenes - row.missing} of " if row.missing else ""
                begin = f"| {row.method} | {row.family} | {found}{row.scenes} | "
                yield begin + " | ".join(cells) + " |"
        yield ""
    skipped = [row for row in rows if row.skipped is not None]
    if skipped:
        yield "Skipped:\n"
        for row in skipped:
            where = f" on {row.missing} of {row.scenes} scenes" if row.figures else ""
            yield f"- {row.method}{where}: {row.skipped}"


def _cell(value: Spread | None, digits: int) -> str:
    """Return the mean, and from the least to the largest where they differ as written."""
    if value is None:
        return "-"
    mean, least, largest = (f"{each:,.{digits}f}" for each in value)
    return mean if least == largest else f"{mean} ({least} to {largest})"
