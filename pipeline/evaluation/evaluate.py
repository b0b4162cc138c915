"""The evaluation of a cleaned map: what is static, how far the map is from it, who is to blame.

Memory: one k-d tree of one map at a time, 48 bytes a point with its coordinates; 8 bytes for each
point of the cleaned map (its distance, for the percentile), thrice that while they are summed up
without a tree; some bytes for each of the original (labels, decisions); the voxels, up to 170
bytes each while they are gathered, without a tree; and batches of fixed size. A map is read once
for each tree that is built of it or looked up in.
"""

from dataclasses import dataclass

import numpy as np

from dynahull.progress import Observer
from pipeline.errors import EvaluationError
from pipeline.evaluation.cloud import Cloud
from pipeline.evaluation.earth_mover import transport_library
from pipeline.evaluation.geometry import Geometry, compare_geometry
from pipeline.evaluation.inputs import EvaluationInputs
from pipeline.evaluation.labels import Labels, Truth
from pipeline.evaluation.options import EvaluationOptions
from pipeline.evaluation.scoring import Scores, label_by_map, label_cleaned, score


@dataclass(frozen=True, slots=True)
class Figures:
    """All figures; `scores` is None where there is no original map."""

    geometry: Geometry
    scores: Scores | None


def evaluate(inputs: EvaluationInputs, options: EvaluationOptions, observer: Observer) -> Figures:
    """Compare a cleaned map with the truth.

    Parameters
    ----------
    inputs : EvaluationInputs
    options : EvaluationOptions
    observer : Observer
        Told of stages, progress and warnings.

    Returns
    -------
    Figures

    Raises
    ------
    EvaluationError
        When a map, or what of it can be compared, has no finite point.
    MissingPackageError
        When an Earth Mover's Distance is asked for without POT.
    TilingError
        When a map cannot be read.
    """
    if options.emd_points:
        transport_library()  # before the work, not after it
    cleaned = Cloud(inputs.cleaned, inputs.kept)
    if inputs.original is None:
        assert inputs.truth is not None
        return Figures(compare_geometry(cleaned, Cloud(inputs.truth), options, observer), None)

    original = Cloud(inputs.original)
    if inputs.truth is not None:
        truth = Cloud(inputs.truth)
        labels = label_by_map(original, truth, options, observer)
    else:
        assert inputs.labels is not None
        labels = _known(inputs.labels, original)
        truth = original.choose(labels == Truth.STATIC)
    _check(labels, original, observer)
    # Where nobody knows what is true, nothing is compared.
    cleaned_labels = label_cleaned(cleaned, original, labels, options, observer)
    known = cleaned_labels != Truth.UNKNOWN
    cleaned, cleaned_labels = cleaned.choose(known), cleaned_labels[known]
    geometry = compare_geometry(cleaned, truth, options, observer)
    scores = score(cleaned, cleaned_labels, original, labels, inputs.removed, options, observer)
    return Figures(geometry, scores)


def _check(labels: Labels, original: Cloud, observer: Observer) -> None:
    """Refuse labels without a static point, and warn of labels without one that moved."""
    if not (labels == Truth.STATIC).any():
        raise EvaluationError(
            f"{original.name}: expected points that are static in truth, found none "
            "(--dynamic, --unlabelled and --truth-tolerance say which are)"
        )
    if not (labels == Truth.DYNAMIC).any():
        observer.warn(f"{original.name}: no point moved in truth: recall, DA and RR are undefined")


def _known(labels: Labels, original: Cloud) -> Labels:
    """Call the truth of points without finite coordinates unknown."""
    known = np.full_like(labels, Truth.UNKNOWN)
    for rows, _ in original.batches():
        known[rows] = labels[rows]
    return known
