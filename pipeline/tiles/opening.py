"""The work of a run: gone on with where map and configuration are the same, or begun anew."""

import hashlib
import json
import os
from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

from pipeline.configuration import Configuration
from pipeline.map_state import MapState
from pipeline.progress import StageObserver
from pipeline.tiles.job import JOB_FILE, Job
from pipeline.tiles.work import is_self_contained, read_json, remove_work


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
        Told when work of another map or configuration is given up.
    """
    work = work.parent.resolve() / work.name  # workers may have another current folder
    job = Job(work, job_key(digest, configuration), tuple(paths), state, configuration)
    if os.path.lexists(work):
        stored = read_json(work / JOB_FILE) if is_self_contained(work) else None
        if fresh or not isinstance(stored, dict) or stored.get("key") != job.key:
            if not fresh:
                observer.warn(
                    f"{work}: holds the work of another map or configuration; starting over"
                )
            remove_work(work)
    work.mkdir(exist_ok=True)
    job.save()
    return job


def job_key(digest: str, configuration: Configuration) -> str:
    """Return the hash of all that decides what tasks leave: map, configuration, version."""
    decisive = configuration.model_dump(mode="json", exclude={"execution", "cluster"})
    output = configuration.output
    decisive["output"] = {"labels": output.needs_scores, "report": output.report}
    text = json.dumps([version("dynahull-pipeline"), digest, decisive], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()
