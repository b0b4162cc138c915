"""Work that an earlier run left is looked through before it is gone on with.

Files may have been damaged meanwhile: cut short, emptied, removed, or changed by a bit. Each marker
knows what its task wrote; where that is not there as it was, the marker is removed, and the task is
done again. As tasks are pure functions, what other tasks made of its files stays valid.
What the rest of the run does not need is not looked at: pieces and chunks, once all points are
further on.
"""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from pipeline.plan.machine import available_cores
from pipeline.progress import StageObserver
from pipeline.tiles.cutting import needs_pieces
from pipeline.work.folder import remove
from pipeline.work.job import CHUNKS_FOLDER, CREATING, FITTING, PLANNING, Job
from tiling.ledger import Written

_NAMED = 3
"""Damaged files that a warning names."""


def verify_work(job: Job, observer: StageObserver, stage: str) -> None:
    """Remove the markers of tasks whose files are not as they were written.

    Parameters
    ----------
    job : Job
        Saved, and not begun or gone on with yet.
    observer : StageObserver
        Told of damage.
    stage : str
        That gathers the chunks of tiles: `ground` or `chunk`.
    """
    with ThreadPoolExecutor(available_cores(job.configuration.execution.workers)) as threads:
        _Verification(job, observer, stage, threads).all()


class _Verification:
    """One look through a work folder.

    Parameters
    ----------
    job, observer, stage
        See `verify_work`.
    threads : ThreadPoolExecutor
        Files are read side by side.
    """

    def __init__(
        self, job: Job, observer: StageObserver, stage: str, threads: ThreadPoolExecutor
    ) -> None:
        self._job = job
        self._work = job.work
        self._observer = observer
        self._stage = stage
        self._threads = threads
        self._chunks: dict[Path, Written] = {}
        self._damaged: set[str] = set()

    def all(self) -> None:
        """Look through all that the rest of the run needs."""
        steps = [self._work.step_path(step) for step in (PLANNING, FITTING, CREATING)]
        self._check([path for path in steps if path.exists()])
        for stage in ("ground", "density", "evidence", "label", "write"):
            self._check(self._markers(stage), lambda each: not self._is_chunk(each))
        cut_again = not self._check_chunks()
        decoded = self._job.decoded
        if decoded is None or decoded.has_records or cut_again:
            self._check(self._markers("survey"))
        else:  # coordinates, of which all that is needed is cut
            self._check(self._markers("survey"), lambda each: each.path != decoded.path)
        if self._damaged:
            named = ", ".join(sorted(self._damaged)[:_NAMED])
            more = len(self._damaged) - _NAMED
            self._observer.warn(
                f"{self._work.root}: not as it was written: {named}"
                f"{f' and {more} more' if more > 0 else ''}; what is missing is made again"
            )

    def _check_chunks(self) -> bool:
        """Look through chunks and pieces; tell whether all that is needed of them is there."""
        root = self._work.root
        if not self._work.has_done(PLANNING):  # they are of no use without
            for name in (CHUNKS_FOLDER, "cut", "chunk"):
                remove(root / name)
            return False
        self._check(self._markers("chunk"))
        layout, store = self._job.store.layout, self._job.store
        if all(self._work.report(self._stage, tile) for tile in range(len(layout))):
            return True
        for path in (store.folder / "chunks").glob("*"):
            chunk = self._chunks.get(path)
            if chunk is None or not chunk.is_intact():
                remove(path)
        if not needs_pieces(self._job, self._stage):
            return True
        self._check(self._markers("cut"))
        done = [self._work.report("cut", part) for part in range(len(self._job.cut_ranges))]
        whole = {store.piece_path(part) for part, report in enumerate(done) if report}
        for path in set((store.folder / "pieces").glob("*")) - whole:
            remove(path)
        return all(done)

    def _markers(self, stage: str) -> list[Path]:
        return list((self._work.root / stage).glob("[!.]*.done"))

    def _is_chunk(self, written: Written) -> bool:
        return written.path.parent == self._work.root / CHUNKS_FOLDER / "chunks"

    def _check(
        self, markers: Sequence[Path], matters: Callable[[Written], bool] = lambda each: True
    ) -> None:
        """Remove markers that are damaged, or whose files are."""
        looked_at = self._threads.map(lambda path: self._looked_at(path, matters), markers)
        for path, damaged in zip(markers, looked_at, strict=True):
            self._damaged.update(str(each.relative_to(self._work.root)) for each in damaged)
            if damaged:
                remove(path)
            for each in damaged:
                if each.is_dir():  # nothing could be put in its place
                    remove(each)

    def _looked_at(self, path: Path, matters: Callable[[Written], bool]) -> list[Path]:
        """Return what is damaged: the marker, or files that it knows."""
        marker = self._work.marker(path)
        if marker is None:
            return [path]
        self._chunks |= {each.path: each for each in marker.written if self._is_chunk(each)}
        written = filter(matters, marker.written)
        return [each.path for each in written if not each.is_intact()]
