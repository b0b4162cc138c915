"""One map, cleaned in a process of its own: what ends that process ends no night.

Its argument is its request; it says on standard output what became of it, and stops tidily on
SIGTERM. When standard input ends, the night was killed, and it stops as well.
"""

import errno
import json
import logging
import os
import signal
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Thread
from typing import Literal

from dynahull.errors import DynaHullError
from pipeline.configuration.run import Configuration
from pipeline.errors import DiskSpaceError, PipelineError
from pipeline.nightly.inventory import lie_within
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.showing import printable
from tiling.collection import find_map_files
from tiling.errors import TilingError

_FULL = (os.strerror(errno.ENOSPC), os.strerror(errno.EDQUOT))
"""What the system says of a disk that is full, and of a user who may take no more of it."""

_LONGEST = 1_000
"""Characters of a reason."""

logger = logging.getLogger("dynahull")


@dataclass(frozen=True, slots=True)
class Request:
    """What to clean.

    Attributes
    ----------
    map : Path
        A file, or the folder of a map of several.
    output : Path
        Folder of the run.
    configuration : Configuration
    root : Path or None
        The folder that the map lies in, and no link leads out of.
    """

    map: Path
    output: Path
    configuration: Configuration
    root: Path | None = None

    def to_text(self) -> str:
        """Return the request as text of one line."""
        values = {
            "map": str(self.map),
            "output": str(self.output),
            "root": None if self.root is None else str(self.root),
            "configuration": self.configuration.model_dump(mode="json"),
        }
        return json.dumps(values)

    @classmethod
    def from_text(cls, text: str) -> "Request":
        """Read the text."""
        values = json.loads(text)
        configuration = Configuration.model_validate(values["configuration"])
        root = None if values["root"] is None else Path(values["root"])
        return cls(Path(values["map"]), Path(values["output"]), configuration, root)


@dataclass(frozen=True, slots=True)
class Ended:
    """How a run ended.

    Attributes
    ----------
    how : str
        `stopped`: as it was asked to. `died`: without a word.
    reason : str
        Of a failure, in one line.
    """

    how: Literal["cleaned", "failed", "no space", "stopped", "died"]
    reason: str = ""

    def to_text(self) -> str:
        """Return it as text of one line."""
        return json.dumps(asdict(self))

    @classmethod
    def from_text(cls, text: str) -> "Ended":
        """Read the text."""
        values = json.loads(text)
        return cls(values["how"], values["reason"])


def clean_one(request: Request, observer: StageObserver) -> Ended:
    """Clean a map, whatever happens."""
    try:
        files = find_map_files([request.map])
        if request.root is not None and not lie_within(request.root, files):
            return Ended("failed", f"{request.map}: became a link out of {request.root}")
        run(files, request.output, request.configuration, observer)
    except KeyboardInterrupt:
        return Ended("stopped")
    except DiskSpaceError as error:
        return Ended("no space", _one_line(error))
    except (TilingError, DynaHullError, PipelineError, OSError, MemoryError) as error:
        reason = _one_line(error)
        # Others filled the disk meanwhile; errors of workers come as text.
        return Ended("no space" if any(each in reason for each in _FULL) else "failed", reason)
    except Exception as error:
        logger.exception("this is a defect of dynahull-pipeline; please report it")
        return Ended("failed", f"defect: {type(error).__name__}: {_one_line(error)}")
    return Ended("cleaned")


def _one_line(error: Exception) -> str:
    """Return what an error says, of which parts may be from a file, as text for logs and pages."""
    return printable(" ".join(str(error).split()))[:_LONGEST] or type(error).__name__


def main() -> None:
    """Do what the argument asks for."""
    # Whatever libraries print goes to the log; no worker inherits where the answer goes.
    answer = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    logging.basicConfig(level=logging.WARNING, format="%(asctime)s %(levelname)s %(message)s")
    logger.setLevel(logging.INFO)
    signal.signal(signal.SIGTERM, _stop)
    Thread(target=_watch_the_night, daemon=True).start()
    ended = clean_one(Request.from_text(sys.argv[1]), StageObserver(LogDisplay()))
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        answer.write(ended.to_text() + "\n")
        answer.close()
    except BrokenPipeError:
        os._exit(1)


def _stop(*_: object) -> None:
    """Leave through the door of Ctrl-C, and let no second signal disturb that."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    raise KeyboardInterrupt


def _watch_the_night() -> None:
    """Wait until standard input ends, which is when the night's process does."""
    while os.read(0, 1):
        pass
    os.kill(os.getpid(), signal.SIGTERM)


if __name__ == "__main__":
    main()
