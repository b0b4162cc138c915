"""The figures of one method on one scene, and over the scenes of a group."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import fmean
from typing import NamedTuple

from benchmarks.compare.isolated import Outcome
from pipeline.evaluation.evaluation import Figures
from pipeline.evaluation.scoring import Scores

__all__ = ["COLUMNS", "Result", "Row", "Spread", "row_of"]

_MILLIMETRES = 1000.0


def _scores(figures: Figures) -> Scores:
    assert figures.scores is not None  # the original map is always given
    return figures.scores


def _earth_mover(figures: Figures) -> float | None:
    transport = figures.geometry.earth_mover
    return None if transport is None else _MILLIMETRES * transport.distance


COLUMNS: dict[str, Callable[[Figures], float | None]] = {
    "MAE": lambda each: _MILLIMETRES * each.geometry.distances.mean_absolute_error,
    "variance": lambda each: _MILLIMETRES**2 * each.geometry.distances.variance,
    "RMSE": lambda each: _MILLIMETRES * each.geometry.distances.root_mean_square_error,
    "90th percentile": lambda each: _MILLIMETRES * each.geometry.distances.percentile_90,
    "Chamfer": lambda each: _MILLIMETRES**2 * each.geometry.chamfer.squared,
    "EMD": _earth_mover,
    "FP %": lambda each: _scores(each).confusion.false_positive_percent,
    "FN %": lambda each: _scores(each).confusion.false_negative_percent,
    "precision": lambda each: _scores(each).confusion.precision,
    "recall": lambda each: _scores(each).confusion.recall,
    "F1": lambda each: _scores(each).confusion.f1,
    "SA": lambda each: _scores(each).accuracy.static_accuracy,
    "DA": lambda each: _scores(each).accuracy.dynamic_accuracy,
    "AA": lambda each: _scores(each).accuracy.associated_accuracy,
    "HA": lambda each: _scores(each).accuracy.harmonic_accuracy,
    "PR": lambda each: _scores(each).preservation.preservation_rate,
    "RR": lambda each: _scores(each).preservation.rejection_rate,
    "PR-RR F1": lambda each: _scores(each).preservation.f1,
}
"""Where each column of the tables comes from: millimetres, square millimetres, and percent."""


@dataclass(frozen=True, slots=True)
class Result:
    """One method on one scene.

    Attributes
    ----------
    method, family, scene, group : str
    points : int
        Of the whole map.
    skipped : str or None
        Why there are no figures.
    exhausted : bool
        It took all time or memory that it was given; so it would again.
    figures : dict of str to float or None
        By column; None where undefined.
    key : str
        Of the data, the method and all settings: what has the same one need not be done again.
    """

    method: str
    family: str
    scene: str
    group: str
    points: int
    skipped: str | None
    exhausted: bool
    figures: dict[str, float | None]
    key: str = ""

    @classmethod
    def figures_of(cls, outcome: Outcome, figures: Figures) -> dict[str, float | None]:
        """Take all columns of an outcome and its evaluation."""
        values = {column: value_of(figures) for column, value_of in COLUMNS.items()}
        return values | {
            "removed %": 100 * float(outcome.removed.mean()),
            "s": outcome.seconds,
            "µs a point": 1e6 * outcome.seconds / max(len(outcome.removed), 1),
        }


class Spread(NamedTuple):
    """A figure over several scenes."""

    mean: float
    least: float
    largest: float


@dataclass(frozen=True, slots=True)
class Row:
    """One method over the scenes of a group.

    Attributes
    ----------
    method, family : str
    scenes : int
        It was to be run on.
    missing : int
        Of them, those on which it was skipped: the figures are over the others.
    skipped : str or None
        Why, on the first of those.
    figures : dict of str to Spread or None
        By column; None where undefined for a scene. Empty where it was skipped on all.
    """

    method: str
    family: str
    scenes: int
    missing: int
    skipped: str | None
    figures: dict[str, Spread | None]


def row_of(results: Sequence[Result]) -> Row:
    """Put together the results of a method."""
    first = results[0]
    reasons = [each.skipped for each in results if each.skipped is not None]
    measured = [each for each in results if each.skipped is None]
    figures: dict[str, Spread | None] = {}
    for column in measured[0].figures if measured else ():
        values = [each.figures[column] for each in measured]
        defined = [value for value in values if value is not None]
        complete = len(defined) == len(values)
        figures[column] = Spread(fmean(defined), min(defined), max(defined)) if complete else None
    skipped = reasons[0] if reasons else None
    return Row(first.method, first.family, len(results), len(reasons), skipped, figures)
