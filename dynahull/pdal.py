"""Functions for PDAL's `filters.python`: `"source": "from dynahull.pdal import remove_ghosts"`."""

from collections.abc import Mapping, MutableMapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dynahull.algorithm import clean
from dynahull.labels import Label
from dynahull.result import CleaningResult

_NOISE = 7
"""The ASPRS class that other stages leave out."""

Dimensions = Mapping[str, NDArray[Any]]


def remove_ghosts(ins: Dimensions, outs: MutableMapping[str, NDArray[Any]]) -> bool:
    """Leave the ghosts out of the stream, by `auto`; True, as PDAL asks for.

    Parameters
    ----------
    ins : mapping of str to (n,) array
        The dimensions of the points; X, Y and Z in metres.
    outs : mapping
        Given the dimension `Mask`.
    """
    outs["Mask"] = _cleaned(ins).kept
    return True


def mark_ghosts(ins: Dimensions, outs: MutableMapping[str, NDArray[Any]]) -> bool:
    """Give the ghosts class 7, noise; see `remove_ghosts`."""
    classes = np.array(ins["Classification"])
    classes[_cleaned(ins).labels == Label.DYNAMIC] = _NOISE
    outs["Classification"] = classes
    return True


def _cleaned(ins: Dimensions) -> CleaningResult:
    xyz = np.column_stack([ins[axis] for axis in "XYZ"])
    classes = ins.get("Classification")
    noise = None if classes is None else np.isin(classes, (_NOISE, 18))
    return clean(xyz, "auto", left_out=noise)
