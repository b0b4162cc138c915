"""Tiled clouds for tests, cut as maps are."""

from pathlib import Path
from tempfile import mkdtemp
from unittest.mock import patch

import numpy as np

from dynahull.observer import SilentObserver
from pipeline.evaluation.tiled_cloud import CloudSource, cut_clouds
from pipeline.evaluation.truth import RowValues
from tiling.collection import MapCollection


def source_of(path, xyz, labels=None, removed=None, chosen=None):
    """Write points as a map, and return it with what is known of its rows."""
    np.save(path, xyz)
    known = {"labels": labels, "removed": removed, "chosen": chosen}
    values = {name: RowValues.of(each) for name, each in known.items() if each is not None}
    return CloudSource(MapCollection([path]), **values)


def cut(folder, tile_points=1000, voxel=0.2, **sources):
    """Cut maps into the same tiles of so many points, in a new folder within one."""
    folder.mkdir(exist_ok=True)
    new = Path(mkdtemp(dir=folder))
    with patch("pipeline.evaluation.tiled_cloud.TILE_POINTS", tile_points):
        return cut_clouds(sources, voxel, new, SilentObserver())
