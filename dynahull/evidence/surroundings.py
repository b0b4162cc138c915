"""What lies around each voxel, at every level of the lattice: read once, for all points in it."""

from dataclasses import dataclass
from typing import Self

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled
from dynahull.evidence.range_images import CLEARLY, MET, THROUGH, VIEWS, Views
from dynahull.evidence.shapes import shapes_of
from dynahull.evidence.summaries import COLUMNS, FINEST, GROUND, LEVELS, SCORED
from dynahull.evidence.summaries import SHAPE as MOMENTS_BEGIN
from dynahull.evidence.visits import scan_counts
from dynahull.evidence.voxels import Cells, Integers, Voxels, find_cell

SHAPED_LEVELS = 3
"""The shape is read over boxes of 0.3, 0.6 and 1.2 m."""

COLUMN_LEVELS = (1, 2)
"""Columns are 0.2 and 0.4 m wide."""

EXTREME_LEVEL = 3
"""The thinnest and the densest are looked for among voxels of 0.8 m."""

_STEPS = 16
_OCCUPIED = COLUMNS
"""Column that counts occupied voxels of the finest level; what scans saw of them, and the marks of
scans, follow."""

Terms = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Level:
    """The voxels of one level, and what lies around each.

    Attributes
    ----------
    cells : (V, 3) int32 array
    table : (T,) int32 array
        Where each cell is found: see `lattice.find_cell`.
    parents : (V,) int32 array
        In which voxel of the next level each lies; of the last level, itself.
    ground : (V,) int64 array
        Ground points in each voxel.
    means : (V, 5) float32 array
        Over the box of 3 x 3 x 3 voxels: mean logarithms of density and thickness, and logarithms
        of returns a finest voxel that is occupied, and of how many more finest voxels, and points,
        are in the box of the next level.
    shape : (V, 4) float32 array or None
    columns : (V, 6) float32 array or None
        Above the voxel: how far it goes on without a gap, the gap after that, and how much is
        occupied; the same below.
    extremes : (V, 2) float32 array or None
        Least mean thickness and largest mean density of the voxels around.
    scans : (V, len(SPANS)) float32 array or None
        Logarithms of how many scans saw the box of 3 x 3 x 3 voxels.
    own_views : (V, 3) float32 array or None
        Logarithms of how many scans saw clearly through the voxel, through it, and met it.
    views : (V, 2) float32 array or None
        Shares of the scans that saw clearly through the box of 3 x 3 x 3 voxels, and through it.
    """

    cells: Cells
    table: npt.NDArray[np.int32]
    parents: npt.NDArray[np.int32]
    ground: Integers
    means: Terms
    shape: Terms | None = None
    columns: Terms | None = None
    extremes: Terms | None = None
    scans: Terms | None = None
    own_views: Terms | None = None
    views: Terms | None = None


@dataclass(frozen=True, slots=True)
class Surroundings:
    """All levels, the finest first."""

    levels: tuple[Level, ...]

    @classmethod
    def of(cls, voxels: Voxels, views: Views | None = None, threads: int = 1) -> Self:
        """Read the sums over the finest voxels, see `summaries`, and what scans saw of these."""
        occupied = voxels.sums[:, SCORED] > 0
        blocks = [voxels.sums[:, :_OCCUPIED], occupied[:, None].astype(np.int64)]
        if views is not None:
            seen = np.zeros((len(voxels), VIEWS), np.int64)
            seen[occupied] = views.count(voxels.cells[occupied], FINEST, threads)
            blocks += [seen]
        blocks += [voxels.sums[:, _OCCUPIED:]]
        here = type(voxels)(voxels.cells, np.concatenate(blocks, axis=1))
        del voxels, blocks  # the sums are most of what a map takes here
        # Points that are scored ask for what lies around them, and no others.
        sums = here.around(here.sums[:, SCORED] > 0)
        levels = []
        for number in range(LEVELS):
            side = FINEST * 2**number
            coarser, parents = here.coarser() if number < LEVELS - 1 else (here, None)
            wanted = coarser.sums[:, SCORED] > 0
            further = coarser.around(wanted) if parents is not None else sums
            at = np.arange(len(here), dtype=np.int32) if parents is None else parents
            levels.append(
                Level(
                    here.cells,
                    here.table,
                    at,
                    here.sums[:, GROUND].copy(),
                    _means(here.sums, sums, further, at),
                    shapes_of(here.cells, sums, SCORED, MOMENTS_BEGIN, side)
                    if number < SHAPED_LEVELS
                    else None,
                    _columns(here.cells) if number in COLUMN_LEVELS else None,
                    _extremes(here.cells, here.sums, here.table)
                    if number == EXTREME_LEVEL
                    else None,
                    scan_counts(sums[:, -here.marks :]) if here.marks else None,
                    None if views is None or number else _own_views(here.sums),
                    None if views is None else _views(sums),
                )
            )
            here, sums = coarser, further
        return cls(tuple(levels))


@compiled
def _means(
    own: Integers, sums: Integers, further: Integers, parents: npt.NDArray[np.int32]
) -> Terms:
    means = np.full((len(sums), 5), np.nan, np.float32)
    for v in range(len(sums)):
        if own[v, 1] == 0:
            continue
        count, occupied = sums[v, 1], sums[v, _OCCUPIED]
        means[v, 0] = sums[v, 2] / (256.0 * count)
        means[v, 1] = sums[v, 3] / (256.0 * count)
        means[v, 2] = np.log2(count / occupied)
        parent = parents[v]
        means[v, 3] = np.log2(further[parent, _OCCUPIED] / occupied)
        means[v, 4] = np.log2(further[parent, 1] / count)
    return means


@compiled
def _columns(cells: Cells) -> Terms:
    columns = np.empty((len(cells), 6), np.float32)
    for v in range(len(cells)):
        for way in range(2):
            step = 1 - 2 * way
            run, gap, count = 0, _STEPS, 0
            other = v + step
            while 0 <= other < len(cells):
                away = step * (cells[other, 2] - cells[v, 2])
                same = cells[other, 0] == cells[v, 0] and cells[other, 1] == cells[v, 1]
                if not same or away > _STEPS:
                    break
                count += 1
                if away == run + 1:
                    run = away
                elif gap == _STEPS:
                    gap = away - run - 1
                other += step
            columns[v, 3 * way] = run
            columns[v, 3 * way + 1] = gap
            columns[v, 3 * way + 2] = count
    return columns


@compiled
def _extremes(cells: Cells, sums: Integers, table: npt.NDArray[np.int32]) -> Terms:
    """Return the extremes of the voxels around that hold enough; a voxel itself always counts."""
    extremes = np.full((len(cells), 2), np.nan, np.float32)
    for v in range(len(cells)):
        if sums[v, 1] == 0:
            continue
        least, most = np.inf, -np.inf
        for di in range(-1, 2):
            for dj in range(-1, 2):
                for dk in range(-1, 2):
                    n = find_cell(
                        cells[v, 0] + di, cells[v, 1] + dj, cells[v, 2] + dk, cells, table
                    )
                    if n >= 0 and (sums[n, 1] >= 10 or n == v):
                        least = min(least, sums[n, 3] / (256.0 * sums[n, 1]))
                        most = max(most, sums[n, 2] / (256.0 * sums[n, 1]))
        extremes[v, 0], extremes[v, 1] = least, most
    return extremes


@compiled
def _views(sums: Integers) -> Terms:
    """Return the shares of the scans that saw clearly through, and through, and not just met it."""
    shares = np.full((len(sums), 2), np.nan, np.float32)
    for v in range(len(sums)):
        met = sums[v, _OCCUPIED + 1 + MET]
        clearly, through = sums[v, _OCCUPIED + 1 + CLEARLY], sums[v, _OCCUPIED + 1 + THROUGH]
        if met + clearly > 0:
            shares[v, 0] = clearly / (met + clearly)
        if met + through > 0:
            shares[v, 1] = through / (met + through)
    return shares


@compiled
def _own_views(sums: Integers) -> Terms:
    """Return logarithms of how many scans saw clearly through, through, and met it."""
    counts = np.empty((len(sums), 3), np.float32)
    for v in range(len(sums)):
        counts[v, 0] = np.log2(1.0 + sums[v, _OCCUPIED + 1 + CLEARLY])
        counts[v, 1] = np.log2(1.0 + sums[v, _OCCUPIED + 1 + THROUGH])
        counts[v, 2] = np.log2(1.0 + sums[v, _OCCUPIED + 1 + MET])
    return counts
