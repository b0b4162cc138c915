"""The terms: numbers that say of each point what its neighbours, surroundings and floor say."""

import numpy as np
import numpy.typing as npt

from dynahull.compilation import compiled, inlined
from dynahull.evidence.summaries import FINEST, LEVELS, THINNEST, ScoredPoints
from dynahull.evidence.surroundings import Surroundings, Terms
from dynahull.evidence.visits import SPANS
from dynahull.evidence.voxels import Cells, Floats, Integers, cells_of, find_cell

FLOOR_TERMS = ("height", "aloft", "over", "under", "ground_seen", "ground_near")
"""Height above the floor, up to the reach of people, and above that reach; voxels of 0.4 m that are
occupied above it, in nine columns, and below it, in the point's own; ground points beneath against
those around; ground points in an area of the neighbourhood's own size."""

PEOPLE = np.float32(2.0)
"""Metres: what is higher is seldom part of a person."""


def floor_terms(
    xyz: Floats, height: Floats, scale: npt.NDArray[np.float32], surroundings: Surroundings
) -> npt.NDArray[np.float32]:
    """Return what the floor says of each point, (n, len(FLOOR_TERMS)); NaN where none is near.

    Parameters
    ----------
    xyz : (n, 3) float64 array
    height : (n,) float64 array
    scale : (n,) float32 array
        Logarithm to base 2 of the length of each neighbourhood, metres.
    """
    small, middle, large = (
        (level.cells, level.ground, level.table) for level in surroundings.levels[1:4]
    )
    terms = np.full((len(xyz), len(FLOOR_TERMS)), np.nan, np.float32)
    _floor_terms(xyz, height, scale, small, middle, large, terms)
    return terms


_Lookup = tuple[Cells, Integers, npt.NDArray[np.int32]]
_Cell = tuple[int, int, int]
_NOWHERE = (2**62, 2**62, 2**62)


@compiled
def _floor_terms(
    xyz: Floats,
    height: Floats,
    scale: npt.NDArray[np.float32],
    small: _Lookup,
    middle: _Lookup,
    large: _Lookup,
    terms: npt.NDArray[np.float32],
) -> None:
    # Points come in the order of their voxels: what was looked up for one often serves the next.
    in_small = in_middle = in_large = _NOWHERE
    over = under = beneath = about = 0
    for p in range(len(xyz)):
        if np.isnan(height[p]):
            continue
        x, y, floor = xyz[p, 0], xyz[p, 1], xyz[p, 2] - height[p]
        cell = (_cell(x, 0.4), _cell(y, 0.4), _cell(floor + 0.2, 0.4))
        if cell != in_middle:
            in_middle, (over, under) = cell, _occupied_above(cell, middle)
        cell = (_cell(x, 0.2), _cell(y, 0.2), _cell(floor, 0.2))
        if cell != in_small:
            in_small, beneath = cell, _ground_about(cell, small)
        cell = (_cell(x, 0.8), _cell(y, 0.8), _cell(floor, 0.8))
        if cell != in_large:
            in_large, about = cell, _ground_about(cell, large)
        above_floor = np.float32(height[p])
        terms[p, 0] = min(above_floor, PEOPLE)
        terms[p, 1] = max(above_floor - PEOPLE, np.float32(0.0))
        terms[p, 2] = over
        terms[p, 3] = under
        terms[p, 4] = np.log2((beneath + 0.5) / (about / 16.0 + 0.5))
        terms[p, 5] = np.log2(about / 5.76 + 0.1) + 2.0 * scale[p]


@inlined
def _cell(place: float, side: float) -> int:
    return int(np.floor(place / side))


@inlined
def _occupied_above(cell: _Cell, lookup: _Lookup) -> tuple[int, int]:
    """Count voxels above the reach of people, in nine columns, and below it, in one."""
    i, j, k = cell
    over = under = 0
    for di in range(-1, 2):
        for dj in range(-1, 2):
            for dk in range(6, 9):
                if find_cell(i + di, j + dj, k + dk, lookup[0], lookup[2]) >= 0:
                    over += 1
    for dk in range(1, 6):
        if find_cell(i, j, k + dk, lookup[0], lookup[2]) >= 0:
            under += 1
    return over, under


@inlined
def _ground_about(cell: _Cell, lookup: _Lookup) -> int:
    """Count the ground points in 3 x 3 x 3 voxels."""
    i, j, k = cell
    count = np.int64(0)
    for di in range(-1, 2):
        for dj in range(-1, 2):
            for dk in range(-1, 2):
                n = find_cell(i + di, j + dj, k + dk, lookup[0], lookup[2])
                if n >= 0:
                    count += lookup[1][n]
    return int(count)


NEIGHBOURHOOD_TERMS = (
    "fill", "thickness", "flatness", "linearity", "upright", "offset", "scale", "thick",
)  # fmt: skip
"""Volume of the hull against the cube of the length; thickness against length, and against width;
width against length; |z| of the normal; distance to the mean of the neighbours against length;
length and thickness in metres. Lengths and ratios are logarithms to base 2."""

BOXES = tuple(f"{3 * FINEST * 2**level:.1f}" for level in range(LEVELS))
"""Sides of the boxes that surroundings are read over, metres."""


def _level_names() -> tuple[str, ...]:
    names = []
    for number, box in enumerate(BOXES):
        if number:
            names += [f"density_{box}", f"thickness_{box}"]
        names += [f"returns_{box}"]
        if number < LEVELS - 1:
            names += [f"spread_{box}", f"growth_{box}"]
        if number < 3:
            names += [
                f"{name}_{box}" for name in ("box_thin", "box_flat", "box_linear", "box_normal")
            ]
        if number in (1, 2):
            for way in ("up", "down"):
                names += [f"{name}_{way}_{box}" for name in ("run", "gap", "filled")]
        if number == 3:
            names += ["thickness_least", "density_most"]
    return tuple(names)


TERMS = (*NEIGHBOURHOOD_TERMS, *FLOOR_TERMS, *_level_names())
"""All terms, in the order of their columns."""

SCAN_TERMS = tuple(f"scans_{span}_{box}" for box in BOXES for span in SPANS)
"""Logarithms of how many scans saw the smallest box, by so many scans on end; and, for the larger
boxes, of how many more saw them."""

SEEN_TERMS = (
    *(f"{name}_{FINEST}" for name in ("clearly", "through", "met")),
    *(f"{name}_{box}" for box in BOXES for name in ("clear_share", "through_share")),
)
"""Logarithms of how many scans saw clearly through the voxel of a point, through it, and met it;
shares of the scans that saw through boxes."""

TIMED_TERMS = (*TERMS, *SCAN_TERMS, *SEEN_TERMS)
"""All terms of a map whose scans are known."""

_OWN_SCANS = len(SPANS)

RISING = (
    "thickness",
    "flatness",
    *(name for name in TERMS if name.startswith("box_flat")),
    *SCAN_TERMS[_OWN_SCANS:],
    *(name for name in SEEN_TERMS if not name.startswith("met")),
)
"""Terms that never speak against a ghost as they grow: what is less flat, seen less than what is
around, or seen through."""

FALLING = (
    "aloft",
    *(name for name in TERMS if name.startswith("density_")),
    *SCAN_TERMS[:_OWN_SCANS],
)
"""Terms that never speak for a ghost as they grow: what is denser, higher above people, or seen by
more scans."""


def evidence(points: ScoredPoints, k: int, surroundings: Surroundings) -> Terms:
    """Return the terms of each point.

    Parameters
    ----------
    k : int
        Neighbours of each.
    surroundings : Surroundings
        Of all points within `summaries.REACH`.

    Returns
    -------
    (n, len(TERMS)) or (n, len(TIMED_TERMS)) float32 array
        NaN where there is nothing to tell.
    """
    log_density, log_thickness = points.log_density(), points.log_thickness()
    own = _neighbourhood_terms(points.spread, log_density, k)
    blocks = [own, floor_terms(points.xyz, points.height, own[:, 6], surroundings)]
    finest = surroundings.levels[0]
    at = places_of(cells_of(points.xyz, FINEST), finest.cells, finest.table)
    scans: list[Terms] = []
    views: list[Terms] = []
    for number, level in enumerate(surroundings.levels):
        means = level.means.take(at, axis=0)
        if number:
            blocks += [(log_density - means[:, 0])[:, None], (log_thickness - means[:, 1])[:, None]]
        blocks += [means[:, 2 : 5 if number < LEVELS - 1 else 3]]
        for more in (level.shape, level.columns):
            if more is not None:
                blocks += [more.take(at, axis=0)]
        if level.extremes is not None:
            extremes = level.extremes.take(at, axis=0)
            blocks += [np.column_stack([log_thickness, log_density]) - extremes]
        if level.scans is not None:
            seen = level.scans.take(at, axis=0)
            scans += [seen - scans[0] if scans else seen]
        for more in (level.own_views, level.views):
            if more is not None:
                views += [more.take(at, axis=0)]
        at = level.parents.take(at)
    return np.concatenate([*blocks, *scans, *views], axis=1, dtype=np.float32)


@compiled
def places_of(wanted: Cells, cells: Cells, table: npt.NDArray[np.int32]) -> npt.NDArray[np.int32]:
    """Return which voxel each cell is, (n,); all are occupied."""
    places = np.empty(len(wanted), np.int32)
    for n in range(len(wanted)):
        places[n] = find_cell(wanted[n, 0], wanted[n, 1], wanted[n, 2], cells, table)
    return places


@compiled
def _neighbourhood_terms(
    spread: npt.NDArray[np.float32], log_density: npt.NDArray[np.float64], k: int
) -> npt.NDArray[np.float32]:
    terms = np.empty((len(spread), 8), np.float32)
    for i in range(len(spread)):
        thick = max(spread[i, 0], THINNEST)
        wide = max(spread[i, 1], thick)
        long = max(spread[i, 2], wide)
        size = np.log2(long)
        terms[i, 0] = np.log2(k) - log_density[i] - 3.0 * size
        terms[i, 1] = np.log2(thick) - size
        terms[i, 2] = np.log2(thick / wide)
        terms[i, 3] = np.log2(wide / long)
        terms[i, 4] = spread[i, 3]
        terms[i, 5] = spread[i, 4] / long
        terms[i, 6] = size
        terms[i, 7] = np.log2(thick)
    return terms
