"""Nights and runs as real processes, and what happens when they are stopped or killed."""

import json
import os
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from pipeline.nightly import one_map
from pipeline.nightly.one_map import Cleaner
from pipeline.nightly.results import tasks_done
from pipeline.outputs.folder_lock import folder_is_locked, locked_folder

pytestmark = pytest.mark.linux_only

COMMAND = [sys.executable, "-c", "from pipeline.commands.app import main; main()", "nightly"]
PATIENCE = 300.0
"""Seconds that nothing here takes but on a machine that is very busy."""


def wait_until(condition, process=None):
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until, "waited in vain"
        assert process is None or process.poll() is None, "it ended before it could be disturbed"
        time.sleep(0.01)


def night(place, *arguments):
    command = [*COMMAND, str(place.source), "--set", "settle=1 s", *arguments]
    return subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=place.folder
    )


def ended(process):
    """Exit code and log of a night."""
    out, log = process.communicate(timeout=PATIENCE)
    assert out == ""
    return process.returncode, log


def settled(path):
    """Wait until a file that was just written counts as complete."""
    time.sleep(max(0.0, path.stat().st_ctime + 1.1 - time.time()))


def run_of(place, path):
    """The folder of the only run of a map, None before it begins."""
    runs = place.results(path).runs()
    return runs[0] if runs else None


def is_half_done(place, path):
    run = run_of(place, path)
    return run is not None and tasks_done(run) >= 10


def markers(run):
    """When each task was done; what is written is written anew by a run that goes on."""
    times = {}
    with suppress(FileNotFoundError):  # all of them go when the run is complete
        for path in (run / ".dynahull-work").glob("*/*.done"):
            if path.parent.name != "write":
                times[path] = path.stat().st_mtime_ns
    return times


def test_a_quiet_night_tells_of_what_failed_alone(place, map_bytes):
    place.write("incoming/a.npy", map_bytes(1, 90))
    settled(place.write("incoming/bad.npy", "no map"))
    code, log = ended(night(place, "-q"))
    assert code == 4
    assert " INFO " not in log
    assert log.splitlines()[-1].endswith("1 cleaned, 1 failed; failed: bad.npy")


def test_the_command_cleans_skips_and_fails_with_its_exit_codes(place, map_bytes):
    place.write("incoming/a.npy", map_bytes(1, 90))
    settled(place.write("incoming/bad.npy", b"corrupt"))
    code, log = ended(night(place))
    assert code == 4
    assert "\x1b" not in log, "no colours"
    assert "\r" not in log, "no bars"
    assert "1 cleaned, 1 failed" in log
    (place.incoming / "bad.npy").unlink()
    code, log = ended(night(place))
    assert (code, "1 unchanged" in log) == (0, True)
    with locked_folder(place.output / ".nightly"):
        code, log = ended(night(place))
    assert code == 75
    assert "another night is writing into this folder" in log
    assert len(log.splitlines()) == 1


def test_a_wrong_file_is_one_line_and_code_2(place):
    place.source.write_text("inputs: [{maps: incoming, configuration: nowhere}]\noutput: cleaned\n")
    code, log = ended(night(place))
    assert code == 2
    assert len(log.splitlines()) == 1
    assert "nowhere: expected a YAML file or one of the ready configurations" in log
    assert not place.output.exists()


def test_a_folder_that_cannot_be_written_is_one_line_that_names_it(place):
    place.output.write_text("a file where the folder should be")
    code, log = ended(night(place))
    assert code == 1
    assert log.startswith(f"error: {place.output}")
    assert len(log.splitlines()) == 1


def test_a_night_that_is_stopped_leaves_work_that_goes_on(place, map_bytes):
    path = place.write("incoming/a.npy", map_bytes(1, 4000))
    settled(path)
    process = night(place)
    wait_until(lambda: is_half_done(place, path), process)
    process.send_signal(signal.SIGTERM)
    code, log = ended(process)
    assert code == 130, log
    assert "1 stopped; stopped by a signal" in log
    run = run_of(place, path)
    done = markers(run)
    assert len(done) >= 10
    assert json.loads((place.output / "nightly.json").read_text())["ended"] == "signal"
    process = night(place)
    while process.poll() is None:
        now = markers(run)
        assert {path: now[path] for path in done if path in now}.items() <= done.items()
        time.sleep(0.02)
    code, log = ended(process)
    assert code == 0, log
    assert run_of(place, path) == run
    assert not (run / ".dynahull-work").exists()


def test_a_night_whose_time_is_over_stops_its_run_and_the_next_goes_on(
    place, map_bytes, monkeypatch, outcomes_of
):
    """Time passes when work is done: the night is over when ten tasks are."""
    monkeypatch.setattr(one_map, "_LOOK_EVERY", 0.05)
    path = place.write("incoming/a.npy", map_bytes(1, 4000))
    place.cleaner = Cleaner()
    place.clock.monotonic = lambda: 3600.0 if is_half_done(place, path) else 0.0
    summary = place.night("stop_after=1 h")
    assert outcomes_of(summary) == {"a.npy": "stopped"}
    assert (summary.ended, summary.exit_code) == ("time", 0)
    run = run_of(place, path)
    done = markers(run)
    assert len(done) >= 10
    assert not folder_is_locked(run)
    seen = []
    place.clock.monotonic = lambda: seen.append(markers(run)) or 0.0
    assert outcomes_of(place.night("stop_after=1 h")) == {"a.npy": "cleaned"}
    assert done.items() <= seen[1].items(), "no finished task was done again"
    assert run_of(place, path) == run


def test_a_run_that_is_killed_fails_and_the_night_goes_on(place, map_bytes):
    for name in ("a", "b"):
        path = place.write(f"incoming/{name}.npy", map_bytes(1, 4000))
    settled(path)
    process = night(place)
    first = place.incoming / "a.npy"
    wait_until(lambda: is_half_done(place, first), process)
    os.kill(child_of(process.pid), signal.SIGKILL)
    code, log = ended(process)
    assert code == 4
    assert "1 cleaned, 1 failed" in log
    assert place.lines("failed")[0]["reason"].startswith("its process was ended by SIGKILL")
    code, log = ended(night(place))
    assert (code, "1 cleaned, 1 unchanged" in log) == (0, True)


def test_what_a_killed_night_started_does_not_outlive_it(place, map_bytes):
    path = place.write("incoming/a.npy", map_bytes(1, 4000))
    settled(path)
    process = night(place)
    wait_until(lambda: is_half_done(place, path), process)
    child = child_of(process.pid)
    process.kill()
    process.communicate()
    wait_until(lambda: not is_running(child))
    run = run_of(place, path)
    wait_until(lambda: not folder_is_locked(run))  # workers may end a moment later
    assert not (run / "run.json").exists(), "it stopped at once, and did not finish"


def child_of(number):
    """The only child of a process."""
    tasks = Path(f"/proc/{number}/task").iterdir()
    (child,) = (each for task in tasks for each in (task / "children").read_text().split())
    return int(child)


def is_running(number):
    try:
        state = Path(f"/proc/{number}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return False
    return state != "Z"
