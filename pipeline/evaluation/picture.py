"""A map from above, every decision in the colour of the DynaHull paper.

Points are counted in pixels, tile by tile: memory does not grow with the map.
"""

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynahull.observer import Observer
from pipeline.errors import EvaluationError
from pipeline.evaluation.tiled_cloud import TiledCloud
from pipeline.evaluation.truth import Truth
from pipeline.showing import drawing_library, named_file

MOST_PIXELS, LEAST_PIXELS = 1200, 300
"""On the picture's longer side: many for many points; few points would be lost among them."""

COLOURS = {
    "true negative: static, kept": (0.84, 0.84, 0.84),
    "true positive: moved, removed": (0.10, 0.65, 0.25),
    "false positive: static, removed": (0.15, 0.35, 0.95),
    "false negative: moved, kept": (0.90, 0.10, 0.10),
}
"""In the order of `decision_counts`."""

_BACKGROUND = (1.0, 1.0, 1.0)


def decision_counts(
    scored: TiledCloud, pixels: int
) -> tuple[NDArray[np.int64], tuple[float, float, float, float]]:
    """Count the points of each decision in each pixel of the original map, seen from above.

    It has labels, and knows what was removed. Its longer side is so many pixels long.

    Returns
    -------
    counts : (4, height, width) int64 array
        True negatives, true positives, false positives, false negatives; row 0 has the least y.
    extent : tuple of float
        Left, right, bottom and top edge, in the map's units.
    """
    known = scored.choose(Truth.STATIC, Truth.DYNAMIC)
    if not len(known):
        raise EvaluationError(f"{known.name}: expected labelled points to draw, found none")
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for tile in known.tiles():
        xy = known.xyz(tile)[:, :2]
        low, high = np.minimum(low, xy.min(axis=0)), np.maximum(high, xy.max(axis=0))
    size = max(float((high - low).max()), 1e-9) / pixels
    width, height = (int(side) for side in np.floor((high - low) / size).astype(np.int64) + 1)
    counts = np.zeros(4 * height * width, dtype=np.int64)
    for tile in known.tiles():
        column, line = np.floor((known.xyz(tile)[:, :2] - low) / size).astype(np.int64).T
        moved, removed = known.labels(tile) == Truth.DYNAMIC, known.removed(tile)
        decision = np.select([moved & removed, removed, moved], [1, 2, 3], 0)
        flat = (decision * height + line) * width + column
        counts += np.bincount(flat, minlength=counts.size)
    left, bottom = low.tolist()
    extent = (left, left + width * size, bottom, bottom + height * size)
    return counts.reshape(4, height, width), extent


def colour_pixels(counts: NDArray[np.int64]) -> NDArray[np.float64]:
    """Choose each pixel's red, green and blue, (height, width, 3), by what `decision_counts` gives.

    A pixel of static points shows whether more of them were kept or removed, so that a wall is
    blue where it is lost and not where a point of it is. Points that moved are drawn over them,
    again as most of them were decided. Of two equally common, the wrong decision shows.
    """
    kept, right, wrong, missed = counts
    image = np.full((*kept.shape, 3), _BACKGROUND)
    grey, green, blue, red = COLOURS.values()
    image[kept > wrong] = grey
    image[(wrong >= kept) & (wrong > 0)] = blue
    image[right > missed] = green
    image[(missed >= right) & (missed > 0)] = red
    return image


def draw_picture(scored: TiledCloud, path: Path, observer: Observer) -> None:
    """Draw the map of `decision_counts` from above into a PNG file, replaced when it is complete.

    Raises
    ------
    EvaluationError
        When no point is labelled.
    MissingPackageError
        When Matplotlib is not installed.
    OutputError
        When the file cannot be written.
    """
    mpl = drawing_library()
    known = len(scored.choose(Truth.STATIC, Truth.DYNAMIC))
    observer.stage("picture", known)
    pixels = min(max(math.isqrt(known), LEAST_PIXELS), MOST_PIXELS)
    counts, (left, right, bottom, top) = decision_counts(scored, pixels)
    sides = np.array([right - left, top - bottom])
    figure = mpl.figure.Figure(figsize=2 + 12 * sides / sides.max(), layout="constrained")
    axes = figure.add_subplot()
    extent, image = (left, right, bottom, top), colour_pixels(counts)
    axes.imshow(image, origin="lower", extent=extent, interpolation="nearest", aspect=1)
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.ticklabel_format(useOffset=False, style="plain")
    totals = counts.sum(axis=(1, 2))
    handles = [
        mpl.patches.Patch(color=colour, label=f"{name} ({total:,})")
        for (name, colour), total in zip(COLOURS.items(), totals.tolist(), strict=True)
    ]
    figure.legend(handles=handles, loc="outside upper center", ncols=2, frameon=False)
    with named_file(path) as temporary:
        figure.savefig(temporary, format="png", dpi=MOST_PIXELS / 12)
