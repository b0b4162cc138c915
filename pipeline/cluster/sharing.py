"""What workers elsewhere must share with the run, asked of each of them before it gets a task."""

import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any
from uuid import uuid4

from distributed import Worker
from distributed.diagnostics.plugin import WorkerPlugin

TOPIC = "dynahull-refused"
"""Under which a worker that cannot take part says why."""


@dataclass(frozen=True, slots=True)
class SharedFiles:
    """What every worker must find where the run finds it."""

    folder: str
    """The work folder, to be read and written."""
    token: str
    """Name of a file in it that the run made just now."""
    sizes: tuple[tuple[str, int], ...]
    """The map's files and their bytes."""
    version: str
    """Of this package: another one may give other results."""

    @classmethod
    def of(cls, folder: Path, maps: Sequence[Path]) -> "SharedFiles":
        """Look at them from here, and make the token; `remove` takes it away."""
        token = f".shared-{uuid4().hex}"
        (folder / token).touch()
        sizes = tuple((str(path.resolve()), path.stat().st_size) for path in maps)
        return cls(str(folder.resolve()), token, sizes, version("dynahull-pipeline"))

    def remove(self) -> None:
        """Remove the token."""
        (Path(self.folder) / self.token).unlink(missing_ok=True)

    def trouble(self) -> str | None:
        """Return, in one line, what this machine does not share; None if nothing is wrong."""
        here = socket.gethostname()
        folder = Path(self.folder)
        if not (folder / self.token).is_file():
            return (
                f"{here} does not see {folder}: map and output folder must lie on a file system "
                "that every node mounts at the same place"
            )
        if not os.access(folder, os.W_OK):
            return f"{here} may not write into {folder}"
        for path, size in self.sizes:
            try:
                found = Path(path).stat().st_size
            except OSError as error:
                return f"{here} cannot read {path}: {error.strerror}"
            if found != size:
                return f"{here} sees {found} bytes of {path}, which has {size}"
        found_version = version("dynahull-pipeline")
        if found_version != self.version:
            return f"{here} has dynahull-pipeline {found_version}, the run has {self.version}"
        return None


class SharingCheck(WorkerPlugin):  # type: ignore[misc]
    """Makes a worker leave that does not share what it must, and say why."""

    name = "dynahull-sharing"

    def __init__(self, files: SharedFiles) -> None:
        self._files = files

    async def setup(self, worker: Worker) -> None:
        """Check, before the worker takes tasks."""
        trouble = self._files.trouble()
        if trouble is not None:
            worker.log_event(TOPIC, trouble)
            await worker.close(reason="dynahull-not-shared")


def check_running_workers(client: Any, files: SharedFiles) -> str | None:
    """Return what a worker of a running cluster that is in trouble says, None if all is well."""
    answers = client.run(files.trouble)
    return next((answer for answer in answers.values() if answer is not None), None)
