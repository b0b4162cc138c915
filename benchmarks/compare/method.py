"""What is compared: something that tells which points of a map to remove."""

from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.scene import Scene

__all__ = ["Family", "Method", "Removal", "Unavailable", "versions_of"]

Removal = Callable[[Scene], NDArray[np.bool_]]
"""Tells of each point of a scene whether to remove it."""


class Family(Enum):
    """What a method needs."""

    OURS = "ours"
    BASELINE = "a baseline"
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
    version : callable
        Tells the versions of what does the work; another one may give other figures.
    """

    name: str
    family: Family
    load: Callable[[], Removal]
    parameters: str = ""
    version: Callable[[], str] = str


def versions_of(*packages: str) -> Callable[[], str]:
    """Return what tells the versions of those of some packages that are installed."""

    def tell() -> str:
        return ", ".join(f"{name} {found}" for name in packages if (found := _installed(name)))

    return tell


def _installed(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None
