"""The tiles of a plan, drawn over the map seen from above."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.plan.plan import Plan
from pipeline.showing import drawing_library
from tiling.atomic import atomic_file
from tiling.occupancy import Occupancy
from tiling.survey import Survey


def draw_plan(plan: Plan, survey: Survey, path: Path) -> None:
    """Draw the tiles over the map's occupancy, seen from above, into a PNG.

    Raises
    ------
    MissingPackageError
        When Matplotlib, of the extra `plot`, is not installed.
    """
    mpl = drawing_library()
    figure = mpl.figure.Figure(figsize=(9, 9), layout="constrained")
    axes = figure.add_subplot()
    occupancy = survey.occupancy
    corners = occupancy.columns * occupancy.cell
    if len(corners):
        image, extent = _occupancy_image(occupancy)
        axes.imshow(image, extent=extent, origin="lower", cmap="Greys", interpolation="nearest")
    for tile in plan.layout:
        low, size = tile.low, tile.high - tile.low
        axes.add_patch(
            mpl.patches.Rectangle(
                (low[0], low[1]), size[0], size[1], fill=False, edgecolor="tab:blue"
            )
        )
    if len(plan.layout):
        largest = int(np.argmax(plan.layout.counts))
        low = plan.layout.low[largest] - plan.halo
        size = plan.layout.high[largest] + plan.halo - low
        axes.add_patch(
            mpl.patches.Rectangle(
                (low[0], low[1]), size[0], size[1], fill=False, edgecolor="tab:red", linestyle="--"
            )
        )
        axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.set_title(
        f"{plan.point_count:,} points, {len(plan.layout):,} tiles (blue); "
        f"halo {plan.halo:.2f} m around the largest (red)"
    )
    with atomic_file(path) as temporary:
        figure.savefig(temporary, dpi=120, format="png")


def _occupancy_image(
    occupancy: Occupancy,
) -> tuple[NDArray[np.float64], Sequence[float]]:
    """Return logarithms of counts as a raster of at most some thousand pixels a side."""
    low, high = occupancy.columns.min(axis=0), occupancy.columns.max(axis=0) + 1
    step = max(1, int(np.ceil((high - low).max() / 1_000)))
    at = (occupancy.columns - low) // step
    width, height = (-(-(high - low) // step)).tolist()
    image = np.zeros((height, width))
    np.add.at(image, (at[:, 1], at[:, 0]), occupancy.counts)
    low_x, low_y = (low * occupancy.cell).tolist()
    side = step * occupancy.cell
    return np.log1p(image), (low_x, low_x + width * side, low_y, low_y + height * side)
