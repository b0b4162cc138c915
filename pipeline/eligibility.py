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
from dynahull.progress import Observer
from dynahull.strays import Outskirts, Strays, is_at_origin
from pipeline.configuration.run import Configuration, InputParameters
from tiling.collection import MapCollection
from tiling.formats.points import PointBatch
from tiling.survey import Survey, merge, survey_batches

Mask = NDArray[np.bool_]


def may_leave_out(collection: MapCollection, parameters: InputParameters) -> bool:
    """Tell whether a map can have points that are left out."""
    asked_for = bool(parameters.leave_out) or parameters.leave_out_withheld
    return asked_for and any(reader.description.has_classification for reader in collection.readers)


def left_out(batch: PointBatch, parameters: InputParameters) -> Mask:
    """Tell which points are marked as noise or as deleted."""
    out = np.zeros(len(batch.xyz), np.bool_)
    if batch.classification is not None and parameters.leave_out:
        unwanted = np.zeros(256, np.bool_)
        unwanted[list(parameters.leave_out)] = True
        out |= unwanted[batch.classification]
    if batch.withheld is not None and parameters.leave_out_withheld:
        out |= batch.withheld
    return out


def warn_of_left_out(count: int, parameters: InputParameters, observer: Observer) -> None:
    """Say how many points are left out, if any are."""
    if count:
        classes = ", ".join(map(str, parameters.leave_out))
        marks = [f"of class {classes}"] if classes else []
        marks += ["withheld"] if parameters.leave_out_withheld else []
        points = "1 point is" if count == 1 else f"{count:,} points are"
        observer.warn(
            f"{points} {' or '.join(marks)}: left out of the decision, labelled unscored, kept in "
            "place (input.leave_out)"
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

    Parameters
    ----------
    configuration : Configuration
    note : callable, optional
        Given the first row of a batch, and which of its points are left out, if any are.

    Attributes
    ----------
    outskirts : Outskirts
    left_out : int
        Points left out so far.
    """

    def __init__(
        self, configuration: Configuration, note: Callable[[int, Mask], None] | None = None
    ) -> None:
        self.outskirts = Outskirts(configuration.neighbours.k)
        self.left_out = 0
        self._parameters = configuration.input
        self._note = note

    def watch(self, batches: Iterable[PointBatch]) -> Iterator[PointBatch]:
        """Yield points as they pass."""
        for batch in batches:
            seen = valid_points(batch.xyz)
            out = left_out(batch, self._parameters) & seen
            if out.any():
                self.left_out += int(np.count_nonzero(out))
                seen &= ~out
                if self._note is not None:
                    self._note(batch.first_row, out)
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
