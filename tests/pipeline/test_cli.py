"""The command line as a user meets it: in a process of its own, where that can matter."""

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
from importlib.metadata import version
from pathlib import Path
from subprocess import CompletedProcess
from time import monotonic

import numpy as np
import pytest

from pipeline.commands.app import main
from pipeline.configuration.run import load_configuration

COMMAND = [sys.executable, "-c", "from pipeline.commands.app import main; main()"]


def call(*arguments, **options):
    command = [*COMMAND, *map(str, arguments)]
    return subprocess.run(
        command, check=False, capture_output=True, text=True, timeout=120, **options
    )


@pytest.fixture
def call_here(tmp_path, monkeypatch, capsys):
    """Call in this process, which spares a second each time."""
    wanted = (signal.SIGTERM, signal.SIGHUP)
    before = [signal.getsignal(each) for each in wanted]

    def called(*arguments):
        monkeypatch.chdir(tmp_path)
        monkeypatch.setattr(sys, "argv", ["dynahull-pipeline", *map(str, arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return CompletedProcess(arguments, ended.value.code, *capsys.readouterr())

    yield called
    for each, handler in zip(wanted, before, strict=True):
        signal.signal(each, handler)


@pytest.fixture
def map_file(tmp_path):
    random = np.random.default_rng(0)
    wall = random.uniform(size=(1000, 3)) * [5, 0.02, 2]
    points = np.vstack([wall, wall[:3], random.uniform(size=(50, 3)) * 3, [[np.nan, 0, 0]]])
    np.save(tmp_path / "wall.npy", points)
    return tmp_path / "wall.npy"


def test_help_answers_at_once():
    begun = monotonic()
    done = call("--help")
    assert done.returncode == 0
    assert "run" in done.stdout
    assert "info" in done.stdout
    # Generous, for machines under load; a single heavy import would take longer on its own.
    assert monotonic() - begun < 3


@pytest.mark.parametrize(
    ("code", "heavy"),
    [
        (
            "from pipeline.commands.app import app; app(['run', '--help'], standalone_mode=False)",
            {"numpy", "scipy", "sklearn", "numba", "pyarrow", "laspy", "yaml"},
        ),
    ],
)
def test_what_is_heavy_is_imported_when_it_is_needed(code, heavy):
    code = f"import sys; {code}; print(sorted({heavy} & set(sys.modules)), file=sys.stderr)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"


def test_run_writes_the_results_and_says_what_was_removed(map_file, tmp_path):
    done = call(
        "run", map_file, "--labels", "--set", "ground.method=none", "--set", "neighbours.k=20",
        cwd=tmp_path,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "wall_dynahull"
    names = {"static.npy", "dynamic.npy", "labels.parquet", "report.html"}
    names |= {"run.json", "config.yaml"}
    assert {path.name for path in folder.iterdir()} == names
    report = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    assert f"{report['counts']['dynamic']} of 1,054 points removed" in done.stdout
    assert all(str(cluster["removed"]) in done.stdout for cluster in report["clusters"])
    assert "static.npy" in done.stdout
    assert "density: done" in done.stderr
    assert "\x1b" not in done.stdout + done.stderr


def test_workers_say_nothing_of_themselves_and_leave_no_folders(map_file, tmp_path):
    # The names of sockets that lie in it must not be long.
    with tempfile.TemporaryDirectory() as temporary:
        done = call(
            "run", map_file, "-c", "paper", "--set", "tiling.max_points=300",
            "--set", "execution.workers=2", "--set", "ground.method=none",
            cwd=tmp_path, env=os.environ | {"TMPDIR": temporary},
        )  # fmt: skip
        left = {path.name for path in Path(temporary).iterdir()}
        assert left == {"dask-scratch-space"}
        locks = {path.name for path in Path(temporary, "dask-scratch-space").iterdir()}
        assert locks <= {"global.lock", "purge.lock"}
    assert done.returncode == 0, done.stderr
    of_a_run = re.compile(r"\S+ \S+ INFO [a-z]+: ([\d,]+ points|done in [\d.]+ s)")
    of_others = [line for line in done.stderr.splitlines() if not of_a_run.fullmatch(line)]
    assert of_others == []


def test_info_says_what_a_map_is(map_file, call_here):
    done = call_here("info", map_file)
    assert done.returncode == 0
    for expected in ("1,054", "x: float64", "non-finite  1", "duplicates  3", "CRS         none"):
        assert expected in done.stdout
    said = json.loads(call_here("info", map_file, "--json").stdout)
    assert (said["points"], said["non_finite"], said["duplicates"]) == (1054, 1, 3)
    assert said["maximum"][0] == pytest.approx(5, abs=0.1)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["run", "nowhere.pcd"], 3, "nowhere.pcd"),
        (["run", "notes.txt"], 3, "notes.txt"),
        (["run", "broken.las"], 3, "broken.las"),
        (["info", "broken.las"], 3, "broken.las"),
        (["run", "wall.npy", "-c", "nowhere.yaml"], 2, "nowhere.yaml"),
        (["run", "wall.npy", "--set", "neighbours.kk=3"], 2, "did you mean k?"),
        (["run", "wall.npy", "--set", "ground.method=las_class"], 3, "las_class"),
        (["run", "wall.npy", "-o", "broken.las"], 1, "broken.las"),
        (["run", "wall.npy", "-o", "wall.npy"], 1, "wall.npy"),
        (["run", "wall.npy", "-o", ""], 2, "-o: expected a folder"),
        (["run", ""], 3, "an empty name"),
    ],
)
def test_mistakes_are_one_line_and_an_exit_code_and_write_nothing(
    arguments, code, message, map_file, tmp_path, call_here
):
    (tmp_path / "broken.las").write_bytes(b"LASF but not really")
    (tmp_path / "notes.txt").write_text("hello", encoding="utf-8")
    before = sorted(tmp_path.iterdir())
    done = call_here(*arguments)
    assert done.returncode == code, done.stderr
    errors = [line for line in done.stderr.splitlines() if line.startswith("error: ")]
    assert len(errors) == 1
    assert message in errors[0]
    assert "Traceback" not in done.stderr
    assert sorted(tmp_path.iterdir()) == before


def test_output_that_nobody_reads_ends_the_command_as_it_does_other_tools():
    with subprocess.Popen([*COMMAND, "keys"], stdout=subprocess.PIPE, stderr=subprocess.PIPE) as it:
        it.stdout.close()
        said = it.stderr.read()
    assert it.returncode == 128 + signal.SIGPIPE
    assert said == b""


def test_wrong_usage_is_exit_code_two(call_here):
    assert call("run").returncode == 2
    assert call_here("clean-up").returncode == 2
    assert call_here("run", "x.pcd", "--nonsense").returncode == 2


def test_the_version_is_the_package_s():
    assert call("--version").stdout.strip() == version("dynahull-pipeline")


@pytest.mark.parametrize("wanted", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_stopped_in_the_middle_leaves_nothing(wanted, tmp_path):
    random = np.random.default_rng(0)
    np.save(tmp_path / "big.npy", random.normal(size=(300_000, 3)))
    slow = ["--set", "ground.method=none", "--set", "density.device=reference"]
    before = signal.signal(wanted, signal.SIG_DFL)  # under `nohup` it is ignored, as it should be
    with subprocess.Popen(
        [*COMMAND, "run", "big.npy", "--fresh", *slow],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        signal.signal(wanted, before)
        for line in process.stderr:
            if "density: " in line:
                break
        process.send_signal(wanted)
        rest = process.stderr.read()
    assert process.returncode == 130
    assert "error: interrupted" in rest
    assert f"to go on: dynahull-pipeline run big.npy {' '.join(slow)}\n" in rest
    assert [path.name for path in tmp_path.iterdir()] == ["big.npy"]


def test_help_has_the_commands_in_the_order_of_a_first_day(call_here):
    shown = re.findall(r"^│ ([a-z]+) ", call_here("--help").stdout, re.MULTILINE)
    assert shown[:6] == ["simulate", "info", "preview", "run", "view", "evaluate"]
    assert "clean" not in shown  # an alias


def test_the_former_name_of_discard_works_with_a_note(tmp_path, call_here):
    done = call_here("clean", tmp_path)
    assert done.stderr.startswith("note: clean is called discard now")
    assert done.stderr.splitlines()[1:] == call_here("discard", tmp_path).stderr.splitlines()
    assert done.returncode == 1


def test_quiet_says_the_answer_alone_and_verbose_where_an_error_comes_from(map_file, tmp_path):
    settings = ["--set", "ground.method=none", "--set", "neighbours.k=20"]
    quiet = call("run", map_file, *settings, "--quiet", cwd=tmp_path)
    assert "points removed" in quiet.stdout
    assert "done in" not in quiet.stderr
    assert "Traceback" in call("info", tmp_path / "none.npy", "-v").stderr
    assert "Traceback" not in call("info", tmp_path / "none.npy").stderr


def test_the_key_that_is_missing_beside_another_is_named(map_file, call_here):
    done = call_here("run", map_file, "--set", "removal.max_percent=3")
    assert done.returncode == 2
    assert "set removal.min_percent as well, to no more than 3" in done.stderr


@pytest.mark.parametrize(
    "words",
    [
        ("run", "--set", "removal.confidence=0.7"),
        ("run", "--confidence", "0.7"),
        ("preview", "--confidence", "0.7"),
        ("submit", "--cluster", "slurm", "--dry-run", "--confidence", "0.7"),
    ],
)
def test_a_setting_that_nothing_looks_at_is_refused(words, map_file, call_here):
    done = call_here(*words, "-c", "paper", map_file)
    assert done.returncode == 2
    assert done.stderr.startswith("error: removal.confidence has no effect")
    assert "or removal.decision=auto as well" in done.stderr


@pytest.mark.parametrize("words", [("-c", "auto"), ("--set", "removal.decision=auto")])
@pytest.mark.parametrize("setting", ["min_percent=1", "max_percent=8", "threshold=stepped"])
def test_so_is_a_share_where_the_evidence_decides(words, setting, map_file, call_here):
    done = call_here("run", *words, "--set", f"removal.{setting}", map_file)
    assert done.returncode == 2
    key = setting.partition("=")[0]
    assert done.stderr.startswith(f"error: removal.{key} has no effect where removal.decision is ")
    assert "give removal.confidence, or removal.decision=paper as well" in done.stderr


@pytest.mark.parametrize(
    ("words", "decision"),
    [
        ((), "auto"),
        (("--confidence", "0.7"), "auto"),
        (("--set", "removal.max_percent=8"), "paper"),
    ],
)
def test_what_is_given_says_how_it_is_decided(words, decision, map_file, call_here, tmp_path):
    done = call_here("run", map_file, *words, "-o", "out")
    assert done.returncode == 0, done.stderr
    kept = load_configuration(str(tmp_path / "out/config.yaml"))
    assert kept.removal.decision == decision


@pytest.mark.parametrize("command", ["run", "submit", "preview"])
@pytest.mark.parametrize(
    ("words", "told"),
    [
        (("--window", "5", "5", "0", "0"), ""),
        (("--height", "2", "0"), "lower number first"),
        (("--protect", "none.geojson"), "none.geojson"),
    ],
)
def test_every_command_looks_at_the_part_that_is_asked_for(
    command, words, told, map_file, call_here
):
    where = ("--cluster", "slurm", "--dry-run") if command == "submit" else ()
    done = call_here(command, *where, *words, map_file)
    assert done.returncode == 2
    assert done.stderr.startswith("error: ")
    assert told in done.stderr


def test_a_confidence_is_given_to_a_run_as_to_apply(map_file, call_here, tmp_path):
    done = call_here("run", map_file, "-c", "auto", "--confidence", "0.9", "-o", "sure")
    assert done.returncode == 0
    kept = load_configuration(str(tmp_path / "sure/config.yaml"))
    assert kept.removal.confidence == 0.9
    done = call_here("run", map_file, "-c", "auto", "--confidence", "7")
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        "error: configuration: removal.confidence: input should be less than 1, found 7.0"
    ]


def test_plan_and_status_as_json(map_file, call_here):
    settings = ["--set", "ground.method=none", "--set", "neighbours.k=20"]
    plan = json.loads(call_here("plan", map_file, *settings, "--json").stdout)
    assert plan["points"] == 1054
    assert plan["one_tile"]
    assert call_here("run", map_file, *settings).returncode == 0
    for watch in ([], ["--watch"]):  # a run that has ended is not waited for
        told = json.loads(call_here("status", "wall_dynahull", "--json", *watch).stdout)
        assert (told["state"], told["is_alive"]) == ("finished", False)


def test_the_manual_page_has_every_command_and_option(call_here):
    page = call_here("manual").stdout
    assert page.startswith(".TH DYNAHULL-PIPELINE 1")
    for words in ('.SS "run ', '.SS "nightly ', "\\-\\-keep\\-work", ".SH EXIT STATUS"):
        assert words in page, words


def test_completion_is_typers_own():
    asked = {"_DYNAHULL_PIPELINE_COMPLETE": "source_bash"}
    assert "complete_bash" in call(env={**os.environ, **asked}).stdout
