"""What is compared: something that tells which points of a map to remove."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.scene import Scene

__all__ = ["Family", "Method", "Removal", "Unavailable"]

Removal = Callable[[Scene], NDArray[np.bool_]]
"""Tells of each point of a scene whether to remove it."""


class Family(Enum):
    """What a method needs."""

    OURS = "ours"
    MAP = "map only"
    SCANS = "scans and poses"


class Unavailable(Exception):  # noqa: N818 (no error: a reason that goes into the table)
    """A method cannot be run here; says why."""


@dataclass(frozen=True, slots=True)
class Method:
    """One row of the tables.

    Attributes
    ----------
    name : str
        With the parameters that matter.
    family : Family
    load : callable
        Imports what is needed, compiles what is compiled, and returns the removal: so that only
        the method itself is timed. Raises `Unavailable` where something is missing.
    parameters : str
        Those that the name does not tell.
    """

    name: str
    family: Family
    load: Callable[[], Removal]
    parameters: str = ""
