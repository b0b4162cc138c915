"""What a removal is worth: the figures of `pipeline.evaluation`, over the labelled points."""

from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.scene import Scene
from dynahull.observer import SilentObserver
from pipeline.evaluation.evaluation import Figures, evaluate
from pipeline.evaluation.inputs import EvaluationInputs, EvaluationOptions
from pipeline.evaluation.truth import RowValues, Truth
from tiling.collection import MapCollection

__all__ = ["evaluation_options", "measure"]


def evaluation_options(emd_points: int) -> EvaluationOptions:
    """Return the defaults of `evaluate`, without an Earth Mover's Distance where POT is missing."""
    return EvaluationOptions(emd_points=emd_points if find_spec("ot") else 0)


def measure(
    scene: Scene, removed: NDArray[np.bool_], options: EvaluationOptions, folder: Path
) -> Figures:
    """Evaluate what is left of a map.

    Points of unknown truth are compared with nothing by `evaluate`, so they are left out at once.

    Parameters
    ----------
    scene : Scene
    removed : (N,) bool array
    options : EvaluationOptions
    folder : Path
        For the two maps.

    Returns
    -------
    Figures

    Raises
    ------
    EvaluationError
        When nothing is left.
    """
    known = scene.labels != Truth.UNKNOWN
    points, labels, removed = scene.xyz[known], scene.labels[known], removed[known]
    original, cleaned = folder / "original.npy", folder / "cleaned.npy"
    np.save(original, points)
    np.save(cleaned, points[~removed])
    inputs = EvaluationInputs(
        cleaned=MapCollection([cleaned]),
        truth=None,
        original=MapCollection([original]),
        labels=RowValues.of(labels),
        removed=RowValues.of(removed),
    )
    return evaluate(inputs, options, SilentObserver())
