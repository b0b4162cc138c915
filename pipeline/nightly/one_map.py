"""One map, cleaned in a process of its own: what ends that process ends no night.

The argument of the process is its request; it says on standard output what became of it, and stops
tidily on SIGTERM. When standard input ends, the night was killed, and it stops as well.
"""

import errno
import json
import logging
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from select import select
from threading import Thread
from time import monotonic
from typing import IO, Literal

from pydantic import TypeAdapter

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

_LOOK_EVERY = 0.5
"""Seconds between two looks at whether the night is over."""

_GRACE = 60.0
"""Seconds that a run has to stop in, before it is killed; what is done is kept even so."""

logger = logging.getLogger("dynahull")


@dataclass(frozen=True, slots=True)
class Request:
    """What to clean."""

    map: Path
    """A file, or the folder of a map of several."""
    output: Path
    """Folder of the run."""
    configuration: Configuration
    root: Path
    """The folder that the map lies in, and no link leads out of."""
    level: int = logging.INFO
    """Of the log, as `logging` counts them."""


@dataclass(frozen=True, slots=True)
class Ended:
    """How a run ended."""

    how: Literal["cleaned", "failed", "no space", "stopped", "died"]
    """`stopped`: as it was asked to. `died`: without a word."""
    reason: str = ""
    """Of a failure, in one line."""


_REQUEST = TypeAdapter(Request)


class Cleaner:
    """Cleans each map in a new process.

    A map that takes all memory, or that a library dies of, ends only that; and when the night's
    own process is killed, the pipe to the child ends, and the child with it.
    """

    def clean(self, request: Request, is_over: Callable[[], bool]) -> Ended:
        """Clean a map, unless `is_over`, asked now and then, says to stop."""
        # -P: a folder `pipeline` in the present folder is not this package. A session of its own:
        # Ctrl-C goes to the night, which stops the child once.
        asked = json.dumps(_REQUEST.dump_python(request, mode="json"))
        command = [sys.executable, "-P", "-m", "pipeline.nightly.one_map", asked]
        with subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        ) as process:
            assert process.stdout is not None  # as asked for
            try:
                answer = _answer(process, process.stdout, is_over)
                _wait(process)
            except BaseException:
                process.kill()
                raise
        if answer:
            return Ended(**json.loads(answer))
        return Ended("stopped") if is_over() else Ended("died", _last_words(process.returncode))


def _answer(process: subprocess.Popen[str], answers: IO[str], is_over: Callable[[], bool]) -> str:
    """Return what the child says, nothing if it ends without a word; stop it in time."""
    told: float | None = None
    while not select([answers], [], [], _LOOK_EVERY)[0]:
        if told is None and is_over():
            logger.info("the night is over: stopping")
            process.terminate()
            told = monotonic()
        elif told is not None and monotonic() - told > _GRACE:
            process.kill()
    return answers.readline()


def _wait(process: subprocess.Popen[str]) -> None:
    """Wait until the child has left; its answer is here, so that it may be made to."""
    try:
        process.wait(_GRACE)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _last_words(code: int | None) -> str:
    if code is None or code >= 0:
        return f"its process ended without a result (exit code {code})"
    name = signal.Signals(-code).name
    hint = ", as the system does when memory runs out" if name == "SIGKILL" else ""
    return f"its process was ended by {name}{hint}"


def clean_one(request: Request, observer: StageObserver) -> Ended:
    """Clean a map, whatever happens."""
    try:
        files = find_map_files([request.map])
        if not lie_within(request.root, files):
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
    signal.signal(signal.SIGTERM, _stop)
    Thread(target=_watch_the_night, daemon=True).start()
    request = _REQUEST.validate_python(json.loads(sys.argv[1]))
    logger.setLevel(request.level)
    ended = clean_one(request, StageObserver(LogDisplay()))
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    try:
        answer.write(json.dumps(asdict(ended)) + "\n")
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
