"""Ground by cloth simulation (Zhang et al. 2016), from the package cloth-simulation-filter."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

from dynahull.errors import InvalidPointsError, MissingDependencyError
from dynahull.extras import install_command
from dynahull.ground.lattice import Booleans, Floats
from dynahull.ground.parameters import ClothParameters

_MOST_PARTICLES = 5e7
"""Of the cloth; each takes some hundred bytes."""


def cloth_library() -> Any:
    """Import the package.

    Raises
    ------
    MissingDependencyError
        If it is not installed.
    """
    try:
        import CSF  # noqa: PLC0415 (optional)
    except ImportError as error:
        raise MissingDependencyError(
            "ground.method: csf needs the package cloth-simulation-filter: "
            + install_command("csf", "cloth-simulation-filter")
        ) from error
    return CSF


def cloth_ground(points: Floats, p: ClothParameters) -> Booleans:
    """Tell which points, (N, 3), lie on a cloth that falls on the map turned upside down.

    Raises
    ------
    MissingDependencyError
        If the package is not installed.
    """
    CSF = cloth_library()  # noqa: N806 (its name)
    mask = np.zeros(len(points), np.bool_)
    if len(points) == 0:
        return mask
    _check_size(points, p.cloth_resolution)
    with _quiet_output():
        filter_ = CSF.CSF()
        filter_.params.bSloopSmooth = p.slope_smooth
        filter_.params.cloth_resolution = p.cloth_resolution
        filter_.params.rigidness = p.rigidness
        filter_.params.class_threshold = p.class_threshold
        filter_.params.time_step = p.time_step
        filter_.params.interations = p.iterations  # the package's own spelling
        # near the origin: the cloth's lattice begins at the lowest corner anyway
        filter_.setPointCloud(np.ascontiguousarray(points - points.min(axis=0)))
        ground, others = CSF.VecInt(), CSF.VecInt()
        filter_.do_filtering(ground, others, False)
    mask[np.fromiter(ground, np.int64, len(ground))] = True
    return mask


def _check_size(points: Floats, resolution: float) -> None:
    """Refuse a cloth so large that the package would end the process."""
    particles = np.prod(np.ptp(points[:, :2], axis=0) / resolution + 1)
    if not particles <= _MOST_PARTICLES:
        raise InvalidPointsError(
            f"ground.method: csf lays one cloth over the whole map: {particles:.3g} particles at "
            f"ground.csf.cloth_resolution {resolution:g} m, and {_MOST_PARTICLES:.3g} is the most; "
            "a stray point far away is enough"
        )


@contextmanager
def _quiet_output() -> Iterator[None]:
    """Send what compiled code prints nowhere."""
    if sys.stdout is not None:
        sys.stdout.flush()
    saved = os.dup(1)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        yield
    finally:
        os.dup2(saved, 1)
        os.close(saved)
        os.close(nowhere)
