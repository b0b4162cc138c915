"""Each call of a run that writes fails once, and nothing of the user's comes to harm.

    python -m benchmarks.failed_writes MAP [--every 1] [--set KEY=VALUE]...

Counts the calls of a run that create, write, cut, flush and rename files, those that libraries make
included, and lets one after the other fail, or each `--every`-th: as on a full disk (ENOSPC) and on
a broken one (EIO) by turns, with and without results of a run before. The run may end well, but for
its report, or with exit code 1, one line of error, and no results in the folder but all of those
before. Then the same command must end well, with the bytes of a run in which nothing failed. Ends
with 1 if any of this was not so, or the map was changed. All runs are in one process; a C compiler
(`cc`) makes what is loaded before the C library.
"""

import argparse
import contextlib
import ctypes
import errno
import io
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from benchmarks.attack import HarmError, digest_of
from pipeline.commands.app import main as command
from pipeline.replacing import REPORT_FILE

SOURCE = Path(__file__).with_name("failing.c")
TIMED = (".json", ".html")
"""Files that tell the time, so that no two runs write the same."""


def main(given: Sequence[str] | None = None) -> None:
    """Let every call fail, and say what came of it."""
    given = sys.argv[1:] if given is None else given
    loaded = os.environ.get("LD_PRELOAD", "")
    if not loaded.endswith(f"/{SOURCE.stem}.so"):
        sys.exit(_with_failing_calls(given))
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("map", type=Path)
    parser.add_argument("--every", type=int, default=1)
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    arguments = parser.parse_args(given)
    begun = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        runs = Runs(arguments.map.resolve(), Path(folder) / "out", arguments.set, loaded)
        calls = runs.calls
        ended: Counter[str] = Counter()
        harm = []
        for call in range(1, calls + 1, arguments.every):
            try:
                ended[runs.suffer(call, is_second=(call // 2) % 2 == 1)] += 1
            except HarmError as error:
                harm.append(f"HARM: call {call}: {error}")
                print(harm[-1], flush=True)
    came = ", ".join(f"{count} {what}" for what, count in sorted(ended.items()))
    print(f"{calls} calls; {came}; {time.monotonic() - begun:.0f} s")
    print(f"{len(harm)} did harm" if harm else "no harm: input untouched, results whole or absent")
    sys.exit(1 if harm else 0)


class Runs:
    """Runs of one map, in this process, in which one call fails.

    Parameters
    ----------
    map_file : Path
    out : Path
        Their output folder.
    settings : sequence of str
        Further settings of the runs.
    library : str
        What `failing.c` was compiled to.

    Attributes
    ----------
    calls : int
        How many calls the last run made that could fail.
    """

    def __init__(self, map_file: Path, out: Path, settings: Sequence[str], library: str) -> None:
        self._map, self._out = map_file, out
        self._digest = digest_of(map_file)
        settings = ["execution.cluster=none", "execution.workers=1", *settings]
        words = [word for each in settings for word in ("--set", each)]
        self._command = ["dynahull-pipeline", "run", str(map_file), "-o", str(out), *words]
        self._library = ctypes.CDLL(library)
        self.calls = 0
        for _ in range(2):  # what is compiled, and kept, is so after the first
            self._run_well()
            self._expected = self._results()
            shutil.rmtree(out)

    def suffer(self, call: int, is_second: bool) -> str:
        """Run while one call fails, and once more; return how it ended.

        Raises
        ------
        HarmError
            When anything is not as it must be.
        """
        if is_second:
            self._run_well()
        before = self._results()
        code, errors = self._run(call, errno.ENOSPC if call % 2 else errno.EIO)
        if code == 0:
            shown = {REPORT_FILE} - self._results().keys()
            if self._results() != {k: v for k, v in self._expected.items() if k not in shown}:
                raise HarmError(f"ended well, with {sorted(self._results())}")
            ended = "ended well" + (" without the report" if shown else "")
        else:
            if code != 1 or len(errors) != 1 or "Traceback" in errors[0]:
                raise HarmError(f"exit code {code}, {errors}")
            if self._results() not in (before, self._expected):
                raise HarmError(f"of {sorted(before)} {sorted(self._results())} left: {errors[0]}")
            ended = "ended in one line"
        self._run_well()
        if self._results() != self._expected:
            raise HarmError("the same command again gave something else")
        hidden = [path.name for path in self._out.glob(".*")]
        if hidden:
            raise HarmError(f"left behind: {hidden}")
        if digest_of(self._map) != self._digest:
            raise HarmError(f"{self._map} was changed")
        shutil.rmtree(self._out)
        return ended

    def _run_well(self) -> None:
        code, errors = self._run(0, 0)
        if code or errors:
            raise HarmError(f"nothing failed, and yet: exit code {code}, {errors}")

    def _run(self, call: int, error: int) -> tuple[int, list[str]]:
        """Run; return the exit code, and the lines of errors."""
        sys.argv = self._command
        said, code = io.StringIO(), 0
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(said):
            self._library.fail_at(ctypes.c_long(call), error)
            try:
                command()
            except SystemExit as ended:
                code = int(ended.code or 0)
            finally:
                self.calls = self._library.calls_seen()
                self._library.fail_at(ctypes.c_long(-1), 0)
        lines = said.getvalue().splitlines()
        return code, [line for line in lines if line.startswith(("error:", "Traceback"))]

    def _results(self) -> dict[str, str]:
        """Return the files of the output folder that are for the user, with hashes."""
        files = [path for path in self._out.glob("*") if path.is_file()]
        return {path.name: "" if path.suffix in TIMED else digest_of(path) for path in files}


def _with_failing_calls(given: Sequence[str]) -> int:
    """Do all this in a process whose calls can be let fail; return its exit code."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / f"{SOURCE.stem}.so"
        subprocess.run(["cc", "-shared", "-fPIC", "-o", library, SOURCE, "-ldl"], check=True)
        words = [sys.executable, "-m", "benchmarks.failed_writes", *given]
        environment = {**os.environ, "LD_PRELOAD": str(library)}
        return subprocess.run(words, env=environment, check=False).returncode


if __name__ == "__main__":
    main()
