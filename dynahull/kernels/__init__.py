"""Steps 3 and 4, compiled: exact neighbours and exact hulls, fused, at microseconds a point.

Their oracles are the plain versions in `dynahull.reference`.
"""

from dynahull.kernels.closest import NO_RANK
from dynahull.kernels.density import (
    HullDensities,
    hull_densities,
    nearest_rows,
    squared_reaches,
)
from dynahull.kernels.nearest_points import NearestSearch

__all__ = [
    "NO_RANK",
    "HullDensities",
    "NearestSearch",
    "hull_densities",
    "nearest_rows",
    "squared_reaches",
]
