"""Names that are not UTF-8, and locales that are not: as good as any others, to the very end."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from pipeline.configuration.run import load_configuration
from pipeline.evaluation.inputs import EvaluationOptions
from pipeline.evaluation.report import evaluate_files
from pipeline.info import inspect_map
from pipeline.planning import tile_map
from pipeline.preview import WHOLE, preview
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.showing import printable
from tests.pipeline.test_nothing_overwritten import FAST, FORMATS, TILED, map_of, save

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

ODD = os.fsdecode(b"h\xf6hle\xff")
"""Latin-1, as old archives have it."""

LOCALES = {
    "C": {"LC_ALL": "C"},
    "POSIX, ascii": {"LC_ALL": "POSIX", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"},
    "ascii streams": {"LC_ALL": "C.UTF-8", "PYTHONIOENCODING": "ascii"},
    "strict ascii streams": {"LC_ALL": "C.UTF-8", "PYTHONIOENCODING": "ascii:strict"},
    "UTF-8": {"LC_ALL": "C.UTF-8"},
}


def observer():
    return StageObserver(LogDisplay())


def clean(maps, output, *settings):
    return run(maps, output, load_configuration(None, settings), observer())


@pytest.fixture
def odd_folder(tmp_path):
    try:
        (tmp_path / ODD).mkdir()
    except OSError:
        pytest.skip("this file system takes UTF-8 names only")
    return tmp_path / ODD


@pytest.mark.parametrize("settings", [FAST, TILED])
def test_a_run_of_odd_names_is_whole_and_found_again(odd_folder, settings):
    maps = [save(odd_folder / f"{name}{ODD}.npy", seed=seed) for seed, name in enumerate("ab")]
    output = odd_folder / "out"
    report = clean(maps, output, *settings, "output.labels=true")
    assert (output / f"static/a{ODD}.npy").is_file()
    page = (output / "report.html").read_text(encoding="utf-8")
    assert "h\\xf6hle\\xff" in page
    assert "h\\xf6hle\\xff" in report.summary()
    stored = json.loads((output / "run.json").read_text())
    assert stored["files"][0]["path"] == str(maps[0].resolve())
    figures = evaluate_files(str(output), str(maps[0]), None, EvaluationOptions(emd_points=0))
    json.loads(figures.to_json())
    clean(maps, output, *settings, "output.labels=false")  # its own are known, and replaced
    assert not (output / "labels.parquet").exists()


@pytest.mark.parametrize("suffix", FORMATS)
def test_every_format_is_read_and_written_by_an_odd_name(odd_folder, suffix):
    source = map_of(suffix, odd_folder)
    report = clean([source], odd_folder / "out", *FAST, "output.mode=label", "output.report=none")
    assert report.points == 10
    assert printable(source.parent) in inspect_map([source]).to_text()


def test_tiles_and_previews_lie_under_odd_names(odd_folder):
    given = save(odd_folder / "map.npy", 3_000)
    settings = load_configuration(None, [*TILED, "tiling.max_points=1500"])
    assert tile_map([str(given)], odd_folder / "tiles", settings, observer()) > 1
    settings = load_configuration(None, [*TILED, "tiling.max_points=5", "tiling.format=laz"])
    given_laz = map_of("laz", odd_folder)
    assert tile_map([str(given_laz)], odd_folder / "laz", settings, observer()) > 1
    settings = load_configuration(None, FAST)
    preview([str(given)], odd_folder / "out", settings, observer(), points=1_000, window=WHOLE)


@pytest.mark.parametrize("locale", LOCALES)
def test_commands_work_in_any_locale(tmp_path, locale):
    """Workers and all: what is said at the end is said without a word of Python's own."""
    names = ("plain", "höhle", ODD)
    given = [save(tmp_path / f"{name}.npy") for name in names]
    output = tmp_path / f"out höhle {ODD}"
    environment = {
        key: value
        for key, value in os.environ.items()
        if not key.startswith(("LC_", "LANG", "PYTHON"))
    } | LOCALES[locale]
    clean_it = ["run", *given, "-o", output]
    settings = [f"--set={each}" for each in (*TILED[:-2], "execution.workers=2")]
    program = [sys.executable, "-c", "from pipeline.commands.app import main; main()"]
    odd = given[-1]
    for command in ([*clean_it, *settings], ["info", odd, "--json"], ["plan", odd], ["keys"]):
        words = [*program, *command]
        ended = subprocess.run(words, check=False, capture_output=True, env=environment)
        assert ended.returncode == 0, ended.stderr.decode(errors="replace")
        assert b"Traceback" not in ended.stderr
        assert ended.stdout
    report = json.loads((output / "run.json").read_text())
    assert report["points"] == sum(len(np.load(each)) for each in given)
    assert {path.stem for path in (output / "static").iterdir()} == set(names)


def test_names_are_written_as_any_terminal_takes_them():
    assert printable("höhle") == "höhle"
    assert printable(os.fsdecode(b"h\xf6hle")) == "h\\xf6hle"
    assert printable("two\nlines\x1b[31m") == "two\\nlines\\x1b[31m"
    assert printable("\ud800").isprintable()
