"""What only shows results fails no run: it warns, and the results are whole."""

import json

import numpy as np
import pytest

from pipeline import planning, progress
from pipeline import run as run_module
from pipeline.configuration.run import load_configuration
from pipeline.evaluation import evaluation
from pipeline.evaluation.inputs import EvaluationOptions
from pipeline.evaluation.report import evaluate_files
from pipeline.planning import plan_map
from pipeline.progress import LogDisplay, StageObserver, watching
from pipeline.report_page.charts import Axis
from pipeline.report_page.report_page import Views
from pipeline.run import run
from tests.pipeline.test_nothing_overwritten import FAST, TILED, save

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")


def clean(given, output, *settings):
    observer = StageObserver(LogDisplay())
    return run([str(given)], output, load_configuration(None, settings), observer)


def broken(*_, **__):
    raise ValueError("nothing is shown today")


@pytest.mark.parametrize("settings", [FAST, TILED])
@pytest.mark.parametrize("place", ["views", "page"])
def test_a_run_without_its_report_is_whole(tmp_path, monkeypatch, settings, place):
    given = save(tmp_path / "map.npy")
    if place == "views":
        monkeypatch.setattr(Views, "of", broken)
    else:
        monkeypatch.setattr(run_module, "render_page", broken)
    settings = [*settings, "removal.decision=paper"]
    report = clean(given, tmp_path / "out", *settings)
    stored = json.loads((tmp_path / "out/run.json").read_text())
    assert "report.html" not in stored["outputs"]
    assert any("report.html could not be made" in each for each in stored["warnings"])
    assert "report.html" not in report.summary()
    assert not (tmp_path / "out/report.html").exists()
    assert len(np.load(tmp_path / "out/static.npy")) < 400
    monkeypatch.undo()
    clean(given, tmp_path / "out", *settings)
    assert (tmp_path / "out/report.html").is_file()


@pytest.mark.parametrize("settings", [FAST, TILED[:-2]])
@pytest.mark.parametrize("scale", [1e104, 1e102, 1e-100])
@pytest.mark.parametrize("decision", ["paper", "auto"])
def test_densities_that_underflow_are_drawn(tmp_path, settings, scale, decision):
    """k neighbours in more than 1e308 cubic metres have a density of zero."""
    points = np.random.default_rng(0).normal(size=(400, 3)) * scale
    np.save(tmp_path / "map.npy", points)
    settings = [*settings, f"removal.decision={decision}"]
    report = clean(tmp_path / "map.npy", tmp_path / "out", *settings)
    page = (tmp_path / "out/report.html").read_text(encoding="utf-8")
    assert "could not be made" not in str(report.warnings)
    for wrong in (">nan", ">inf", '"nan', '"inf', "NaN", "Infinity"):
        assert wrong not in page.split("<script>")[0]


def test_an_axis_of_no_finite_limits_is_named():
    for low, high in ((-np.inf, 1), (0, np.inf), (np.nan, 1)):
        with pytest.raises(ValueError, match="an axis of finite limits"):
            Axis(low, high, 0, 100).ticks()


def test_a_plan_without_its_picture_is_printed(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    given = save(tmp_path / "map.npy")
    monkeypatch.setattr(planning, "draw_plan", broken)
    observer = StageObserver(LogDisplay())
    text, _ = plan_map(
        [str(given)], load_configuration(None, FAST), observer, tmp_path / "plan.png"
    )
    assert "drawn" not in text
    assert "400" in text
    assert "plan.png could not be made" in observer.warnings[0]


def test_an_evaluation_without_its_picture_has_its_figures(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    given = save(tmp_path / "map.npy")
    clean(given, tmp_path / "out", *FAST)
    monkeypatch.setattr(evaluation, "draw_picture", broken)
    report = evaluate_files(
        str(tmp_path / "out"),
        str(tmp_path / "out/static.npy"),
        str(given),
        EvaluationOptions(),
        picture=tmp_path / "all.png",
    )
    assert any("all.png could not be made" in each for each in report.warnings)
    assert report.confusion is not None


class BrokenDisplay:
    begin = update = end = close = broken


def test_progress_that_cannot_be_shown_is_warned_of_once(caplog):
    observer = StageObserver(BrokenDisplay())
    for stage in ("one", "two"):
        observer.stage(stage, 10)
        observer.advance(5)
    observer.finish()
    assert list(observer.seconds) == ["one", "two"]
    assert caplog.text.count("nothing is shown today") == 1


def test_a_bar_that_cannot_be_made_ends_no_command(monkeypatch, caplog):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    monkeypatch.setattr(progress, "TerminalDisplay", broken)
    caplog.set_level("INFO")
    with watching() as observer:
        observer.stage("one", 10)
        observer.advance(10)
    assert "bar of progress" in caplog.text
