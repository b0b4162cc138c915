"""The work of a run: gone on with where map and configuration are the same, or begun anew."""

import hashlib
import json
import os
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from pipeline.configuration.run import Configuration
from pipeline.errors import WorkError
from pipeline.progress import StageObserver
from pipeline.tiles.sealed import read_sealed
from pipeline.tiles.verifying import verify_work
from pipeline.work.folder import is_self_contained, remove_work
from pipeline.work.job import JOB_FILE, Job
from pipeline.work.map_state import MapState

_COMPUTING = ("dynahull-pipeline", "numpy", "scikit-learn", "numba")
"""What other versions of might compute other bits."""


def open_job(
    work: Path,
    paths: Sequence[Path],
    state: MapState,
    digest: str,
    configuration: Configuration,
    fresh: bool,
    observer: StageObserver,
    stage: str,
) -> Job:
    """Go on with the work of an earlier run of the same map and configuration, or begin anew.

    Parameters
    ----------
    work : Path
        The work folder.
    paths : sequence of Path
        The map's files.
    state : MapState
        Theirs, from before the bytes were hashed.
    digest : str
        Of their bytes.
    configuration : Configuration
    fresh : bool
        Begin anew in any case.
    observer : StageObserver
        Told when work of another map or configuration is given up, or is damaged.
    stage : str
        That will gather the chunks of tiles: `ground` or `chunk`.
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
    verify_work(job, observer, stage)
    return job


def _is_of_another(work: Path, key: str) -> bool:
    """Tell whether work says that it is not of this run; each of its markers says so as well."""
    try:
        return bool(read_sealed(work / JOB_FILE)["key"] != key)
    except WorkError:
        return False


def job_key(digest: str, configuration: Configuration) -> str:
    """Return the hash of all that decides what tasks leave: map, configuration, versions."""
    decisive = configuration.model_dump(mode="json", exclude={"execution", "cluster"})
    output = configuration.output
    decisive["output"] = {"labels": output.needs_scores, "report": output.report}
    text = json.dumps([[*map(version, _COMPUTING)], digest, decisive], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
