"""DynaHull on arrays in memory: removes the ghosts of moving things from a finished LiDAR map.

After Habibiroudkenar, Ojala and Tammi, "DynaHull: Density-centric Dynamic Point Filtering in
Point Clouds" (arXiv 2401.07541). One module a step of the paper; `dynahull.algorithm.clean` puts
them together. This package knows nothing of files, nor of tiles, nor of Dask.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dynahull.algorithm import clean
    from dynahull.errors import DynaHullError, InvalidParametersError, InvalidPointsError
    from dynahull.estimator import DynaHull
    from dynahull.labels import Label
    from dynahull.parameters import MethodParameters
    from dynahull.result import CleaningResult, ClusterSummary

__all__ = [
    "CleaningResult",
    "ClusterSummary",
    "DynaHull",
    "DynaHullError",
    "InvalidParametersError",
    "InvalidPointsError",
    "Label",
    "MethodParameters",
    "clean",
]

# Imported on first use: the command line asks for its help text without waiting for SciPy.
_HOMES = {
    "CleaningResult": "result",
    "ClusterSummary": "result",
    "DynaHull": "estimator",
    "DynaHullError": "errors",
    "InvalidParametersError": "errors",
    "InvalidPointsError": "errors",
    "Label": "labels",
    "MethodParameters": "parameters",
    "clean": "algorithm",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'dynahull' has no attribute {name!r}")
    return getattr(import_module(f"dynahull.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
