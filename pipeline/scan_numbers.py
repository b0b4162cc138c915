"""When each point of a map was seen: a scan number a point, where the map's files tell it.

Two points of one number were seen within about a tenth of a second, and higher numbers were seen
later. A wrong guess would cost walls, and none costs little: what is not sure is not used.
"""

from collections.abc import Sequence

import numpy as np

from dynahull.progress import Observer, SilentObserver
from pipeline.configuration.run import Configuration
from pipeline.errors import ConfigurationError
from pipeline.row_order import rows_of_a_scan
from pipeline.scan_fields import LEAST_SCANS, Overlap, Tally, candidates, tallies_of
from pipeline.scan_source import ScanSource, numbers_of_poses
from tiling.collection import MapCollection
from tiling.key_frames import ScanPoses

AUTO, OFF = "auto", "off"


def find_scans(
    collection: MapCollection, configuration: Configuration, observer: Observer | None = None
) -> ScanSource | None:
    """Find out what tells when the points of a map were seen, by one pass over it.

    Parameters
    ----------
    configuration : Configuration
        `evidence.time` is used.
    observer : Observer, optional
        Told of the pass, and of a field that was asked for and tells nothing.

    Returns
    -------
    ScanSource or None
        None where nothing tells it for sure.

    Raises
    ------
    ConfigurationError
        When the field that was asked for is not there.
    MapFormatError
        When a file is not what its header announced.
    """
    observer = observer or SilentObserver()
    wanted = configuration.evidence.time
    check_time(collection, configuration)
    if wanted == OFF or not collection.point_count:
        return None
    poses = collection.poses
    of_map = poses is not None and not poses.are_of_files
    if wanted == AUTO and poses is not None and not of_map:
        apart = _of_files(collection, poses, observer)
        if apart is not None:
            return apart
    names = candidates(collection) if wanted == AUTO else [wanted]
    if names:
        observer.stage("times", collection.point_count)
    given = wanted != AUTO or of_map
    found = [
        (tally, source)
        for tally in tallies_of(collection, names, given, observer)
        if (source := tally.source()) is not None
    ]
    if poses is not None and of_map:
        return _with_poses(found, poses, collection)
    if found:
        return found[0][1]
    if not given:
        return _of_rows(collection)
    observer.warn(
        f"evidence.time: {wanted} has not the {LEAST_SCANS} different scans, or tenths of a "
        "second, that tell when points were seen: not used"
    )
    return None


def _of_files(collection: MapCollection, poses: ScanPoses, observer: Observer) -> ScanSource | None:
    """Return the files as the source, or the scans in them if these saw the same places."""
    if poses.counts is None:
        return ScanSource(kind="files", scans=len(poses.poses), name="key frames")
    source = ScanSource(kind="files", scans=len(poses.poses), name="scans of the file")
    observer.stage("times", collection.point_count)
    overlap = Overlap()
    for file, batch in collection.batches():
        overlap.add(batch.xyz, source.numbers(collection, file, batch).astype(np.int64))
        observer.advance(len(batch.xyz))
    return source if overlap.is_shared() else None


def _with_poses(
    found: Sequence[tuple[Tally, ScanSource]], poses: ScanPoses, collection: MapCollection
) -> ScanSource:
    """Return the first source that the poses go with, its scans numbered by them."""
    refused: list[ConfigurationError] = []
    for tally, source in found:
        try:
            first, of_poses = numbers_of_poses(poses, tally.seen, source.name, source.tenth > 0)
        except ConfigurationError as error:
            refused.append(error)
            continue
        firsts = (first,) * len(collection.readers)
        return source.model_copy(update={"firsts": firsts, "of_poses": of_poses})
    if refused:
        raise refused[0]
    raise ConfigurationError(
        "input.poses: expected scans, or a map whose points have a scan number or a time, found "
        f"neither in {collection.name}"
    )


def _of_rows(collection: MapCollection) -> ScanSource | None:
    """Return the order of the rows as a source of scan numbers, if it is one."""
    rows = rows_of_a_scan(collection)
    if not rows:
        return None
    counts = [reader.description.point_count for reader in collection.readers]
    firsts = np.cumsum([0, *(-(-count // rows) for count in counts)]).tolist()
    return ScanSource(kind="rows", scans=firsts[-1], firsts=tuple(firsts[:-1]), rows=rows)


def check_time(collection: MapCollection, configuration: Configuration) -> None:
    """Refuse a field of `evidence.time` that the map does not have.

    Raises
    ------
    ConfigurationError
        In one line that lists those it has.
    """
    wanted = configuration.evidence.time
    if wanted in (AUTO, OFF):
        return
    for reader in collection.readers:
        single = [each.name for each in reader.description.fields if each.count == 1]
        if wanted not in single:
            raise ConfigurationError(
                f"evidence.time: expected auto, off, or a field of {reader.description.path} "
                f"({', '.join(single) or 'it has none'}), found {wanted!r}"
            )
