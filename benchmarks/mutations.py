"""Maps whose bytes are changed, again and again: each is read in full, or refused in one line.

    python -m benchmarks.mutations MAP... [--times 1000 | --seconds S] [--every 50] [--seed 0]

Of each map, bits are flipped, bytes put in, taken out, doubled and cut off, and numbers of the
header made others. What comes of it must be as many points as the file then counts, or one short
line of an error that is expected, soon. With each `--every`-th a whole run is made: it ends with
results that `verify` proves, or with none, and the file is as it was. Processes of its own work on
each map, since a crash must be seen, so many times or for so many seconds. Prints what came of it,
keeps what did harm, and ends with 1 if there was any.
"""

import argparse
import json
import multiprocessing
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

from benchmarks.attack import HarmError, digest_of
from dynahull.errors import DynaHullError
from pipeline.configuration.run import load_configuration
from pipeline.errors import PipelineError
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.verifying import verify
from tiling.collection import MapCollection
from tiling.errors import TilingError

SETTINGS = ("neighbours.k=8", "clustering.count=2", "ground.method=none", "output.report=none")
LONGEST_SECONDS = 10.0
HANGS_AFTER = 60
"""Seconds; libraries in C cannot be interrupted, so the process is ended."""

MOST_BYTES = 2 << 30
"""Of a process; compiled code and libraries take 0.4 GB of it."""

OF_A_PROCESS = 15_000
"""Mutations; libE57 loses about 60 kB with each file that it refuses."""

CAME = "came.json"
"""What came of the mutations of a process."""

IN_MEMORY = Path("/dev/shm")
"""Where files cost a hundredth of what they cost on a disk."""


@dataclass(frozen=True, slots=True)
class Extent:
    """How much is done to each map."""

    times: int | None
    """Mutations; None: as many as there is time for."""
    seconds: float
    """After so many no other one is begun."""
    every: int
    """With each so manieth a whole run is made."""
    seed: int


def mutated(content: bytes, chance: random.Random) -> bytes:
    """Return a file's bytes with one change, which is in the header more often than not."""
    edited = bytearray(content)
    end = len(edited) if chance.random() < 0.4 else min(len(edited), 400)
    at = chance.randrange(end)
    kind = chance.choice(["flip", "insert", "delete", "cut", "double", "number", "count"])
    if kind == "flip":
        edited[at] ^= 1 << chance.randrange(8)
    elif kind == "insert":
        edited[at:at] = chance.choice([b"\xff" * 4, b"\0" * 8, b"9", b"\n", b"\x1b[31m"])
    elif kind == "delete":
        del edited[at : at + chance.randint(1, 40)]
    elif kind == "cut":
        del edited[at:]
    elif kind == "double":
        edited[at:at] = edited[at : at + chance.randint(1, 300)]
    elif kind == "number":
        edited[at : at + 4] = chance.choice([0, 1, 2**31 - 1, 2**32 - 1]).to_bytes(4, "little")
    else:
        digits = [each.span() for each in re.finditer(rb"\d+", bytes(edited[:400]))]
        if digits:
            start, stop = chance.choice(digits)
            edited[start:stop] = chance.choice([b"0", b"1", b"39", b"41", b"9" * 12])
    return bytes(edited)


def sealed(content: bytes) -> bytes:
    """Return the bytes of an E57 file with the checksums of its pages right (CRC-32C).

    Else each change would be found by them alone.
    """
    pages = [content[at : at + 1020] for at in range(0, len(content) - 1023, 1024)]
    return b"".join(page + _checksum(page) for page in pages)


@lru_cache(1000)
def _checksum(page: bytes) -> bytes:
    checksum = 0xFFFFFFFF
    for byte in page:
        checksum = _CASTAGNOLI[(checksum ^ byte) & 0xFF] ^ checksum >> 8
    return (checksum ^ 0xFFFFFFFF).to_bytes(4, "big")


def _castagnoli() -> list[int]:
    table = []
    for byte in range(256):
        for _ in range(8):
            byte = byte >> 1 ^ 0x82F63B78 * (byte & 1)  # noqa: PLW2901
        table.append(byte)
    return table


_CASTAGNOLI = _castagnoli()


def main(given: Sequence[str] | None = None) -> None:
    """Change maps, and say what came of it."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("maps", nargs="+", type=Path)
    parser.add_argument("--times", type=int)
    parser.add_argument("--seconds", type=float, default=float("inf"))
    parser.add_argument("--every", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    given_all = parser.parse_args(given)
    times = given_all.times
    if times is None and given_all.seconds == float("inf"):
        times = 1000
    extent = Extent(times, given_all.seconds, given_all.every, given_all.seed)
    digests = {path: digest_of(path) for path in given_all.maps}
    harmed = [path for path in digests if not attacked(path, extent)]
    changed = [path for path, digest in digests.items() if digest_of(path) != digest]
    print("\n".join(f"HARM: {path} was changed" for path in changed) or "inputs untouched")
    sys.exit(1 if harmed or changed else 0)


def attacked(path: Path, extent: Extent) -> bool:
    """Change one map again and again, in processes of its own; return whether no harm was done."""
    place = IN_MEMORY if os.access(IN_MEMORY, os.W_OK) else None
    done: Counter[str] = Counter()
    slowest, first, begun = 0.0, 0, time.monotonic()
    while (left := extent.seconds - (time.monotonic() - begun)) > 0:
        numbers = range(first, min(first + OF_A_PROCESS, extent.times or sys.maxsize))
        if not numbers:
            break
        with tempfile.TemporaryDirectory(dir=place) as folder:
            work = (path, Path(folder), replace(extent, seconds=left), numbers)
            process = multiprocessing.get_context("spawn").Process(target=attack, args=work)
            process.start()
            process.join()
            if process.exitcode:
                kept = Path(tempfile.mkdtemp(prefix="harm_")) / path.name
                shutil.copy(Path(folder) / path.name, kept)
                ended = f"exit code {process.exitcode}; kept as {kept}"
                print(f"HARM: {path.name}: {ended}", flush=True)
                return False
            came, longest = json.loads(Path(folder, CAME).read_text())
        done.update(came)
        slowest, first = max(slowest, longest), numbers.stop
    came = ", ".join(f"{times} {what}" for what, times in sorted(done.items()))
    seconds = time.monotonic() - begun
    print(f"{path.name}: {came}; slowest {slowest:.1f} s, {seconds:.0f} s in all", flush=True)
    return True


def attack(path: Path, folder: Path, extent: Extent, numbers: range) -> None:
    """Change one map again and again, and write down what came of it; end with 1 at harm."""
    target = folder / path.name
    shutil.copy(path, target)
    _run(target, folder / "out")  # compiles what is not compiled yet
    _be_quiet()
    content = path.read_bytes()
    chance = random.Random(f"{path.name} {extent.seed} {numbers.start}")
    done: Counter[str] = Counter()
    slowest, begun = 0.0, time.monotonic()
    for number in numbers:
        start = time.monotonic()
        if start > begun + extent.seconds:
            break
        signal.alarm(HANGS_AFTER)
        changed = mutated(content, chance)
        is_sealed = path.suffix == ".e57" and chance.random() < 0.9
        target.write_bytes(sealed(changed) if is_sealed else changed)
        try:
            done[_read(target)] += 1
            if number % extent.every == 0:
                done[_run(target, folder / f"out{number}")] += 1
                shutil.rmtree(folder / f"out{number}", ignore_errors=True)
            slowest = max(slowest, time.monotonic() - start)
            _check_cost(slowest)
        except Exception as error:  # whatever is not expected
            print(f"HARM: {path.name}, seed {extent.seed}, mutation {number}: {error!r}")
            sys.exit(1)
    signal.alarm(0)
    Path(folder, CAME).write_text(json.dumps([done, slowest]))


def _be_quiet() -> None:
    """Say no more on standard error: Rust tells there of each file that it cannot decode."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    os.close(nowhere)


def _read(path: Path) -> str:
    """Read a map, and say whether it was read or refused."""
    try:
        collection = MapCollection([path])
        found = sum(len(batch.xyz) for _, batch in collection.batches(7))
    except TilingError as error:
        _check_line(error)
        return "refused"
    if found != collection.point_count:
        raise HarmError(f"{found} points of {collection.point_count}")
    return "read"


def _run(path: Path, folder: Path) -> str:
    """Clean a map, and say how that ended."""
    digest = digest_of(path)
    configuration = load_configuration(None, [*SETTINGS, "execution.workers=1"])
    try:
        run([path], folder, configuration, StageObserver(LogDisplay()))
        verify(folder)
        ended = "runs proven"
    except (TilingError, DynaHullError, PipelineError) as error:
        _check_line(error)
        ended = "runs ended in one line"
        if folder.exists():
            raise HarmError(f"left behind: {list(folder.iterdir())}") from error
    if digest_of(path) != digest:
        raise HarmError("the input was changed")
    return ended


def _check_line(error: Exception) -> None:
    if len(str(error)) > 400 or not str(error).isprintable():
        raise HarmError(f"no short line: {error}")


def _check_cost(seconds: float) -> None:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
    if seconds > LONGEST_SECONDS or peak > MOST_BYTES:
        raise HarmError(f"{seconds:.1f} s, {peak} bytes")


if __name__ == "__main__":
    main()
