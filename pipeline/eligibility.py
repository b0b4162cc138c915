"""Which points of a map take part in the decision.

Neither do those that cannot be measured, nor those that LAS marks as noise or as deleted
(`input.leave_out`), nor strays (`dynahull.strays`). They are hidden from the method by coordinates
that are not finite, and no tile has them; in the outputs they are where they were.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from dynahull.checking import valid_points
from dynahull.observer import Observer
from dynahull.protection import protected_points
from dynahull.strays import Outskirts, Strays, is_at_origin
from pipeline.configuration.run import Configuration, InputParameters
from pipeline.errors import ConfigurationError
from tiling.collection import MapCollection
from tiling.formats.points import PointBatch
from tiling.survey import Survey, merge, survey_batches

LEFT_OUT, PROTECTED = np.uint8(1), np.uint8(2)
"""Marks of points that take no part, and of those that do and are never removed."""

_NARROW = 0.5
"""Metres: no scanner maps less. As degrees they are 50 km."""

RIM = 10.0
"""Metres around a window whose points take part: more than any evidence looks at."""

Mask = NDArray[np.bool_]


def may_mark(collection: MapCollection, configuration: Configuration) -> bool:
    """Tell whether a map can have points that are left out or protected."""
    parameters, removal = configuration.input, configuration.removal
    by_class = bool(parameters.leave_out or removal.protect_classes)
    asked_for = by_class or parameters.leave_out_withheld
    classified = any(reader.description.has_classification for reader in collection.readers)
    return bool(parameters.has_window or removal.protect) or (asked_for and classified)


def marks(batch: PointBatch, configuration: Configuration) -> NDArray[np.uint8]:
    """Return a mark for each point: 0, `LEFT_OUT`, or `PROTECTED`.

    Around a window, points within `RIM` take part, so that the window's own see what is there;
    they are not removed. All others are left out.
    """
    parameters, removal = configuration.input, configuration.removal
    safe = protected_points(
        batch.xyz, batch.classification, removal.protect_classes, removal.protect
    )
    found = np.where(safe, PROTECTED, np.uint8(0))
    if parameters.has_window:
        found[~parameters.in_window(batch.xyz)] = PROTECTED
        found[~parameters.in_window(batch.xyz, RIM)] = LEFT_OUT
    found[_left_out(batch, parameters)] = LEFT_OUT
    return found


def is_far(xyz: NDArray[np.float64], configuration: Configuration) -> Mask:
    """Tell which points lie farther from the window than those around it that take part."""
    return ~configuration.input.in_window(xyz, RIM)


def _left_out(batch: PointBatch, parameters: InputParameters) -> Mask:
    """Tell which points are marked as noise or as deleted."""
    out = np.zeros(len(batch.xyz), np.bool_)
    if batch.classification is not None and parameters.leave_out:
        unwanted = np.zeros(256, np.bool_)
        unwanted[list(parameters.leave_out)] = True
        out |= unwanted[batch.classification]
    if batch.withheld is not None and parameters.leave_out_withheld:
        out |= batch.withheld
    return out


def warn_of_left_out(
    count: int, outside: int, parameters: InputParameters, observer: Observer
) -> None:
    """Say how many points are left out, if any are: those outside the window apart."""
    classes = ", ".join(map(str, parameters.leave_out))
    marked = [f"of class {classes}"] if classes else []
    marked += ["withheld"] if parameters.leave_out_withheld else []
    for some, why, key in (
        (outside, f"more than {RIM:g} m outside the window", "input.window"),
        (count - outside, " or ".join(marked), "input.leave_out"),
    ):
        if some:
            points = "1 point is" if some == 1 else f"{some:,} points are"
            observer.warn(
                f"{points} {why}: left out of the decision, labelled unscored, kept in place "
                f"({key})"
            )


def check_parts(
    low: NDArray[np.float64],
    high: NDArray[np.float64],
    configuration: Configuration,
    observer: Observer,
) -> None:
    """Refuse a window in which no point can be; warn of such areas, and of degrees.

    Parameters
    ----------
    low, high : (3,) float64 arrays
        Bounds of the points that take part, metres.

    Raises
    ------
    ConfigurationError
        Where the map does not reach the window.
    """
    parameters = configuration.input
    ends = zip("xyz", low, high, strict=True)
    bounds = ", ".join(f"{axis} from {least:,.2f} to {most:,.2f} m" for axis, least, most in ends)
    if parameters.has_window and not parameters.reaches(low, high):
        near = f"none within {RIM:g} m of it (info tells where the map lies)"
        found = bounds if (low <= high).all() else near
        raise ConfigurationError(
            f"input.window, input.height: expected points in the window, found {found}"
        )
    wide, tall = (high - low)[:2].max(), (high - low)[2]
    if 0 < wide < _NARROW < tall:
        observer.warn(
            f"the map is {tall:,.1f} m tall and {wide:.2g} m wide, as if x and y were degrees: "
            "lengths are metres, so project such a map first"
        )
    areas = configuration.removal.protect
    missed = sum(not area.reaches(low, high) for area in areas)
    if missed and (low <= high).all():
        observer.warn(
            f"{missed} of {len(areas)} areas to protect lie outside the map ({bounds}) and keep "
            "nothing: expected the map's own coordinates in metres, not degrees"
        )


def hidden(batch: PointBatch, unwanted: Mask) -> PointBatch:
    """Return points of which some have coordinates that are not finite."""
    if not unwanted.any():
        return batch
    xyz = batch.xyz.copy()
    xyz[unwanted] = np.nan
    return replace(batch, xyz=xyz)


class Watcher:
    """Learns from a stream of points who takes part, and hides the others from what comes next.

    Points at exactly the origin are hidden as well: whether they are a heap is known in the end.
    `note` is given the first row of a batch and the marks of its points, if any are marked.

    Attributes
    ----------
    left_out, protected, outside : int
        Points that were marked so; of those left out, the ones far from the window.
    """

    def __init__(
        self,
        configuration: Configuration,
        note: Callable[[int, NDArray[np.uint8]], None] | None = None,
    ) -> None:
        self.outskirts = Outskirts(configuration.neighbours.k)
        self.left_out = self.protected = self.outside = 0
        self._configuration = configuration
        self._note = note

    def watch(self, batches: Iterable[PointBatch]) -> Iterator[PointBatch]:
        """Yield points as they pass."""
        for batch in batches:
            seen = valid_points(batch.xyz)
            found = marks(batch, self._configuration)
            found[~seen] = 0
            if found.any():
                out = found == LEFT_OUT
                self.left_out += int(np.count_nonzero(out))
                self.outside += int(np.count_nonzero(seen & is_far(batch.xyz, self._configuration)))
                self.protected += int(np.count_nonzero(found == PROTECTED))
                seen &= ~out
                if self._note is not None:
                    self._note(batch.first_row, found)
            self.outskirts.add(batch.xyz, batch.first_row, seen)
            yield hidden(batch, ~seen | is_at_origin(batch.xyz))


def survey_of_others(survey: Survey, strays: Strays) -> Survey:
    """Return the survey of all who take part, from that of what a `Watcher` let pass."""
    whole = survey
    if strays.at_origin:
        zeros = PointBatch(0, np.zeros((strays.at_origin, 3)), None)
        whole = replace(merge([survey, survey_batches([zeros])]), point_count=survey.point_count)
    if len(strays.rows):
        whole = whole.without(strays.points, strays.low, strays.high)
    return whole


def survey_map(
    batches: Iterable[PointBatch], configuration: Configuration
) -> tuple[Survey, Strays]:
    """Survey all points of a map that take part."""
    watcher = Watcher(configuration)
    passed = survey_batches(watcher.watch(batches))
    strays = watcher.outskirts.strays()
    return survey_of_others(passed, strays), strays
