"""Running a method in a process of its own, with a limit on time and memory."""

import json
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.compare.method import Method

__all__ = ["Limits", "Outcome", "run_isolated"]

_ROOT = Path(__file__).resolve().parents[2]
_LONGEST_REASON = 160

_PATIENCE = 20.0
"""Times the processor time: the wall time after which a process is taken for stuck."""


@dataclass(frozen=True, slots=True)
class Limits:
    """What a method may take: seconds of processor time, and GiB of memory."""

    seconds: float
    memory: float


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a run.

    Attributes
    ----------
    skipped : str or None
        Why there is no result.
    exhausted : bool
        It took all time or memory that it was given.
    removed : (N,) bool array
        Empty where there is none.
    seconds : float
        Processor time of the method, all threads and programs it starts together: a machine that
        is shared changes it little. Reading the scene, importing and compiling are left out.
    """

    skipped: str | None
    exhausted: bool
    removed: NDArray[np.bool_]
    seconds: float

    @classmethod
    def skip(cls, reason: str, *, exhausted: bool = False) -> "Outcome":
        """Return the outcome of a run that gave nothing."""
        return cls(reason, exhausted, np.empty(0, dtype=np.bool_), 0.0)


def run_isolated(method: Method, scene: Path, folder: Path, limits: Limits) -> Outcome:
    """Run a method on a scene that was written to a file; no failure of it is raised.

    Parameters
    ----------
    method : Method
    scene : Path
    folder : Path
        For the files that come back.
    limits : Limits
        Of the seconds, importing and compiling take their share.
    """
    removed, report = folder / "removed.npy", folder / "report.json"
    removed.unlink(missing_ok=True)
    report.unlink(missing_ok=True)
    command = [sys.executable, "-m", "benchmarks.compare.worker", method.name]
    command += [str(path.resolve()) for path in (scene, removed, report)]
    command += ["--memory", str(limits.memory), "--seconds", str(limits.seconds)]
    too_slow = Outcome.skip(f"more than {limits.seconds:g} s", exhausted=True)
    try:
        done = subprocess.run(
            command,
            cwd=_ROOT,
            timeout=_PATIENCE * limits.seconds,
            capture_output=True,
            text=True,
            errors="replace",
            check=False,
        )
    except subprocess.TimeoutExpired:
        return too_slow
    if done.returncode == -signal.SIGXCPU:
        return too_slow
    if done.returncode:
        return Outcome.skip(_failure(done.returncode, done.stderr))
    told = json.loads(report.read_text(encoding="utf-8"))
    if "skipped" in told:
        return Outcome.skip(told["skipped"], exhausted=told["exhausted"])
    return Outcome(None, False, np.load(removed), told["seconds"])


def _failure(code: int, errors: str) -> str:
    if code < 0:
        return f"ended by signal {-code}"
    lines = errors.strip().splitlines()
    return f"failed: {lines[-1][:_LONGEST_REASON]}" if lines else f"failed with exit code {code}"
