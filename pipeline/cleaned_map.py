"""What a run made of a map, whichever way it was cleaned."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from dynahull.result import ClusterSummary
from pipeline.decision import Decision
from pipeline.report_page.charts import TileWork
from pipeline.report_page.page import Views


@dataclass(frozen=True, slots=True)
class CleanedMap:
    """What became of every point, in memory or in files that look like it.

    Attributes
    ----------
    labels : (N,) uint8 array
    cluster : (N,) int32 array or None
    density : (N,) float64 array or None
    score : (N,) float32 array or None
        None where nobody asked for them.
    counts : dict of str to int
        Points of each label.
    clusters : tuple of ClusterSummary
    decision : Decision or None
        None where the evidence was not asked.
    views : callable or None
        Gives what the report shows; None where none is wanted.
    tiles : TileWork or None
        What they took; None where no report is wanted, or the map is one tile.
    """

    labels: NDArray[np.uint8]
    cluster: NDArray[np.int32] | None
    density: NDArray[np.float64] | None
    score: NDArray[np.float32] | None
    counts: dict[str, int]
    clusters: tuple[ClusterSummary, ...]
    decision: Decision | None
    views: Callable[[], Views] | None = None
    tiles: TileWork | None = None
