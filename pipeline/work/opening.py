"""The work of a run: gone on with where map and configuration are the same, or begun anew.

What an earlier run left is looked through first. Files may have been damaged meanwhile: cut short,
emptied, removed, or changed by a bit. Each marker knows what its task wrote; where that is not
there as it was, the marker is removed, and the task is done again. As tasks are pure functions,
what other tasks made of its files stays valid. What the rest of the run does not need is not looked
at: pieces, once all points are in chunks.
"""

import hashlib
import json
import logging
import os
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path

from dynahull.evidence.model import models_digest
from pipeline.configuration.run import Configuration
from pipeline.progress import StageObserver
from pipeline.work.files import read_if_whole
from pipeline.work.folder import is_self_contained, remove, remove_work, stages_begun
from pipeline.work.job import CHUNKS_FOLDER, JOB_FILE, PLANNING, STEPS, Job, MapState
from tiling.ledger import Written

logger = logging.getLogger("dynahull")

_NAMED = 3
"""Damaged files that a warning names."""

_COMPUTING = ("dynahull-pipeline", "numpy", "scikit-learn", "numba")
"""What other versions of might compute other bits."""

_FORMAT = 4
"""Of the files that tasks leave: work of another format is begun anew."""


def open_job(
    work: Path,
    paths: Sequence[Path],
    state: MapState,
    digest: str,
    configuration: Configuration,
    fresh: bool,
    observer: StageObserver,
) -> Job:
    """Go on with the work of an earlier run of the same map and configuration, or begin anew.

    Parameters
    ----------
    state : MapState
        From before the bytes of the map's files were hashed to their `digest`.
    observer : StageObserver
        Told when work of another map or configuration is given up, or is damaged.
    """
    work = work.parent.resolve() / work.name  # workers may have another current folder
    job = Job(work, job_key(digest, configuration), tuple(paths), state, configuration)
    earlier = os.path.lexists(work)
    foreign = earlier and (not is_self_contained(work) or _is_of_another(work, job.key))
    if fresh or not earlier or foreign:
        if earlier and not fresh:
            observer.warn(
                f"{work}: holds the work of another map or configuration, or of another version "
                "or of its libraries; starting over"
            )
        remove_work(work)
        work.mkdir()
    job.save()
    _Verification(job, observer).all()
    if done := [f"{stage} {count}" for stage, count, _ in stages_begun(work) if count]:
        logger.info("going on with an earlier run; tasks done: %s", ", ".join(done))
    return job


def _is_of_another(work: Path, key: str) -> bool:
    """Tell whether work says that it is not of this run; each of its markers says so as well."""
    stored = read_if_whole(work / JOB_FILE)
    return bool(stored is not None and stored["key"] != key)


def job_key(digest: str, configuration: Configuration) -> str:
    """Return the hash of all that decides what tasks leave: the map, how it is cleaned, by what."""
    decisive = configuration.model_dump(mode="json", exclude={"execution", "cluster"})
    output = configuration.output
    decisive["output"] = {"labels": output.needs_scores, "report": output.report}
    models = models_digest() if configuration.removal.weighs_evidence else None
    computing = [_FORMAT, [*map(version, _COMPUTING)], models]
    text = json.dumps([*computing, digest, decisive], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


class _Verification:
    """One look through the work of a job that was saved, and not begun or gone on with yet.

    Markers go of tasks whose files are not as they were written, and the damage is told.
    """

    def __init__(self, job: Job, observer: StageObserver) -> None:
        self._job = job
        self._work = job.work
        self._observer = observer
        self._damaged: set[str] = set()
        self._spent: dict[str, bool] = {}

    def all(self) -> None:
        """Look through all that the rest of the run needs."""
        steps = [self._work.step_path(step) for step in STEPS]
        self._check([path for path in steps if path.exists()])
        for stage in ("write", "label", "evidence", "density", "height", "ground", "columns"):
            self._check(self._markers(stage), self._matters)
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
        if self._job.is_spent("cut"):
            return True
        self._check(self._markers("cut"))
        return all(self._work.report("cut", part) for part in range(len(self._job.cut_ranges)))

    def _matters(self, written: Written) -> bool:
        """Tell whether a file is needed; asked when the markers of those that read it are known."""
        folder = written.path.parent.name
        if folder not in self._spent:
            planned = self._work.has_done(PLANNING)
            self._spent[folder] = planned and self._job.is_spent(folder)
        return not self._spent[folder]

    def _markers(self, stage: str) -> list[Path]:
        return list((self._work.root / stage).glob("[!.]*.done"))

    def _check(
        self, markers: Sequence[Path], matters: Callable[[Written], bool] = lambda each: True
    ) -> None:
        """Remove markers that are damaged, or whose files are."""
        for path in markers:
            marker = self._work.marker(path)
            written = () if marker is None else filter(matters, marker.written)
            damaged = [each.path for each in written if not each.is_intact()]
            if marker is None:
                damaged.append(path)
            self._damaged.update(str(each.relative_to(self._work.root)) for each in damaged)
            if damaged:
                remove(path)
            for each in damaged:
                if each.is_dir():  # nothing could be put in its place
                    remove(each)
