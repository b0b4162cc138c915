"""Progress: seconds are kept by stage, and a log gets plain lines."""

import logging
from io import StringIO

import pytest

from pipeline import progress
from pipeline.commands.app import StandardErrorHandler
from pipeline.progress import LogDisplay, StageObserver, TerminalDisplay, watching


class Clock:
    def __init__(self, monkeypatch):
        self.now = 100.0
        monkeypatch.setattr(progress, "monotonic", lambda: self.now)


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


def test_seconds_are_added_up_by_stage(clock):
    observer = StageObserver(LogDisplay())
    for stage, seconds in [("reading", 2.0), ("density", 5.0), ("reading", 1.0)]:
        observer.stage(stage, 10)
        clock.now += seconds
    observer.finish()
    observer.finish()
    assert observer.seconds == {"reading": 3.0, "density": 5.0}


def test_a_log_gets_lines_now_and_then_with_rate_and_time_left(clock, caplog):
    caplog.set_level(logging.INFO, "dynahull")
    observer = StageObserver(LogDisplay())
    observer.stage("density", 1000)
    for _ in range(30):
        clock.now += 1.0
        observer.advance(20)
    observer.finish()
    lines = [record.message for record in caplog.records]
    assert lines[0] == "density: 1,000 points"
    assert lines[1] == "density: 20 %, 20 points/s, 40 s left"
    assert lines[-1] == "density: done in 30.0 s"
    assert len(lines) == 5


def test_the_time_that_compiling_took_foretells_nothing(clock, caplog):
    caplog.set_level(logging.INFO, "dynahull")
    display = LogDisplay()
    display.begin("density", 1000)
    for done in (20, 40):
        clock.now += 20.0
        display.update(done)
    assert caplog.messages[1:] == ["density: 2 %", "density: 4 %, 1 points/s, 960 s left"]


def test_a_stage_of_no_points_divides_by_nothing(clock, caplog):
    caplog.set_level(logging.INFO, "dynahull")
    display = LogDisplay()
    display.begin("reading", 0)
    clock.now += 60
    display.update(0)
    display.update(3)
    display.end()
    assert "100 %" in caplog.text


def test_warnings_are_kept_and_logged(caplog):
    observer = StageObserver(LogDisplay())
    observer.warn("cluster 3 is empty")
    assert observer.warnings == ["cluster 3 is empty"]
    assert "cluster 3 is empty" in caplog.text


def test_without_a_terminal_there_is_no_bar(capsys):
    with watching() as observer:
        observer.stage("reading", 5)
        observer.advance(5)
    assert "\x1b" not in capsys.readouterr().err


def test_a_log_line_goes_to_whatever_standard_error_is(monkeypatch):
    handler = StandardErrorHandler()
    for screen in (StringIO(), StringIO()):
        monkeypatch.setattr("sys.stderr", screen)
        handler.emit(logging.makeLogRecord({"msg": "compiling"}))
        assert screen.getvalue() == "compiling\n"


def test_the_bar_survives_stages_of_any_size(capsys):
    display = TerminalDisplay()
    observer = StageObserver(display)
    for total in (0, 10):
        observer.stage("density", total)
        observer.advance(total)
        observer.finish()
    display.close()
    assert "density" in capsys.readouterr().err


def test_the_bar_of_a_stage_that_told_nothing_is_full_in_the_end():
    display = TerminalDisplay()
    observer = StageObserver(display)
    for total in (0, 10):
        observer.stage("rescale", total)
        observer.finish()
    display.close()
    assert [task.percentage for task in display._progress.tasks] == [100, 100]
