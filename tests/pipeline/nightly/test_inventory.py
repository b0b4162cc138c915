"""Maps and folders that may not be read: they are said, and do not count as gone."""

import os
import shutil
import tempfile
from pathlib import Path

import pytest

from pipeline.nightly.inventory import find_maps, learn_content
from pipeline.nightly.one_map import Ended

NOBODY = 65534


@pytest.fixture
def place(place_in, monkeypatch):
    """A place that is looked at without root's right to read everything."""

    def as_nobody(function):
        def called(*arguments):
            earlier = os.geteuid()
            if earlier == 0:
                os.seteuid(NOBODY)
            try:
                return function(*arguments)
            finally:
                os.seteuid(earlier)

        return called

    for function in (find_maps, learn_content):
        monkeypatch.setattr(f"pipeline.nightly.night.{function.__name__}", as_nobody(function))
    # `tmp_path` lies below a folder that nobody else may enter.
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    try:
        yield place_in(folder)
    finally:
        shutil.rmtree(folder)


@pytest.mark.parametrize("mode", [0o000, 0o444])
@pytest.mark.parametrize("maps", ["incoming", "incoming/*.npy", "incoming/**/*.npy"])
def test_a_folder_that_may_not_be_read_is_said_and_others_are_cleaned(
    place, maps, mode, outcomes_of
):
    place.write("incoming/a.npy", "one")
    place.write("other/b.npy", "two")
    inputs = f"inputs=[{{maps: {maps}}}, {{maps: other}}]"
    place.night(inputs)
    place.write("other/b.npy", "three")
    place.incoming.chmod(mode)
    summary = place.night(inputs)
    place.incoming.chmod(0o755)
    assert [problem.partition(": ")[2] for problem in summary.problems] == ["Permission denied"]
    assert summary.problems[0].startswith(str(place.incoming))
    assert outcomes_of(summary) == {"b.npy": "cleaned"}, "and nothing vanished"
    assert summary.exit_code == 4
    assert outcomes_of(place.night(inputs)) == {"a.npy": "unchanged", "b.npy": "unchanged"}


@pytest.mark.parametrize(
    ("maps", "each"),
    [("incoming/**/*.npy", "file"), ("incoming/*/*.npy", "file"), ("incoming", "folder")],
)
def test_a_folder_within_that_may_not_be_read_is_said_too(place, maps, each, outcomes_of):
    for name in ("open", "closed"):
        place.write(f"incoming/{name}/{name}.npy", name)
    inputs = f"inputs=[{{maps: '{maps}', each: {each}}}]"
    place.cleaner._clean = lambda request: Ended("failed", "whatever")
    before = outcomes_of(place.night(inputs, "attempts=9"))
    assert len(before) == 2
    closed = place.incoming / "closed"
    closed.chmod(0)
    summary = place.night(inputs, "attempts=9")
    closed.chmod(0o755)
    assert summary.problems == [f"{closed}: Permission denied"]
    assert [each for each in outcomes_of(summary) if each.startswith("closed")] == []
    assert [each for each in outcomes_of(summary) if each.startswith("open")] != []
    assert len(outcomes_of(place.night(inputs, "attempts=9"))) == 2


def test_a_map_that_may_not_be_read_has_failed(place, outcomes_of):
    path = place.write("incoming/a.npy", "one")
    path.chmod(0)
    seen = [place.night() for _ in range(3)]
    assert [outcomes_of(each)["a.npy"] for each in seen] == ["failed", "failed", "set aside"]
    assert seen[0].maps[0].reason == f"{path}: Permission denied"
    path.chmod(0o644)
    assert outcomes_of(place.night()) == {"a.npy": "cleaned"}
