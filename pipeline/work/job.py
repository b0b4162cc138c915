"""What every task of a run must know: the map, the configuration, and how the map is cut.

It is kept in the work folder, so that a task needs no more than the folder's name and its number.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property, lru_cache
from os import stat_result
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dynahull.clustering import Clusters
from dynahull.evidence.viewpoints import Viewpoints
from pipeline.configuration.run import Configuration
from pipeline.errors import InputChangedError
from pipeline.metres import open_collection
from pipeline.scan_source import ScanSource
from pipeline.work.files import open_rows, read_arrays, read_sealed, write_sealed
from pipeline.work.folder import WorkFolder
from tiling.chunks import ChunkStore
from tiling.collection import MapCollection
from tiling.errors import MapFormatError
from tiling.kept_points import KeptPoints

JOB_FILE = "job.json"
CLUSTERS_FILE = "clusters.arrays"
CHUNKS_FOLDER = "tiles"
DECODED_FILE = "map.decoded"
SCANS_FILE = "scans.json"
VIEWPOINTS_FILE = "viewpoints.arrays"

TIMING, PLANNING, FITTING, IMAGING, CREATING = STEPS = (
    "times", "plan", "clustering", "images", "outputs",
)  # fmt: skip
"""Steps that are about the whole map and are not shared out: what tells when points were seen,
tiles, clusters, range images, outputs in parts."""

SAMPLE = "sample"
"""Folder of the points that clusters are fitted on."""

LAST_READ_BY = {
    "cut": "chunk",
    "columns": "ground",
    "free": "density",
    SAMPLE: "density",
    "spread": "evidence",
}
"""Folders of what is large and soon needed no more, and the stage that is the last to read it."""

FileState = tuple[int, int, int, int]
"""Bytes, nanoseconds of the last change of content and of inode, inode.

Whoever rewrites a file can put its size and the first of these times back, but not the second. It
moves when a file is linked or its permissions change, too: that is taken for a change as well, and
costs work, never a wrong result.
"""

MapState = tuple[FileState, ...]
"""Of each file of a map: its bytes are hashed once, and later this tells whether it was touched."""

ROWS_AT_A_TIME = 500_000
"""Points of a range of rows that one task reads. Fixed: a run that goes on has the same ranges."""


@dataclass(frozen=True)
class Job:
    """A run, as its tasks see it."""

    root: Path
    """The work folder."""
    key: str
    """Hash of the input and of the configuration."""
    paths: tuple[Path, ...]
    """The map's files."""
    state: MapState
    """Theirs, when the key was made."""
    configuration: Configuration
    poses: str | None = None
    """The hash of the scans' poses, when the key was made."""

    def save(self) -> None:
        """Write what `open` reads."""
        values = {
            "key": self.key,
            "paths": [str(path.resolve()) for path in self.paths],
            "state": self.state,
            "configuration": self.configuration.model_dump(mode="json"),
            "poses": _hash_of(self.collection),
        }
        write_sealed(self.root / JOB_FILE, values)

    @classmethod
    def open(cls, folder: str) -> "Job":
        """Open the job of a work folder; the same object while the file stays the same."""
        root = Path(folder)
        return _opened(root, (root / JOB_FILE).stat().st_mtime_ns)

    @cached_property
    def work(self) -> WorkFolder:
        """The work folder."""
        return WorkFolder(self.root, self.key)

    @cached_property
    def collection(self) -> MapCollection:
        """The map.

        Raises
        ------
        InputChangedError
            When the poses of its scans are others than they were.
        """
        collection = open_collection(self.paths, self.configuration.input)
        if self.poses is not None and self.poses != _hash_of(collection):
            raise InputChangedError(f"{collection.name}: its poses changed while it was cleaned")
        return collection

    @cached_property
    def row_ranges(self) -> list[range]:
        """The ranges of rows that the map is read in."""
        return self.collection.row_ranges(ROWS_AT_A_TIME)

    @cached_property
    def decoded(self) -> KeptPoints | None:
        """The map's points as the survey decoded them, where it takes long to read them."""
        if self.collection.writes_parts:
            return None  # its bytes are its records
        return KeptPoints(self.root / DECODED_FILE, self.collection)

    @cached_property
    def cut_ranges(self) -> list[range]:
        """The ranges of rows that the map is cut in."""
        if self.decoded is None:
            return self.row_ranges
        count = self.collection.point_count
        starts = range(0, count, ROWS_AT_A_TIME)
        return [range(start, min(start + ROWS_AT_A_TIME, count)) for start in starts]

    @cached_property
    def store(self) -> ChunkStore:
        """The map cut into chunks; there once it is planned."""
        return ChunkStore.open(self.root / CHUNKS_FOLDER)

    @property
    def labelling(self) -> str:
        """The stage after which it is known which points are scored."""
        return "ground" if self.configuration.max_height is None else "height"

    @cached_property
    def clusters(self) -> Clusters:
        """The model of the whole map; there once it is fitted."""
        return Clusters(*read_arrays(self.root / CLUSTERS_FILE, "centroids"))

    @cached_property
    def scan_source(self) -> ScanSource | None:
        """What tells the scan of each point, if anything; there once that is looked for."""
        path = self.root / SCANS_FILE
        stored = read_sealed(path)["source"] if path.exists() else None
        return None if stored is None else ScanSource.model_validate(stored)

    @cached_property
    def viewpoints(self) -> Viewpoints | None:
        """From where scans are looked at, if they are known; there once the map is planned."""
        source = self.scan_source
        if source is None:
            return None
        sensor = source.sensor(self.collection)
        if sensor is not None:
            return Viewpoints.of_poses(sensor)
        numbers, places = read_arrays(self.root / VIEWPOINTS_FILE, "numbers", "places")
        return Viewpoints(numbers, places)

    def scans_of(self, rows: NDArray[np.int64]) -> NDArray[np.int32] | None:
        """Return the scan number of some rows, -1 where not known; None where nothing tells."""
        if self.scan_source is None:
            return None
        return np.asarray(open_rows(self.rows_path("scan"), np.int32)[rows])

    @property
    def needs_classes(self) -> bool:
        """Whether the ground is told by the classes of a LAS map."""
        return self.configuration.ground.method == "las_class"

    @property
    def finite_count(self) -> int:
        """Points of the map that take part, and are in tiles."""
        return int(self.store.layout.counts.sum())

    def is_spent(self, folder: str) -> bool:
        """Tell whether what tasks keep in a folder is needed no more: see `LAST_READ_BY`."""
        if folder == SAMPLE and self.configuration.clustering.scope == "map":
            return self.work.has_done(FITTING)
        last, tiles = LAST_READ_BY.get(folder), range(len(self.store.layout))
        return last is not None and all(self.work.report(last, tile) for tile in tiles)

    def remove_spent(self, folder: str) -> None:
        """Remove what is needed no more; a run that goes on does not miss it."""
        if self.is_spent(folder):
            for path in (self.root / folder).glob("[!.]*"):
                if path.suffix not in (".done", ".failed"):
                    path.unlink()

    def rows_path(self, name: str) -> Path:
        """Return the file of one value a row: `label`, `density`, `scan` and so on."""
        return self.root / f"{name}.rows"


@lru_cache(maxsize=2)
def _opened(root: Path, time: int) -> Job:
    del time
    stored = read_sealed(root / JOB_FILE)
    return Job(
        root,
        stored["key"],
        tuple(Path(path) for path in stored["paths"]),
        tuple((size, written, changed, inode) for size, written, changed, inode in stored["state"]),
        Configuration.model_validate(stored["configuration"]),
        stored["poses"],
    )


def _hash_of(collection: MapCollection) -> str | None:
    return None if collection.poses is None else collection.poses.hashed()


def map_state(paths: Sequence[Path]) -> MapState:
    """Return the state of a map's files.

    Raises
    ------
    MapFormatError
        When one is not there any more, or cannot be looked at.
    """
    states = []
    for path in paths:
        try:
            status = path.stat()
        except OSError as error:
            raise _unreadable(path, error) from error
        states.append(_state_of(status))
    return tuple(states)


def check_map(paths: Sequence[Path], state: MapState) -> None:
    """Check that a map's files are as they were.

    Raises
    ------
    InputChangedError
        When they are not.
    MapFormatError
        When one is not there any more.
    """
    for path, now, before in zip(paths, map_state(paths), state, strict=True):
        if now != before:
            raise InputChangedError(f"{path}: the map changed while it was being cleaned")


def _state_of(status: stat_result) -> FileState:
    return status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino


@contextmanager
def unchanged(paths: Sequence[Path]) -> Iterator[MapState]:
    """Hold a map to the state it has now; blame it for what goes wrong when it changed.

    Raises
    ------
    InputChangedError
        When a file is another one in the end, or when something goes wrong meanwhile.
    MapFormatError
        When a file is gone, or cannot be read any more.
    """
    state = map_state(paths)
    try:
        yield state
    except Exception as error:
        check_map(paths, state)
        if isinstance(error, OSError) and error.filename is not None:
            for path in paths:
                if Path(error.filename).absolute() == path.absolute():
                    raise _unreadable(path, error) from error
        raise
    check_map(paths, state)


def _unreadable(path: Path, error: OSError) -> MapFormatError:
    reason = error.strerror or type(error).__name__
    return MapFormatError(path, "a map that can be read", reason[:1].lower() + reason[1:])
