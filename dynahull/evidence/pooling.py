"""What the points around a point were given by the first round: a ghost is hardly ever alone."""

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled
from dynahull.evidence.lattice import Cells, Floats, Integers, Voxels, cells_of, find_cell
from dynahull.evidence.summaries import FINEST, LEVELS
from dynahull.evidence.surroundings import Terms
from dynahull.evidence.terms import BOXES, places_of

POOLED_TERMS = (
    *(f"pooled_{box}" for box in BOXES),
    *(f"likely_{box}" for box in BOXES),
    "pooled_column",
)
"""Mean logarithm of the odds, and share of points more likely to have moved than not, over each
box; the mean over 2 m up and down in a column 0.4 m wide."""

_COLUMN_LEVEL, _COLUMN_STEPS = 2, 5


def pooled_terms(xyz: Floats, odds: Voxels) -> Terms:
    """Return what was made of the points around each point, (n, len(POOLED_TERMS)).

    Parameters
    ----------
    xyz : (n, 3) float64 array
    odds : Voxels
        Of all points within `summaries.REACH`: see `summaries.summarise_odds`.
    """
    cells = cells_of(xyz, FINEST)
    terms = np.empty((len(xyz), len(POOLED_TERMS)), np.float32)
    level = odds
    for number in range(LEVELS):
        at = places_of(cells >> number, level.cells, level.table)
        sums = level.around()
        terms[:, number] = _mean_odds(sums).take(at)
        terms[:, LEVELS + number] = (sums[:, 1] / sums[:, 0]).take(at)
        if number == _COLUMN_LEVEL:
            terms[:, 2 * LEVELS] = _mean_odds(
                _column_sums(level.cells, level.sums, level.table)
            ).take(at)
        level, _ = level.coarser()
    return terms


def _mean_odds(sums: Integers) -> npt.NDArray[np.float64]:
    return np.asarray(sums[:, 2] / (256.0 * sums[:, 0]))


@compiled
def _column_sums(cells: Cells, sums: Integers, table: npt.NDArray[np.int32]) -> Integers:
    found = np.zeros((len(cells), 3), np.int64)
    for v in range(len(cells)):
        for dk in range(-_COLUMN_STEPS, _COLUMN_STEPS + 1):
            n = find_cell(cells[v, 0], cells[v, 1], cells[v, 2] + dk, cells, table)
            if n >= 0:
                for column in range(3):
                    found[v, column] += sums[n, column]
    return found
