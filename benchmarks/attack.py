"""Runs are attacked again and again, and nothing of the user's may come to harm.

    python -m benchmarks.attack [MAP] [--rounds 20] [--max-points 20000] [--seed 0] [--attack NAME]

Each round picks an attack, by chance, and makes a run suffer it:

- `damage`: it is killed at a random moment (`kill -9`), and files of its work folder are changed by
  a bit, cut short, emptied, lengthened or removed.
- `failed call`: one call that writes, flushes or renames, chosen by chance among all of them, fails
  as on a full (ENOSPC) or a broken (EIO) disk.
- `small files`: no file may grow beyond a size chosen by chance, whoever writes it (EFBIG).

It may end well, or with exit code 1, one line of error, and no result in the folder but those of a
run before, all of them. Then the same command must end well. The results must have the bytes of a
run that nothing disturbed, and the input must not have changed. Prints what was done, and ends with
1 if any of this was not so.
"""

import argparse
import errno
import hashlib
import io
import multiprocessing
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any, Self

from tiling.ledger import NotedFile

WORK = ".dynahull-work"
PROCESSES = multiprocessing.get_context("spawn")
"""Not the fork server: a run starts its own, with an environment that its workers need."""


class HarmError(Exception):
    """An attack did harm."""


@dataclass(frozen=True, slots=True)
class Fault:
    """What goes wrong in a run.

    Attributes
    ----------
    call : int
        The call that fails, from one; zero: none.
    code : int
        The system's number of the error.
    size : int or None
        Bytes that no file may grow beyond.
    """

    call: int = 0
    code: int = errno.ENOSPC
    size: int | None = None


def main(given: Sequence[str] | None = None) -> None:
    """Attack, and say what came of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    default = Path("../shared/data/maps/corridor.pcd")
    parser.add_argument("map", nargs="?", type=Path, default=default)
    parser.add_argument("--rounds", type=int, default=20)
    parser.add_argument("--max-points", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--attack", choices=ATTACKS, action="append")
    parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE")
    arguments = parser.parse_args(given)
    settings = [f"tiling.max_points={arguments.max_points}", "execution.workers=1", *arguments.set]
    chance = random.Random(arguments.seed)
    done: Counter[str] = Counter()
    harm = []
    with tempfile.TemporaryDirectory() as folder:
        campaign = Campaign(arguments.map.resolve(), Path(folder), settings, chance)
        names = arguments.attack or list(ATTACKS)
        for number in range(arguments.rounds):
            name = names[number % len(names)]
            try:
                done[f"{name}: {ATTACKS[name](campaign)}"] += 1
                campaign.check_end()
            except HarmError as error:
                harm.append(f"round {number}, {name}: {error}")
    for what, times in sorted(done.items()):
        print(f"{times:>5}  {what}")
    print("\n".join(harm) if harm else "no harm: inputs untouched, results whole or absent")
    sys.exit(1 if harm else 0)


class Campaign:
    """A map, a folder, and what a run that nothing disturbed makes of the map.

    Parameters
    ----------
    map_file : Path
    folder : Path
        For everything else.
    settings : sequence of str
        Of the runs.
    chance : random.Random
    """

    def __init__(
        self, map_file: Path, folder: Path, settings: Sequence[str], chance: random.Random
    ) -> None:
        self.chance = chance
        self.out = folder / "out"
        self._map = map_file
        self._digest = digest_of(map_file)
        self._folder = folder
        self._settings = [word for each in settings for word in ("--set", each)]
        process = self.start(Fault())
        self.tasks = self.wait_for_tasks(process)
        process.join()
        if process.exitcode:
            raise HarmError(f"an undisturbed run: exit code {process.exitcode}, {self._errors()}")
        self.calls = int((self._folder / "calls").read_text())
        self._expected = self.results()

    def start(self, fault: Fault) -> BaseProcess:
        """Start a run in a process of its own."""
        arguments = ["run", str(self._map), "-o", str(self.out), "--labels", *self._settings]
        process = PROCESSES.Process(target=run_with, args=(arguments, fault, self._folder))
        process.start()
        return process

    def wait_for_tasks(self, process: BaseProcess, wanted: int | None = None) -> int:
        """Wait until so many tasks are done, or the run has ended; return how many were seen."""
        seen = 0
        while process.is_alive() and (wanted is None or seen < wanted):
            names = (name for _, _, names in os.walk(self.out / WORK) for name in names)
            seen = max(seen, sum(name.endswith(".done") for name in names))
            time.sleep(0.002)
        return seen

    def run(self, fault: Fault) -> tuple[int, list[str]]:
        """Run, and return the exit code and the lines of errors."""
        process = self.start(fault)
        process.join()
        return int(process.exitcode or 0), self._errors()

    def check_suffered(self, fault: Fault) -> str:
        """Run with a fault, check how it ends, and say so."""
        before = self.results()
        code, errors = self.run(fault)
        if code == 0:
            self.check_results()
            return "ended well"
        if code != 1 or len(errors) != 1 or "Traceback" in errors[0]:
            raise HarmError(f"{fault}: exit code {code}, {errors}")
        if self.results() != before:
            raise HarmError(f"{fault}: of results {sorted(before)} {sorted(self.results())} left")
        return "failed, one line"

    def check_end(self) -> None:
        """Check that the same command ends well, and that the input is as it was."""
        code, errors = self.run(Fault())
        if code or errors:
            raise HarmError(f"the same command again: exit code {code}, {errors}")
        self.check_results()
        hidden = [path.name for path in self.out.glob(".*")]
        if hidden:
            raise HarmError(f"left behind: {hidden}")
        if digest_of(self._map) != self._digest:
            raise HarmError(f"{self._map} was changed")
        shutil.rmtree(self.out)

    def check_results(self) -> None:
        """Check that the results are those of a run that nothing disturbed."""
        found = self.results()
        wrong = {name for name in self._expected if found.get(name) != self._expected[name]}
        if wrong:
            raise HarmError(f"not as they should be: {sorted(wrong)}; {sorted(found)}")

    def results(self) -> dict[str, str]:
        """Return the files of the output folder that are for the user; reports tell the time."""
        files = [path for path in self.out.glob("*") if path.is_file()]
        timed = (".json", ".html")
        return {path.name: "" if path.suffix in timed else digest_of(path) for path in files}

    def _errors(self) -> list[str]:
        text = (self._folder / "errors").read_text(encoding="utf-8", errors="replace")
        return [line for line in text.splitlines() if line.startswith(("error:", "Traceback"))]


def damage(campaign: Campaign) -> str:
    """Kill a run, and damage what it leaves."""
    process = campaign.start(Fault())
    campaign.wait_for_tasks(process, campaign.chance.randint(1, max(campaign.tasks - 1, 1)))
    if process.is_alive() and process.pid is not None:
        os.killpg(process.pid, signal.SIGKILL)
    process.join()
    files = [path for path in sorted((campaign.out / WORK).rglob("*")) if path.is_file()]
    if not files:
        return "ended before it was killed"
    for path in campaign.chance.sample(files, campaign.chance.randint(1, min(4, len(files)))):
        campaign.chance.choice(DAMAGE)(path, campaign.chance)
    return "killed, and damaged"


def failed_call(campaign: Campaign) -> str:
    """Let one call fail, of a run that has results before it or has none."""
    if campaign.chance.random() < 1 / 4:
        campaign.run(Fault())
    call = campaign.chance.randint(1, campaign.calls)
    code = campaign.chance.choice((errno.ENOSPC, errno.EIO))
    return campaign.check_suffered(Fault(call, code))


def small_files(campaign: Campaign) -> str:
    """Let no file grow beyond a size."""
    return campaign.check_suffered(Fault(size=int(10 ** campaign.chance.uniform(2, 7))))


def flip_a_bit(path: Path, chance: random.Random) -> None:
    """Change one bit."""
    content = bytearray(path.read_bytes())
    if content:
        content[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        path.write_bytes(content)


def cut_short(path: Path, chance: random.Random) -> None:
    """Leave the beginning."""
    os.truncate(path, int(chance.random() * path.stat().st_size))


def lengthen(path: Path, chance: random.Random) -> None:
    """Append bytes."""
    with path.open("ab") as file:
        file.write(chance.randbytes(chance.randint(1, 100)))


def empty(path: Path, chance: random.Random) -> None:
    """Leave nothing in it."""
    os.truncate(path, 0)


def remove(path: Path, chance: random.Random) -> None:
    """Remove it."""
    path.unlink()


DAMAGE = (flip_a_bit, cut_short, lengthen, empty, remove)

ATTACKS: dict[str, Callable[[Campaign], str]] = {
    "damage": damage,
    "failed call": failed_call,
    "small files": small_files,
}


def run_with(arguments: list[str], fault: Fault, folder: Path) -> None:
    """Be a run, with a fault; leave in a folder its errors, and how often it wrote."""
    os.setsid()
    errors = os.open(folder / "errors", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(errors, 1)
    os.dup2(errors, 2)
    for name in ("stdout", "stderr"):
        setattr(sys, name, io.TextIOWrapper(io.FileIO(errors, "w", closefd=False)))
    sys.argv = ["dynahull-pipeline", *arguments]
    calls = Calls(fault)
    from pipeline.commands.app import main as command  # noqa: PLC0415

    try:
        with calls:
            command()
    finally:
        sys.stderr.flush()
        (folder / "calls").write_text(str(calls.seen))


class Calls:
    """Counts the calls that write, flush and rename, and lets one fail, within a block.

    Parameters
    ----------
    fault : Fault
    """

    def __init__(self, fault: Fault) -> None:
        self.seen = 0
        self._fault = fault
        self._true: list[tuple[Any, str, Any]] = []

    def __enter__(self) -> Self:
        for owner, name in (
            (os, "fsync"),
            (Path, "replace"),
            (Path, "rename"),
            (Path, "write_text"),
            (Path, "write_bytes"),
            (NotedFile, "write"),
        ):
            true = getattr(owner, name)
            self._true.append((owner, name, true))
            setattr(owner, name, self._counting(true))
        if self._fault.size is not None:
            hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
            resource.setrlimit(resource.RLIMIT_FSIZE, (self._fault.size, hard))
        return self

    def __exit__(self, *_: object) -> None:
        for owner, name, true in self._true:
            setattr(owner, name, true)
        if self._fault.size is not None:
            hard = resource.getrlimit(resource.RLIMIT_FSIZE)[1]
            resource.setrlimit(resource.RLIMIT_FSIZE, (hard, hard))

    def _counting(self, true: Callable[..., Any]) -> Callable[..., Any]:
        def called(*arguments: Any, **named: Any) -> Any:
            self.seen += 1
            if self.seen == self._fault.call:
                raise OSError(self._fault.code, os.strerror(self._fault.code))
            return true(*arguments, **named)

        return called


def digest_of(path: Path) -> str:
    """Return a hash of a file's bytes."""
    return hashlib.sha256(path.read_bytes()).hexdigest()


if __name__ == "__main__":
    main()
