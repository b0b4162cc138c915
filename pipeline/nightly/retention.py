"""Which old results go, and when."""

from pathlib import Path

from pipeline.nightly.results import MapFolder, begun, is_finished
from pipeline.nightly.settings import Retention

_DAY = 86400.0


def remove_old_runs(
    folder: MapFolder,
    keep: Retention,
    now: float,
    wanted: str | None,
    *,
    work_may_go_on: bool,
) -> list[Path]:
    """Remove runs of a map that are neither among the last nor young.

    Parameters
    ----------
    folder : MapFolder
    keep : Retention
    now : float
        Seconds since 1970.
    wanted : str or None
        Key of what the map is now, unless it was set aside; its run stays, finished or not.
    work_may_go_on : bool
        Whether unfinished work of another key stays for `keep.days` as well: the map is gone,
        perhaps because its disk is, and may come back.

    Returns
    -------
    list of Path
        What is gone. The last good result never is.
    """
    latest = folder.latest()
    finished = folder.finished()
    last = set(finished[-keep.runs :])
    removed = []
    for run in folder.runs():
        is_young = keep.days is not None and now - begun(run) <= keep.days * _DAY
        if run == latest or run in last or (wanted is not None and run.name.endswith(wanted)):
            continue
        if is_young and (is_finished(run) or work_may_go_on):
            continue
        if folder.remove(run):
            removed.append(run)
    return removed
