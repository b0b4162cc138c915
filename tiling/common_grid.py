"""Grids of integer coordinates, as LAS has them: coordinate = integer * scale + offset."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from tiling.collection import MapCollection
from tiling.errors import GridError
from tiling.grid import Grid
from tiling.survey import Survey

_SCALES = (1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 2.0**-4, 2.0**-8, 2.0**-12, 2.0**-16, 2.0**-20)
"""Tried where the map has no grid of its own: decimals, and fractions of voxel grids."""


def grid_of(collection: MapCollection, survey: Survey) -> Grid:
    """Find a grid that gives every finite coordinate of a map back.

    It is the map's own if it is LAS on one grid; any other map is read until no grid is left.

    Parameters
    ----------
    collection : MapCollection
        The map.
    survey : Survey
        Of the whole map.

    Returns
    -------
    Grid

    Raises
    ------
    GridError
        When there is none.
    """
    own = list(dict.fromkeys(reader.description.grid for reader in collection.readers))
    if collection.metres is not None or collection.is_moved:
        own = [None]  # what was multiplied or turned is on it no more
    if len(own) == 1 and own[0] is not None:
        return own[0]
    candidates = [*(grid for grid in own if grid is not None), *_grids_within(survey)]
    lost = survey.maximum
    for _, batch in collection.batches():
        xyz = batch.xyz[np.isfinite(batch.xyz).all(axis=1)]
        for grid in list(candidates):
            off = np.flatnonzero(~grid.holds(xyz))
            if len(off):
                candidates.remove(grid)
                lost = xyz[off[0]]
        if not candidates:
            raise GridError(collection.name, lost)
    return candidates[0]


def _grids_within(survey: Survey) -> Iterator[Grid]:
    """Yield the grids whose integers of 32 bits reach over the map."""
    if not survey.finite_count:
        yield Grid((_SCALES[1],) * 3, (0.0,) * 3)
        return
    ends = np.array([survey.minimum, survey.maximum])
    middle = np.floor(ends[0] / 2 + ends[1] / 2)
    for scale in _SCALES:
        for offset in (np.zeros(3), middle):
            grid = Grid((scale,) * 3, _triple(offset))
            if grid.reaches(ends):
                yield grid
                break


def _triple(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z
