"""A place with maps, nights in accelerated time, and cleaners that keep count."""

import hashlib
import json
import os
import time

import numpy as np
import pytest

from pipeline.nightly.clock import NightEnd
from pipeline.nightly.night import clean_nightly
from pipeline.nightly.one_map import Ended, clean_one
from pipeline.nightly.results import MapFolder, map_name
from pipeline.nightly.settings import load_nightly_settings
from pipeline.progress import LogDisplay, StageObserver

DAY = 86400.0

SETTINGS = """
inputs:
  - maps: surveys
    each: folder
    settings: {settings}
  - maps: incoming/**/*.npy
    settings: {settings}
output: cleaned
settle: 10 min
wait: null
attempts: 2
"""

RUN_SETTINGS = [
    "neighbours.k=8",
    "clustering.count=2",
    "ground.method=none",
    "tiling.max_points=100",
    "tiling.halo=0.3",
    "execution.workers=1",
    "output.report=none",
]


class FakeClock:
    """Begins a day ahead, so that all files written until now are complete."""

    def __init__(self):
        self.time = time.time() + DAY

    def now(self):
        return self.time

    def monotonic(self):
        return self.time

    def sleep(self, seconds):
        self.time += seconds


class QuickCleaner:
    """Leaves what a run would, without the method; fails on maps that begin with `corrupt`.

    Attributes
    ----------
    done : list of (str, str)
        Name and content of every map cleaned.
    asked : list of str
        Names of the maps it was asked for.
    before, after : callable
        What happens meanwhile; both are given the request.
    """

    def __init__(self):
        self.done = []
        self.asked = []
        self.before = self.after = lambda request: None

    def clean(self, request, is_over):
        self.asked.append(request.map.name)
        self.before(request)
        ended = self._clean(request)
        self.after(request)
        return ended

    def _clean(self, request):
        content = request.map.read_bytes()
        if content.startswith(b"corrupt"):
            return Ended("failed", "it is corrupt")
        digest = hashlib.sha256(content).hexdigest()
        request.output.mkdir(parents=True)
        (request.output / "static.npy").write_bytes(content)
        report = {"input_hash": digest, "points": len(content), "counts": {"dynamic": 1}}
        (request.output / "run.json").write_text(json.dumps(report))
        self.done.append((request.map.name, content))
        return Ended("cleaned")


class InThisProcess(QuickCleaner):
    """Cleans maps truly."""

    def _clean(self, request):
        ended = clean_one(request, StageObserver(LogDisplay()))
        if ended.how == "cleaned":
            self.done.append((request.map.name, hash_of(request.map)))
        return ended


class Place:
    """Folders of maps and of results, and the nights spent there."""

    def __init__(self, folder):
        self.folder = folder
        self.incoming, self.output = folder / "incoming", folder / "cleaned"
        for each in (self.incoming, folder / "surveys"):
            each.mkdir()
        self.source = folder / "nightly.yaml"
        self.source.write_text(SETTINGS.format(settings=RUN_SETTINGS))
        self.clock = FakeClock()
        self.cleaner = QuickCleaner()

    def write(self, name, content):
        path = self.folder / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    def being_written(self, path):
        """Let a file look as if it was written to a minute ago."""
        os.utime(path, (self.clock.now() - 60,) * 2)

    def settings(self, *settings):
        return load_nightly_settings(self.source, settings)

    def night(self, *settings, retry=False):
        """Spend the next night."""
        self.clock.time += DAY
        found = self.settings(*settings)
        end = NightEnd(self.clock, found.stop_after)
        return clean_nightly(found, self.cleaner, self.clock, end, retry=retry)

    def results(self, path):
        return MapFolder(self.output / map_name(path))

    def lines(self, outcome=None):
        """What `nightly.jsonl` says, in all nights."""
        text = (self.output / "nightly.jsonl").read_text()
        found = []
        for line in text.splitlines():
            try:
                found.append(json.loads(line))
            except ValueError:
                continue
        return [line for line in found if outcome in (None, line["outcome"])]


def hash_of(path):
    files = sorted(each for each in path.rglob("*") if each.is_file()) or [path]
    return hashlib.sha256(b"|".join(file.read_bytes() for file in files)).hexdigest()


def outcomes(summary):
    """What became of each map, by its file name."""
    return {line.map.rpartition("/")[2]: str(line.outcome) for line in summary.maps}


def points_of(seed, count=150):
    """A map as bytes of a .npy file."""
    import io  # noqa: PLC0415

    stream = io.BytesIO()
    np.save(stream, np.random.default_rng(seed).uniform(size=(count, 3)) * [4, 3, 2])
    return stream.getvalue()


@pytest.fixture
def place_in(nothing_waits_for_the_disk):
    """Make a place in a folder."""
    return Place


@pytest.fixture
def place(tmp_path, place_in):
    return place_in(tmp_path)


@pytest.fixture
def real_place(place):
    place.cleaner = InThisProcess()
    return place


@pytest.fixture
def outcomes_of():
    return outcomes


@pytest.fixture
def map_bytes():
    return points_of
