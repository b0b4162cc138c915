"""What cleans a map for the night: a process of its own."""

import logging
import signal
import subprocess
import sys
from collections.abc import Callable
from select import select
from time import monotonic
from typing import IO, Protocol

from pipeline.nightly.one_map import Ended, Request

logger = logging.getLogger("dynahull")

_LOOK_EVERY = 0.5
"""Seconds between two looks at whether the night is over."""

_GRACE = 60.0
"""Seconds that a run has to stop in, before it is killed; what is done is kept even so."""


class Cleaner(Protocol):
    """Cleans maps."""

    def clean(self, request: Request, is_over: Callable[[], bool]) -> Ended:
        """Clean a map.

        Parameters
        ----------
        request : Request
        is_over : callable
            Tells whether to stop; asked now and then.
        """


class ChildProcess:
    """Cleans each map in a new process.

    A map that takes all memory, or that a library dies of, ends only that; and when the night's
    own process is killed, the pipe to the child ends, and the child with it.
    """

    def clean(self, request: Request, is_over: Callable[[], bool]) -> Ended:
        """Clean a map."""
        # -P: a folder `pipeline` in the present folder is not this package. A session of its own:
        # Ctrl-C goes to the night, which stops the child once.
        command = [sys.executable, "-P", "-m", "pipeline.nightly.one_map", request.to_text()]
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
            return Ended.from_text(answer)
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
