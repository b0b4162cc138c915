"""The poses of the scans of which points are in a preview's part."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.configuration.run import Configuration
from pipeline.errors import ConfigurationError
from pipeline.progress import StageObserver
from pipeline.scan_numbers import find_scans
from pipeline.units import open_collection
from tiling.collection import MapCollection
from tiling.formats.points import PointBatch


def with_poses_of_part(
    collection: MapCollection,
    kept: Mapping[int, Sequence[PointBatch]],
    files: Sequence[Path],
    configuration: Configuration,
    observer: StageObserver,
) -> Configuration:
    """Return the configuration that a part of a map is cleaned with.

    Parameters
    ----------
    collection : MapCollection
        The whole map.
    kept : mapping of int to sequence of PointBatch
        What of each of its files is in the part.
    files : sequence of Path
        Those of the part; the poses are written beside them.
    configuration : Configuration
        Of the whole map.
    observer : StageObserver
        Warned where the part has too few scans for its poses.
    """
    poses, beside = collection.poses, files[0].parent / "poses.txt"
    if poses is None or poses.counts is not None:
        return configuration
    if poses.are_of_files:
        frame = "map" if poses.are_applied else "sensor"
        np.savetxt(beside, poses.poses[list(kept)].reshape(-1, 12), "%.17g")
        return _changed(configuration, poses=str(beside), frame=frame)
    if not configuration.removal.weighs_evidence:
        return configuration
    source = find_scans(collection, configuration, observer)
    of_part = configuration
    if source is not None and not source.tenth:
        # Poses go with scans by their numbers, or else in order: of the part, all do in order.
        numbers = [
            source.numbers(collection, file, batch)
            for file, batches in kept.items()
            for batch in batches
        ]
        seen = np.unique(np.concatenate(numbers))
        np.savetxt(beside, poses.poses[seen[seen >= 0]].reshape(-1, 12), "%.17g")
        of_part = _changed(configuration, poses=str(beside))
    if source is None or _is_like(source.kind, files, of_part):
        return of_part
    observer.warn("the part has too few scans: it is decided without their poses")
    return _changed(configuration, poses=None)


def _is_like(kind: str, files: Sequence[Path], configuration: Configuration) -> bool:
    """Tell whether the scans of the part are found, and have poses, as those of the map."""
    try:
        collection = open_collection(files, configuration.input)
        found = find_scans(collection, configuration)
    except ConfigurationError:
        return False
    return found is not None and found.kind == kind and bool(found.of_poses)


def _changed(configuration: Configuration, **values: Any) -> Configuration:
    changed = configuration.input.model_copy(update=values)
    return configuration.model_copy(update={"input": changed})
