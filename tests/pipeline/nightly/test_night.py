"""One night after the other, each map quickly copied instead of cleaned: what is done, and why."""

import errno
import json
import os

import pytest

from pipeline.errors import NightlyError
from pipeline.nightly.one_map import Ended
from pipeline.nightly.results import is_finished, remove_finished_work
from pipeline.replacing import RUN_FILE, STAGING
from pipeline.tiles import stages
from pipeline.work.folder import WORK_FOLDER

TINY = (
    "neighbours.k=8, clustering.count=2, ground.method=none, tiling.max_points=100, "
    "tiling.halo=0.3, execution.cluster=none, output.report=none"
)


class PowerCutError(BaseException):
    """Ends a night as a kill does: nothing that it would still have done is done."""


def test_what_is_new_is_cleaned_once(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    place.write("incoming/site/b.npy", "two")
    summary = place.night()
    assert outcomes_of(summary) == {"a.npy": "cleaned", "b.npy": "cleaned"}
    assert summary.exit_code == 0
    assert outcomes_of(place.night()) == {"a.npy": "unchanged", "b.npy": "unchanged"}
    assert sorted(place.cleaner.done) == [("a.npy", b"one"), ("b.npy", b"two")]


def test_maps_of_the_same_name_do_not_meet(place):
    first = place.write("incoming/a.npy", "one")
    second = place.write("incoming/site/a.npy", "two")
    third = place.write("incoming/site/a.copy.npy", "three")
    place.night()
    results = [
        (place.results(each).latest() / "static.npy").read_text() for each in (first, second, third)
    ]
    assert results == ["one", "two", "three"]


def test_a_folder_of_files_is_one_map(place, outcomes_of):
    place.write("surveys/north/1.npy", "one")
    place.write("surveys/north/2.npy", "two")
    (place.folder / "surveys/empty").mkdir()
    place.cleaner.before = lambda request: None
    place.cleaner._clean = lambda request: Ended("failed", "as asked")
    summary = place.night()
    assert outcomes_of(summary) == {"north": "failed"}
    assert place.cleaner.asked == ["north"]


def test_a_change_of_any_file_of_a_folder_is_seen(real_place, map_bytes, outcomes_of):
    place = real_place
    for name in ("1", "2"):
        place.write(f"surveys/north/{name}.npy", map_bytes(int(name), 60))
    assert outcomes_of(place.night()) == {"north": "cleaned"}
    assert outcomes_of(place.night()) == {"north": "unchanged"}
    place.write("surveys/north/3.npy", map_bytes(3, 60))
    assert outcomes_of(place.night()) == {"north": "cleaned"}
    (place.folder / "surveys/north/1.npy").rename(place.folder / "surveys/north/0.npy")
    assert outcomes_of(place.night()) == {"north": "cleaned"}, "results are named after the files"
    latest = place.results(place.folder / "surveys/north").latest()
    assert sorted(path.name for path in (latest / "static").iterdir()) == [
        "0.npy",
        "2.npy",
        "3.npy",
    ]


def poses(height):
    return "".join(f"1 0 0 {x} 0 1 0 0 0 0 1 {height}\n" for x in range(2))


@pytest.mark.parametrize("given", [False, True], ids=["beside the scans", "input.poses"])
def test_other_poses_make_another_map(real_place, map_bytes, outcomes_of, given):
    place = real_place
    for name in ("0", "1"):
        place.write("surveys/walk/poses.txt", poses(0))
        (place.folder / "surveys/walk/Scans").mkdir(exist_ok=True)
        (place.folder / f"surveys/walk/Scans/{name}.npy").write_bytes(map_bytes(int(name), 60))
    file = place.folder / ("told.txt" if given else "surveys/walk/poses.txt")
    file.write_text(poses(0))
    wanted = f"{TINY}, 'input.poses={file}'" if given else TINY
    place.source.write_text(
        f"inputs: [{{maps: surveys, each: folder, settings: [{wanted}]}}]\n"
        "output: cleaned\nsettle: 10 min\nwait: null\n"
    )
    assert outcomes_of(place.night()) == {"walk": "cleaned"}
    assert outcomes_of(place.night()) == {"walk": "unchanged"}
    file.write_text(poses(1))
    assert outcomes_of(place.night()) == {"walk": "cleaned"}
    latest = place.results(place.folder / "surveys/walk").latest()
    found = json.loads((latest / "run.json").read_text())["files"]
    assert [each["pose"][-1] for each in found] == [1.0, 1.0]
    assert outcomes_of(place.night()) == {"walk": "unchanged"}
    file.write_text(poses(0))
    assert outcomes_of(place.night()) == {"walk": "unchanged"}, "that result is still there"


def test_changed_content_is_cleaned_whatever_size_and_date_say(place, outcomes_of):
    path = place.write("incoming/a.npy", "one")
    before = path.stat()
    place.night()
    path.write_text("two")
    os.utime(path, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert path.stat().st_size == before.st_size
    assert path.stat().st_mtime_ns == before.st_mtime_ns
    assert outcomes_of(place.night()) == {"a.npy": "cleaned"}
    assert (place.results(path).latest() / "static.npy").read_text() == "two"


def test_a_new_date_alone_is_no_change(place, outcomes_of):
    path = place.write("incoming/a.npy", "one")
    place.night()
    os.utime(path, (1e9, 1e9))
    assert outcomes_of(place.night()) == {"a.npy": "unchanged"}
    assert len(place.cleaner.done) == 1


def test_unchanged_maps_are_not_read(place, monkeypatch):
    place.write("incoming/a.npy", "one")
    place.night()
    monkeypatch.setattr("pipeline.nightly.inventory.content_hash", None)
    assert place.night().exit_code == 0


def test_a_file_that_changed_just_before_it_was_hashed_is_hashed_again(place, monkeypatch):
    path = place.write("incoming/a.npy", "one")
    place.clock.time = path.stat().st_ctime + 1.5 - 86400
    place.night("settle=1 s")
    place.write("incoming/a.npy", "two")
    hashed = []
    true_hash = __import__("hashlib").sha256

    def spy(paths, advance=None):
        hashed.append(paths)
        return true_hash(paths[0].read_bytes()).hexdigest()

    monkeypatch.setattr("pipeline.nightly.inventory.content_hash", spy)
    place.night("settle=1 s")
    place.night("settle=1 s")
    assert len(hashed) == 1
    assert [content for _, content in place.cleaner.done] == [b"one", b"two"]


def test_content_that_comes_back_is_not_cleaned_again(place, outcomes_of):
    path = place.write("incoming/a.npy", "one")
    place.night()
    place.write("incoming/a.npy", "two")
    place.night()
    place.write("incoming/a.npy", "one")
    assert outcomes_of(place.night()) == {"a.npy": "unchanged"}
    assert (place.results(path).path / "latest" / "static.npy").read_text() == "one"


def test_another_configuration_is_another_result_and_other_tiles_are_not(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    place.night()
    inputs = "inputs=[{{maps: incoming, settings: [{}]}}]".format
    for settings, outcome in [
        (
            "neighbours.k=8, clustering.count=2, ground.method=none, tiling.max_points=7",
            "unchanged",
        ),
        ("neighbours.k=9, clustering.count=2, ground.method=none", "cleaned"),
        ("neighbours.k=9, clustering.count=2, ground.method=none, output.labels=true", "cleaned"),
        ("neighbours.k=8, clustering.count=2, ground.method=none", "unchanged"),
    ]:
        assert outcomes_of(place.night(inputs(settings))) == {"a.npy": outcome}, settings


def test_the_first_input_that_names_a_map_says_how_it_is_cleaned(place):
    place.write("incoming/a.npy", "one")
    place.write("incoming/b.npy", "two")
    seen = {}
    place.cleaner.before = lambda request: seen.update(
        {request.map.name: request.configuration.neighbours.k}
    )
    first = "{maps: incoming/a*, settings: [neighbours.k=5]}"
    place.night(f"inputs=[{first}, {{maps: incoming, settings: [neighbours.k=6]}}]")
    assert seen == {"a.npy": 5, "b.npy": 6}


def test_results_are_never_taken_for_maps(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    for _ in range(2):
        summary = place.night("inputs=[{maps: '**/*.npy'}]")
    assert outcomes_of(summary) == {"a.npy": "unchanged"}


def test_hidden_and_foreign_files_are_no_maps(place):
    for name in (".a.npy.x7Zq", "notes.txt", ".b.npy"):
        place.write(f"incoming/{name}", "x")
    assert place.night("inputs=[{maps: incoming}]").maps == []


def test_what_is_being_written_waits(place, outcomes_of):
    path = place.write("incoming/a.npy", "half")
    place.clock.time += 86400
    place.being_written(path)
    place.clock.time -= 86400
    summary = place.night()
    assert outcomes_of(summary) == {"a.npy": "waiting"}
    assert summary.exit_code == 0
    assert outcomes_of(place.night()) == {"a.npy": "cleaned"}


def test_a_night_waits_for_what_is_being_written_when_all_else_is_done(place, outcomes_of):
    growing = place.write("incoming/a.npy", "half")
    place.write("incoming/b.npy", "two")
    place.clock.time += 86400
    place.being_written(growing)
    place.clock.time -= 86400
    begun = place.clock.time
    assert outcomes_of(place.night("wait=30 min")) == {"a.npy": "cleaned", "b.npy": "cleaned"}
    assert place.cleaner.asked == ["b.npy", "a.npy"]
    assert 540 <= place.clock.time - begun - 86400 <= 700


def test_it_does_not_wait_for_ever(place, outcomes_of):
    path = place.write("incoming/a.npy", "half")
    sleep = place.clock.sleep

    def growing(seconds):
        sleep(seconds)
        place.being_written(path)

    place.clock.sleep = growing
    place.clock.time += 86400
    place.being_written(path)
    place.clock.time -= 86400
    begun = place.clock.time
    assert outcomes_of(place.night("wait=30 min")) == {"a.npy": "waiting"}
    assert 1790 <= place.clock.time - begun - 86400 <= 1840


def test_a_date_in_the_future_does_not_make_a_file_wait(place, outcomes_of):
    path = place.write("incoming/a.npy", "one")
    os.utime(path, (4e9, 4e9))
    assert outcomes_of(place.night()) == {"a.npy": "cleaned"}


def test_a_night_waits_for_a_file_from_a_clock_that_was_ahead(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    place.clock.time -= 20 * 86400
    assert outcomes_of(place.night("wait=30 min")) == {"a.npy": "cleaned"}


def test_a_clock_that_is_set_back_makes_nothing_be_cleaned_again(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    place.night()
    place.clock.time -= 20 * 86400
    for _ in range(3):
        assert outcomes_of(place.night())["a.npy"] in ("waiting", "unchanged")
    assert len(place.cleaner.done) == 1


def test_a_map_that_changes_while_it_is_cleaned_is_not_published_as_the_new_one(place, outcomes_of):
    path = place.write("incoming/a.npy", "one")

    def meddle(request):
        path.write_text("two")
        place.being_written(path)

    place.cleaner.before = meddle
    summary = place.night()
    assert outcomes_of(summary) == {"a.npy": "waiting"}
    assert summary.exit_code == 0
    assert place.results(path).latest() is None
    place.cleaner.before = lambda request: None
    assert outcomes_of(place.night()) == {"a.npy": "cleaned"}
    assert (place.results(path).latest() / "static.npy").read_text() == "two"


def test_a_map_that_is_written_anew_before_its_turn_waits_until_it_is_complete(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    later = place.write("incoming/b.npy", "two")

    def meddle(request):
        later.write_text("hal")
        place.being_written(later)

    place.cleaner.before = meddle
    assert outcomes_of(place.night()) == {"a.npy": "cleaned", "b.npy": "waiting"}
    assert place.cleaner.asked == ["a.npy"]
    place.cleaner.before = lambda request: None
    assert outcomes_of(place.night()) == {"a.npy": "unchanged", "b.npy": "cleaned"}


def test_a_map_that_changes_after_it_was_cleaned_is_cleaned_as_what_it_was(place, outcomes_of):
    path = place.write("incoming/a.npy", "one")
    place.cleaner.after = lambda request: (path.write_text("two"), place.being_written(path))
    place.night()
    assert (place.results(path).latest() / "static.npy").read_text() == "one"
    place.cleaner.after = lambda request: None
    assert outcomes_of(place.night()) == {"a.npy": "cleaned"}
    assert (place.results(path).latest() / "static.npy").read_text() == "two"


def test_a_failing_map_is_tried_some_nights_and_set_aside(place, outcomes_of):
    place.write("incoming/bad.npy", "corrupt")
    place.write("incoming/good.npy", "one")
    seen = [place.night() for _ in range(4)]
    assert [outcomes_of(each)["bad.npy"] for each in seen] == [
        "failed", "failed", "set aside", "set aside",
    ]  # fmt: skip
    assert [each.exit_code for each in seen] == [4, 4, 0, 0]
    assert place.cleaner.asked.count("bad.npy") == 2
    assert "set aside after 2 nights" in seen[1].maps[0].reason
    assert seen[3].maps[0].reason == "it is corrupt"


def test_a_new_content_is_tried_though_the_old_was_set_aside(place, outcomes_of):
    path = place.write("incoming/bad.npy", "corrupt")
    for _ in range(3):
        place.night()
    path.write_text("corrupt as well")
    assert outcomes_of(place.night()) == {"bad.npy": "failed"}
    path.write_text("good")
    assert outcomes_of(place.night()) == {"bad.npy": "cleaned"}


def test_retry_forgets_what_was_set_aside(place, outcomes_of):
    place.write("incoming/bad.npy", "corrupt")
    for _ in range(3):
        place.night()
    assert outcomes_of(place.night(retry=True)) == {"bad.npy": "failed"}


def test_another_version_tries_what_was_set_aside(place, outcomes_of, monkeypatch):
    place.write("incoming/bad.npy", "corrupt")
    for _ in range(3):
        place.night()
    for module in ("inventory", "night"):
        monkeypatch.setattr(f"pipeline.nightly.{module}.version", lambda name: "99")
    assert outcomes_of(place.night()) == {"bad.npy": "failed"}


def test_a_failing_map_is_not_tried_twice_in_a_night_and_goes_last(place):
    place.write("incoming/bad.npy", "corrupt")
    place.night()
    place.write("incoming/z.npy", "one")
    place.cleaner.asked.clear()
    place.night("wait=1 h")
    assert place.cleaner.asked == ["z.npy", "bad.npy"]


def test_a_map_whose_bytes_cannot_be_read_is_set_aside_too(place, outcomes_of, monkeypatch):
    path = place.write("incoming/a.npy", "one")

    def broken(paths, advance=None):
        raise OSError(5, "Input/output error", str(path))

    with monkeypatch.context() as patch:
        patch.setattr("pipeline.nightly.inventory.content_hash", broken)
        seen = [place.night() for _ in range(3)]
    assert [outcomes_of(each)["a.npy"] for each in seen] == ["failed", "failed", "set aside"]
    assert seen[0].maps[0].reason == f"{path}: Input/output error"
    assert outcomes_of(place.night(retry=True)) == {"a.npy": "cleaned"}


def test_a_map_that_vanishes_keeps_its_results_and_may_come_back(place, outcomes_of):
    path = place.write("incoming/a.npy", "one")
    place.night()
    path.unlink()
    for _ in range(2):
        summary = place.night()
        assert outcomes_of(summary) == {"a.npy": "vanished"}
        assert summary.exit_code == 0
    assert [line["outcome"] for line in place.lines()] == ["cleaned", "vanished"]
    assert summary.maps[0].report
    assert (place.results(path).latest() / "static.npy").read_text() == "one"
    place.write("incoming/a.npy", "one")
    assert outcomes_of(place.night()) == {"a.npy": "unchanged"}


def test_a_map_that_vanishes_during_the_night_is_no_failure(place, outcomes_of):
    first = place.write("incoming/a.npy", "one")
    place.write("incoming/b.npy", "two")
    place.cleaner.before = lambda request: first.unlink(missing_ok=True)
    place.cleaner._clean = lambda request: Ended("failed", "no such file")
    summary = place.night()
    assert outcomes_of(summary) == {"a.npy": "vanished", "b.npy": "failed"}
    assert [line["map"] for line in place.lines("failed")] == [str(place.incoming / "b.npy")]


def test_a_map_that_vanishes_before_its_turn_is_no_failure(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    later = place.write("incoming/b.npy", "two")
    place.cleaner.before = lambda request: later.unlink()
    summary = place.night()
    assert outcomes_of(summary) == {"a.npy": "cleaned", "b.npy": "vanished"}
    assert summary.exit_code == 0
    assert [line["map"] for line in place.lines()] == [str(place.incoming / "a.npy"), str(later)]


def test_an_input_that_is_not_there_is_said_and_nothing_vanishes(place, outcomes_of):
    path = place.write("incoming/a.npy", "one")
    place.night()
    place.incoming.rename(place.folder / "elsewhere")
    summary = place.night()
    assert summary.problems == [f"{place.incoming}: no such file or folder"]
    assert summary.exit_code == 4
    assert summary.maps == []
    (place.folder / "elsewhere").rename(place.incoming)
    assert outcomes_of(place.night()) == {"a.npy": "unchanged"}
    assert is_finished(place.results(path).latest())


def test_the_night_ends_in_time_and_the_rest_is_the_next_one_s(place, outcomes_of):
    for name in "abc":
        place.write(f"incoming/{name}.npy", name)
    place.cleaner.after = lambda request: place.clock.sleep(3600)
    summary = place.night("stop_after=90 min")
    assert outcomes_of(summary) == {"a.npy": "cleaned", "b.npy": "cleaned", "c.npy": "left"}
    assert (summary.ended, summary.exit_code) == ("time", 0)
    summary = place.night("stop_after=90 min")
    assert outcomes_of(summary) == {"a.npy": "unchanged", "b.npy": "unchanged", "c.npy": "cleaned"}
    assert summary.ended == "done"
    assert len(place.cleaner.done) == 3


def test_a_map_that_comes_no_step_further_in_whole_nights_is_set_aside(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    place.write("incoming/b.npy", "two")

    def too_long(request):
        place.clock.sleep(7200)
        return Ended("stopped")

    quick = place.cleaner._clean
    place.cleaner._clean = lambda request: (too_long if request.map.stem == "a" else quick)(request)
    seen = [outcomes_of(place.night("stop_after=1 h")) for _ in range(4)]
    assert [each["a.npy"] for each in seen] == ["failed", "stopped", "failed", "set aside"]
    assert seen[0]["b.npy"] == "left"
    assert seen[1]["b.npy"] == "cleaned", "others go first now, and a had no whole night"


def test_there_must_be_space_before_a_map_is_begun(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    for _ in range(3):
        summary = place.night("keep_free=9000 TiB")
        assert outcomes_of(summary) == {"a.npy": "no space"}
        assert summary.exit_code == 4
        assert "9000.0 TiB are to stay so" in summary.maps[0].reason
    assert place.cleaner.asked == []
    assert outcomes_of(place.night()) == {"a.npy": "cleaned"}, "and it is no failure of the map"


def test_space_found_wanting_by_the_plan_of_a_run_is_no_failure_of_the_map(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    place.cleaner._clean = lambda request: Ended("no space", "too little")
    assert [outcomes_of(place.night())["a.npy"] for _ in range(3)] == ["no space"] * 3


@pytest.mark.parametrize("tiles", [False, True])
def test_a_disk_that_others_fill_meanwhile_is_no_failure_of_the_map(
    real_place, map_bytes, outcomes_of, monkeypatch, tiles
):
    def full(*_, **__):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "somewhere")

    place = real_place
    path = place.write("incoming/a.npy", map_bytes(1, 150 if tiles else 90))
    in_this_process = f"inputs=[{{maps: incoming, settings: [{TINY}]}}]"
    with monkeypatch.context() as patch:
        if tiles:
            patch.setitem(stages.TASKS, "density", full)
        else:
            patch.setattr("pipeline.in_memory.write_maps", full)
        summary = place.night(in_this_process)
    assert outcomes_of(summary) == {"a.npy": "no space"}
    assert "No space left on device" in summary.maps[0].reason
    assert summary.exit_code == 4
    assert place.results(path).latest() is None
    assert outcomes_of(place.night(in_this_process)) == {"a.npy": "cleaned"}


def test_a_killed_night_goes_on_and_nothing_is_done_twice(place, monkeypatch):
    """Kill a night after each of its steps on the disk, one step further each time."""
    from pipeline.nightly import journal, minutes, results  # noqa: PLC0415

    steps = {"left": 0}

    def cut_before(owner, name):
        true_step = getattr(owner, name)

        def step(*arguments):
            steps["left"] -= 1
            if steps["left"] < 0:
                raise PowerCutError
            return true_step(*arguments)

        monkeypatch.setattr(owner, name, step)

    cut_before(journal.Journal, "save")
    cut_before(minutes, "append_line")
    cut_before(minutes.NightSummary, "write")
    cut_before(results.MapFolder, "point_latest")
    cut_before(results.MapFolder, "remove")
    written = set()
    for number in range(60):
        for name in "ab":
            content = f"{name} {number}"
            written.add((f"{name}.npy", content.encode()))
            place.write(f"incoming/{name}.npy", content)
        if number % 3 == 0:
            place.write("incoming/bad.npy", f"corrupt {number}")
        steps["left"] = number
        try:
            place.night("keep={runs: 1, days: 0}")
            cut = False
        except PowerCutError:
            cut = True
        steps["left"] = 1000
        place.night("keep={runs: 1, days: 0}")
        if not cut:
            break
    assert not cut, "a night has fewer steps"
    assert number > 10
    assert sorted(place.cleaner.done) == sorted(written), "nothing lost, nothing cleaned twice"
    said = [(line["map"], line["run"]) for line in place.lines("cleaned")]
    assert len(said) == len(set(said)) == len(written)
    for name in "ab":
        runs = place.results(place.incoming / f"{name}.npy").runs()
        assert [(run / "static.npy").read_text() for run in runs] == [f"{name} {number}"]


def test_without_its_journal_finished_results_are_found(place, outcomes_of):
    place.write("incoming/a.npy", "one")
    place.night()
    (place.output / ".nightly" / "journal.json").unlink()
    assert outcomes_of(place.night()) == {"a.npy": "unchanged"}


def test_a_journal_that_cannot_be_read_is_said_and_kept(place):
    place.night()
    journal = place.output / ".nightly" / "journal.json"
    for text in ("{", '{"format": 2}', '{"format": 1, "mops": {}}'):
        journal.write_text(text)
        with pytest.raises(NightlyError, match=r"journal.json: expected a journal") as error:
            place.night()
        assert "\n" not in str(error.value)
        assert journal.read_text() == text


def test_a_result_that_was_taken_away_is_made_again(place, outcomes_of):
    path = place.write("incoming/a.npy", "one")
    place.night()
    place.results(path).remove(place.results(path).latest())
    assert outcomes_of(place.night()) == {"a.npy": "cleaned"}


def test_every_map_has_a_line_every_night_even_after_one_that_was_cut_off(place):
    place.write("incoming/a.npy", "one")
    place.write("incoming/bad.npy", "corrupt")
    place.night()
    with (place.output / "nightly.jsonl").open("a") as stream:
        stream.write('{"night": "20')
    place.night()
    assert [line["outcome"] for line in place.lines()] == [
        "cleaned", "failed", "failed", "unchanged",
    ]  # fmt: skip
    first = place.lines()[0]
    assert (first["points"], first["removed"]) == (3, 1)
    assert (place.output / first["report"]).is_file()


def test_the_summary_says_what_the_lines_say(place):
    place.write("incoming/a.npy", "one")
    place.write("incoming/bad.npy", "corrupt")
    place.night()
    summary = json.loads((place.output / "nightly.json").read_text())
    assert summary["counts"] == {"cleaned": 1, "failed": 1}
    assert (summary["ended"], summary["exit_code"]) == ("done", 4)
    assert [line["map"].rpartition("/")[2] for line in summary["maps"]] == ["a.npy", "bad.npy"]


def test_while_a_night_lasts_its_summary_says_so(place):
    place.write("incoming/a.npy", "one")
    seen = []
    place.cleaner.before = lambda request: seen.append(
        json.loads((place.output / "nightly.json").read_text())
    )
    place.night()
    assert (seen[0]["ended"], seen[0]["finished"]) == ("running", None)


def test_a_name_that_is_not_text_is_said(place):
    try:
        (place.incoming / os.fsdecode(b"caf\xe9.npy")).write_bytes(b"one")
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    place.write("incoming/a.npy", "one")
    summary = place.night()
    assert summary.problems == [f"{place.incoming}/caf\\xe9.npy: its name is not UTF-8"]
    assert [line.outcome for line in summary.maps] == ["cleaned"]


@pytest.mark.parametrize("keep_work", [False, True])
def test_a_run_that_was_killed_as_it_ended_leaves_nothing_hidden(tmp_path, keep_work):
    report = {"configuration": {"output": {"keep_work": keep_work}}}
    (tmp_path / RUN_FILE).write_text(json.dumps(report))
    for name in (STAGING, WORK_FOLDER):
        (tmp_path / name).mkdir()
        (tmp_path / name / "file").write_text("left")
    remove_finished_work(tmp_path)
    expected = {RUN_FILE, WORK_FOLDER} if keep_work else {RUN_FILE}
    assert {path.name for path in tmp_path.iterdir()} == expected
