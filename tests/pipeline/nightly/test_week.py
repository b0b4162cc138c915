"""A week of nights in accelerated time: maps truly cleaned, and nights truly killed."""

import io
import json
import subprocess
import sys
import time
from hashlib import sha256

import numpy as np
import pytest

from pipeline.nightly.results import tasks_done
from pipeline.outputs.folder_lock import folder_is_locked

DAY = 86400.0

NIGHT = """
import sys, time
from pathlib import Path
from pipeline.nightly.one_map import Cleaner
from pipeline.nightly.clock import Clock, NightEnd
from pipeline.nightly.night import clean_nightly
from pipeline.nightly.settings import load_nightly_settings

class Cleaner(Cleaner):
    def clean(self, request, is_over):
        ended = super().clean(request, is_over)
        while request.map.name == sys.argv[3]:  # until it is killed
            time.sleep(1)
        return ended

class Ahead(Clock):
    def now(self):
        return time.time() + float(sys.argv[2])

clock = Ahead()
settings = load_nightly_settings(Path(sys.argv[1]))
clean_nightly(settings, Cleaner(), clock, NightEnd(clock, None))
"""


@pytest.fixture
def week(real_place, map_bytes):
    return Week(real_place, map_bytes)


class Week:
    """Changes by day, nights, and everything that must have been cleaned in the end.

    Attributes
    ----------
    expected : set of (str, str)
        Path and SHA-256 of all that stayed as it was over a night that could clean it.
    """

    def __init__(self, place, map_bytes):
        self.place, self.map_bytes = place, map_bytes
        self.expected = set()

    def arrive(self, name, seed, count=150):
        content = self.map_bytes(seed, count)
        path = self.place.write(name, content)
        self.expected.add((str(path), sha256(content).hexdigest()))
        return path

    def killed_night(self, moment, halt_after=""):
        """Kill a night, with everything it started, as soon as it is so far.

        It does not go on by itself after the map `halt_after`.
        """
        self.place.clock.time += DAY
        ahead = self.place.clock.time - time.time()
        command = [sys.executable, "-c", NIGHT, str(self.place.source), str(ahead), halt_after]
        process = subprocess.Popen(command)
        until = time.monotonic() + 300
        while not moment():
            assert process.poll() is None, "it ended before it could be killed"
            assert time.monotonic() < until
            time.sleep(0.005)
        process.kill()
        process.wait()
        while any(folder_is_locked(run) for run in self.place.output.glob("*/20*")):
            assert time.monotonic() < until, "something outlived the night"
            time.sleep(0.02)


def test_a_week(week, outcomes_of):
    place, arrive = week.place, week.arrive

    # Monday: two maps of one name, a map of several files, one that is corrupt, one half there.
    arrive("incoming/hall.npy", 1)
    arrive("incoming/site/hall.npy", 2)
    for number in (1, 2):
        place.write(f"surveys/yard/{number}.npy", week.map_bytes(10 + number, 60))
    place.write("incoming/corrupt.npy", b"\x93NUMPY nonsense")
    growing = place.write("incoming/growing.npy", week.map_bytes(3, 80)[:-200])
    place.clock.time += DAY
    place.being_written(growing)
    place.clock.time -= DAY
    summary = place.night()
    assert outcomes_of(summary)["corrupt.npy"] == "failed"
    assert outcomes_of(summary)["growing.npy"] == "waiting"
    assert summary.counts == {"cleaned": 3, "waiting": 1, "failed": 1}
    assert summary.exit_code == 4

    # Tuesday: what grew is complete; a large map arrives, and the night is killed over it.
    arrive("incoming/growing.npy", 3, 80)
    large = arrive("incoming/large.npy", 4, 4000)
    place.incoming.joinpath("corrupt.npy").rename(place.folder / "corrupt.npy")
    week.killed_night(lambda: sum(map(tasks_done, place.results(large).runs())) >= 20)
    (run,) = place.results(large).runs()
    done = tasks_done(run)
    assert done >= 20
    assert place.results(large).latest() is None

    # Wednesday: it goes on; the corrupt map is back, and one changes while it is cleaned.
    (place.folder / "corrupt.npy").rename(place.incoming / "corrupt.npy")
    hall = place.write("incoming/hall.npy", week.map_bytes(5))
    meddled = []

    def meddle(request):
        assert request.map != large or tasks_done(run) >= done
        if request.map == hall and not meddled:
            meddled.append(arrive("incoming/hall.npy", 6))
            place.being_written(hall)

    place.cleaner.before = meddle
    summary = place.night()
    assert outcomes_of(summary)["large.npy"] == "cleaned"
    assert place.results(large).runs() == [run], "it went on where it was"
    assert {line.map: line.outcome for line in summary.maps}[str(hall)] == "waiting"
    assert outcomes_of(summary)["corrupt.npy"] == "failed"
    assert meddled

    # Thursday: killed when a result is published and nothing is said of it yet.
    new = arrive("incoming/new.npy", 7)
    week.killed_night(lambda: any(place.results(new).finished()), halt_after=new.name)

    # Friday: one vanishes, one is only copied anew, a file joins the map of several.
    gone = place.incoming / "site" / "hall.npy"
    kept = gone.read_bytes()
    gone.unlink()
    growing.write_bytes(growing.read_bytes())
    place.write("surveys/yard/3.npy", week.map_bytes(13, 60))
    summary = place.night()
    assert outcomes_of(summary)["growing.npy"] == "unchanged"
    assert outcomes_of(summary)["yard"] == "cleaned"
    assert outcomes_of(summary)["corrupt.npy"] == "set aside"
    assert place.results(gone).latest() is not None

    # Saturday: what vanished is back, what was corrupt is whole.
    place.write("incoming/site/hall.npy", kept)
    arrive("incoming/corrupt.npy", 8)
    assert place.night().exit_code == 0

    # Sunday: rest.
    summary = place.night()
    assert set(summary.counts) == {"unchanged"}
    assert summary.exit_code == 0
    assert sorted(outcomes_of(summary)) == [
        "corrupt.npy", "growing.npy", "hall.npy", "large.npy", "new.npy", "yard",
    ]  # fmt: skip
    check_results(place, week.expected)


def check_results(place, expected):
    """Nothing is lost, and nothing was cleaned twice."""
    said = [(line["map"], line["run"]) for line in place.lines("cleaned")]
    assert len(said) == len(set(said)), "said once"
    cleaned = []
    for _, name in said:
        report = json.loads((place.output / name / "run.json").read_text())
        cleaned.append((report["files"][0]["path"], report["input_hash"]))
    assert len(cleaned) == len(set(cleaned)), "no content was cleaned twice"
    files = {each for each in cleaned if "/surveys/" not in each[0]}
    assert files == expected
    assert sum("/surveys/" in path for path, _ in cleaned) == 2
    runs = [run.name for run in place.output.glob("*/20*")]
    assert len(runs) == len(said), "and nothing half done is left"
    for path in place.incoming.rglob("*.npy"):
        latest = place.results(path).path / "latest"
        parts = [np.load(latest / f"{part}.npy") for part in ("static", "dynamic")]
        whole = np.load(io.BytesIO(path.read_bytes()))
        assert sorted(map(tuple, np.concatenate(parts))) == sorted(map(tuple, whole))
    hidden = [path for path in place.output.rglob(".*") if path.name != ".nightly"]
    assert hidden == []
    assert sorted(path.name for path in place.output.iterdir() if path.is_file()) == [
        "index.html", "nightly.json", "nightly.jsonl",
    ]  # fmt: skip
