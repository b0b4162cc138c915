"""Whether two maps are of the same place at all."""

import numpy as np

from pipeline.evaluation.tiled_cloud import TiledCloud


def distance_apart(first: TiledCloud, second: TiledCloud) -> float:
    """Return the distance between the boxes of two clouds, metres; 0 where they meet."""
    (low, high), (other_low, other_high) = first.box(), second.box()
    gaps = np.maximum(np.maximum(low - other_high, other_low - high), 0.0)
    return float(np.linalg.norm(gaps))
