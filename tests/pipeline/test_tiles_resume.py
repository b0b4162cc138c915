"""A run that was killed, or that failed, goes on: nothing is done twice, and never mixed up."""

import logging
import os
import pickle
import random
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np
import pytest

from pipeline import run as run_module
from pipeline.configuration.run import load_configuration
from pipeline.errors import InputChangedError, OutputError, PipelineError, TasksFailedError
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.status import run_status
from pipeline.tiles import stages
from pipeline.work import opening
from pipeline.work.files import read_sealed, write_sealed
from pipeline.work.folder import STAGES, WorkFolder
from pipeline.work.job import CREATING
from tiling.errors import MapFormatError, TilingError
from tiling.ledger import noting

COMMAND = [
    sys.executable,
    "-c",
    "from pipeline.commands.app import main; main()",
    "run",
]
SETTINGS = [
    "removal.decision=paper",
    "neighbours.k=8",
    "clustering.count=3",
    "ground.method=none",
    "tiling.max_points=130",
    "tiling.halo=0.3",
    "execution.workers=1",
    "output.labels=true",
]
WORK = ".dynahull-work"


pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")


def write_map(folder):
    generator = np.random.default_rng(3)
    points = generator.uniform(size=(800, 3)) * [9, 7, 2]
    np.save(folder / "map.npy", points)
    return folder / "map.npy"


@pytest.fixture
def map_file(tmp_path):
    return write_map(tmp_path)


def cleaned(map_file, folder, *wanted, fresh=False):
    configuration = load_configuration(None, [*SETTINGS, *wanted])
    return run([map_file], folder, configuration, StageObserver(LogDisplay()), fresh=fresh)


def results(folder):
    names = ("static.npy", "dynamic.npy", "labels.parquet")
    return {name: (folder / name).read_bytes() for name in names}


def markers(folder):
    """When each task was marked as done; the outputs are written anew by every run."""
    found = (folder / WORK).glob("*/*.done")
    return {
        str(path.relative_to(folder)): path.stat().st_mtime_ns
        for path in found
        if path.parent.name != "write"
    }


@pytest.fixture
def done_tasks(monkeypatch):
    """The stage and number of every task that is done from here on."""
    seen = []
    do_task = stages.do_task

    def spy(stage, folder, number):
        report = do_task(stage, folder, number)
        seen.append((stage, number))
        return report

    monkeypatch.setattr(stages, "do_task", spy)
    return seen


class Fault:
    """Lets one task of a stage raise, as long as it is set."""

    def __init__(self, monkeypatch, stage, number, error):
        self._task = stages.TASKS[stage]
        self._number, self.error = number, error
        monkeypatch.setitem(stages.TASKS, stage, self)

    def __call__(self, job, number):
        if number == self._number and self.error is not None:
            raise self.error
        return self._task(job, number)


@pytest.fixture
def interrupted(map_file, tmp_path, monkeypatch):
    """An output folder with the work of a run of which one density failed."""
    fault = Fault(monkeypatch, "density", 4, ValueError("no luck"))
    with pytest.raises(TasksFailedError):
        cleaned(map_file, tmp_path / "out")
    fault.error = None
    return tmp_path / "out"


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """The results of a run that nothing disturbed."""
    folder = tmp_path_factory.mktemp("undisturbed")
    cleaned(write_map(folder), folder / "out")
    return results(folder / "out")


def wait_for_the_end_of(group):
    """Wait until no process of a group is left: a worker may outlive its run by a task."""
    until = time.monotonic() + 60
    with suppress(ProcessLookupError):
        while time.monotonic() < until:
            os.killpg(group, 0)
            time.sleep(0.01)
        pytest.fail("processes of a killed run have not ended")


@pytest.mark.parametrize("workers", [1, 2])
def test_killed_again_and_again_the_results_have_the_same_bytes(
    workers, map_file, tmp_path, expected
):
    cleaned(map_file, tmp_path / "whole", "output.keep_work=true")
    total = len(markers(tmp_path / "whole"))
    wanted = [*SETTINGS, f"execution.workers={workers}"]
    settings = [argument for setting in wanted for argument in ("--set", setting)]
    command = [*COMMAND, str(map_file), "-o", "killed", "--keep-work", *settings]
    moments = random.Random(11)
    done, left = {}, []
    for share in (0.1, 0.3, 0.5, 0.65, 0.8):  # ten kills, with one worker and with two
        wanted = int(total * share) + moments.randrange(3)
        with subprocess.Popen(
            command, cwd=tmp_path, stderr=subprocess.DEVNULL, start_new_session=True
        ) as process:
            while len(markers(tmp_path / "killed")) < wanted:
                assert process.poll() is None, "the run ended before it could be killed"
                time.sleep(0.001)
            time.sleep(moments.uniform(0, 0.01))
            process.send_signal(signal.SIGKILL)
        assert process.returncode == -signal.SIGKILL
        wait_for_the_end_of(process.pid)
        assert not (tmp_path / "killed/run.json").exists()
        now = markers(tmp_path / "killed")
        assert done.items() <= now.items()
        done = now
        left.append(total - len(done))
    assert left[0] > 0  # the later kills may come when all tasks are done and results are written
    subprocess.run(command, cwd=tmp_path, check=True, capture_output=True)
    assert done.items() <= markers(tmp_path / "killed").items()
    assert results(tmp_path / "killed") == expected


def test_only_what_was_not_done_is_done_when_the_run_goes_on(
    map_file, interrupted, expected, done_tasks, caplog
):
    caplog.set_level(logging.INFO, "dynahull")
    tiles = len(list((interrupted / WORK).glob("tiles/chunks/*.parquet")))
    assert tiles > 6
    before = markers(interrupted)
    report = cleaned(map_file, interrupted, "output.keep_work=true")
    after = {(stage, tile) for stage in ("label",) for tile in range(tiles)}
    assert sorted(done_tasks) == sorted([("density", 4), *after, ("write", 0)])
    assert before.items() <= markers(interrupted).items()
    done = f"going on with an earlier run; tasks done: survey 1, cut 1, chunk {tiles}, ground"
    assert done in caplog.text
    assert list(stages.TASKS) == list(STAGES)
    assert report.warnings == []
    assert results(interrupted) == expected


def test_how_the_work_is_spread_may_change_in_between(map_file, interrupted, expected, done_tasks):
    report = cleaned(map_file, interrupted, "execution.cluster=none", "execution.memory=30GiB")
    assert {number for stage, number in done_tasks if stage == "density"} == {4}
    assert report.warnings == []
    assert results(interrupted) == expected


def test_a_map_that_must_be_decoded_is_read_once_before_it_is_cut(
    map_file, tmp_path, monkeypatch, expected, done_tasks
):
    packed = tmp_path / "map.npz"
    np.savez_compressed(packed, np.load(map_file))
    monkeypatch.setattr("pipeline.work.job.ROWS_AT_A_TIME", 300)
    fault = Fault(monkeypatch, "cut", 1, ValueError("no luck"))
    with pytest.raises(TasksFailedError):
        cleaned(packed, tmp_path / "out")
    work = tmp_path / "out" / WORK
    # It cannot be read from the middle, and yet its coordinates are cut side by side.
    assert sorted(done_tasks) == [("cut", 0), ("cut", 2), ("survey", 0)]
    assert (work / "map.decoded").stat().st_size == 800 * 24
    done_tasks.clear()
    fault.error = None
    cleaned(packed, tmp_path / "out", "output.keep_work=true")
    assert {number for stage, number in done_tasks if stage in ("survey", "cut")} == {1}
    assert not (work / "map.decoded").exists()
    assert (tmp_path / "out/labels.parquet").read_bytes() == expected["labels.parquet"]


def test_what_a_killed_task_left_half_written_is_never_taken(map_file, interrupted, expected):
    work = interrupted / WORK
    density = work / "density/000004.arrays"
    assert not density.exists()
    whole = (work / "density/000003.arrays").read_bytes()
    # Killed while it wrote the file; after that and before its marker; while it wrote the marker.
    density.with_name(".000004.arrays.0123456789ab.part").write_bytes(whole[: len(whole) // 2])
    density.write_bytes(whole)
    density.with_name(".000004.done.0123456789ab.part").write_text("{", encoding="utf-8")
    (work / "ground/000002.done").write_text('{"key": "', encoding="utf-8")
    (work / "ground/000001.done").write_bytes(b"")
    cleaned(map_file, interrupted)
    assert results(interrupted) == expected


def test_a_marker_of_another_key_says_nothing(map_file, interrupted, expected, done_tasks):
    marker = interrupted / WORK / "density/000002.done"
    write_sealed(marker, read_sealed(marker) | {"key": "0" * 64})
    cleaned(map_file, interrupted)
    assert {number for stage, number in done_tasks if stage == "density"} == {2, 4}
    assert results(interrupted) == expected


CHANGES = {
    "input": [],
    "method": ["neighbours.k=9"],
    "removal": ["removal.max_percent=30"],
    "tiling": ["tiling.max_points=200"],
    "version": [],
}


@pytest.mark.parametrize("change", CHANGES)
def test_a_changed_input_configuration_or_version_never_mixes_with_old_work(
    change, map_file, interrupted, tmp_path, monkeypatch, done_tasks
):
    if change == "input":
        content = bytearray(map_file.read_bytes())
        content[200] ^= 1  # a bit of a coordinate
        map_file.write_bytes(content)
    if change == "version":
        monkeypatch.setattr(opening, "version", lambda name: "99.0")
    report = cleaned(map_file, interrupted, *CHANGES[change])
    again = list(done_tasks)
    assert [warning for warning in report.warnings if "another map or configuration" in warning]
    done_tasks.clear()
    fresh = cleaned(map_file, tmp_path / "fresh", *CHANGES[change])
    assert fresh.warnings == []
    assert again == done_tasks
    assert results(interrupted) == results(tmp_path / "fresh")


def test_work_that_does_not_say_whose_it_is_is_not_taken(
    map_file, interrupted, tmp_path, done_tasks
):
    (interrupted / WORK / "job.json").unlink()
    cleaned(map_file, interrupted, "clustering.seed=5")
    cleaned(map_file, tmp_path / "fresh", "clustering.seed=5")
    assert done_tasks[: len(done_tasks) // 2] == done_tasks[len(done_tasks) // 2 :]
    assert results(interrupted) == results(tmp_path / "fresh")


def test_what_was_read_of_a_map_that_changed_meanwhile_is_not_kept(
    map_file, tmp_path, monkeypatch, expected
):
    content = map_file.read_bytes()
    true_hash = run_module.content_hash

    def meddling(paths):
        digest = true_hash(paths)
        np.save(map_file, np.load(map_file)[::-1] * [1, 1, 0.5])
        return digest

    monkeypatch.setattr(run_module, "content_hash", meddling)
    with pytest.raises(InputChangedError):
        cleaned(map_file, tmp_path / "out")
    monkeypatch.setattr(run_module, "content_hash", true_hash)
    map_file.write_bytes(content)
    cleaned(map_file, tmp_path / "out")
    assert results(tmp_path / "out") == expected


@pytest.mark.parametrize("stage", ["survey", "cut", "write"])
@pytest.mark.parametrize("when", ["before", "within"])
def test_a_map_that_is_changed_and_put_back_around_a_kill_is_not_mixed(
    stage, when, map_file, tmp_path, monkeypatch, expected
):
    whole = map_file.read_bytes()
    task = stages.TASKS[stage]

    class Killed(BaseException):
        """Ends the process at once, as far as the run can tell."""

    def meddling(job, number):
        # Each half of the map is read in a different state, and then there is an end.
        if number == 1:
            raise Killed
        if when == "within":
            report = task(job, number)
        np.save(map_file, np.load(map_file) * [1, 1, 0.5])
        return task(job, number) if when == "before" else report

    monkeypatch.setattr("pipeline.work.job.ROWS_AT_A_TIME", 400)
    monkeypatch.setattr("pipeline.tiles.writing.DEFAULT_BATCH", 200)
    with monkeypatch.context() as patch:
        patch.setitem(stages.TASKS, stage, meddling)
        with pytest.raises((Killed, InputChangedError)):
            cleaned(map_file, tmp_path / "out")
    map_file.write_bytes(whole)
    assert not (tmp_path / "out" / WORK / stage / "000000.done").exists()
    report = cleaned(map_file, tmp_path / "out")
    assert report.warnings == []
    assert results(tmp_path / "out") == expected


@pytest.mark.parametrize("stage", ["hash", "survey", "ground", "write", "one tile"])
def test_a_map_that_vanishes_is_bad_input(stage, map_file, tmp_path, monkeypatch):
    def vanishing(task):
        def vanished(*arguments):
            map_file.unlink(missing_ok=True)
            return task(*arguments)

        return vanished

    wanted = []
    if stage in stages.TASKS:
        monkeypatch.setitem(stages.TASKS, stage, vanishing(stages.TASKS[stage]))
    else:
        monkeypatch.setattr(run_module, "content_hash", vanishing(run_module.content_hash))
        wanted = ["tiling.max_points=1000"] if stage == "one tile" else []
    with pytest.raises(MapFormatError, match=r"map\.npy: expected a map .*no such file or dir"):
        cleaned(map_file, tmp_path / "out", *wanted)


def test_a_map_that_cannot_be_read_any_more_is_bad_input(map_file, tmp_path, monkeypatch):
    def failing(paths):
        raise PermissionError(13, "Permission denied", str(paths[0]))

    monkeypatch.setattr(run_module, "content_hash", failing)
    with pytest.raises(MapFormatError, match=r"map\.npy: expected .*, found permission denied"):
        cleaned(map_file, tmp_path / "out")


@pytest.mark.parametrize("settings", [["execution.workers=1"], ["execution.workers=2"]])
def test_what_the_survey_finds_to_be_no_map_is_refused_and_nothing_is_left(settings, tmp_path):
    rows = [f"{row % 20} {row // 20} 1.5\n" for row in range(400)]
    map_file = tmp_path / "map.xyz"
    map_file.write_text("".join([*rows, "1 2 lost\n"]), encoding="utf-8")
    with pytest.raises(TilingError, match="expected a number, found 'lost' at line 401"):
        cleaned(map_file, tmp_path / "out", *settings)
    assert not (tmp_path / "out").exists()


@pytest.fixture
def half_written(map_file, tmp_path, monkeypatch):
    """An output folder with the work of a run that failed in the second of its output's parts."""
    monkeypatch.setattr("pipeline.tiles.writing.DEFAULT_BATCH", 100)
    fault = Fault(monkeypatch, "write", 1, OSError(5, "Input/output error"))
    with pytest.raises(TasksFailedError):
        cleaned(map_file, tmp_path / "out")
    fault.error = None
    return tmp_path / "out"


def test_parts_of_the_outputs_that_are_written_are_not_written_again(
    map_file, half_written, expected, done_tasks
):
    cleaned(map_file, half_written)
    assert [task for task in done_tasks if task[0] == "write"] == [("write", 1)]
    assert results(half_written) == expected


def test_parts_are_written_again_where_the_outputs_are_gone(
    map_file, half_written, expected, done_tasks
):
    # As after a kill between the moving of the outputs and their publication.
    (half_written / WORK / "outputs/000000-0").unlink()
    cleaned(map_file, half_written)
    assert {number for stage, number in done_tasks if stage == "write"} == {0, 1, 2, 3}
    assert results(half_written) == expected


def test_parts_of_other_outputs_are_not_gone_on_with(map_file, half_written, tmp_path, done_tasks):
    wanted = "output.classes.dynamic=12"
    cleaned(map_file, half_written, wanted)
    assert {number for stage, number in done_tasks if stage == "write"} == {0, 1, 2, 3}
    cleaned(map_file, tmp_path / "fresh", wanted)
    assert results(half_written) == results(tmp_path / "fresh")


def forge(work, marker, path, values):
    """Put other values into a sealed file, as if the run had written them."""
    folder = WorkFolder(work, read_sealed(work / "job.json")["key"])
    kept = folder.marker(marker)
    with noting() as written:
        write_sealed(path, values)
    others = [each for each in kept.written if each.path != path]
    folder._mark(marker, kept.report, [*others, *written])


SUMMARIES = {
    "nothing": "",
    "half": "[{",
    "too deep": "[" * 100_000,
    "another kind": 7,
    "too few": [{"first": 0, "count": 5}],
    "no members": [{}, {}],
    "texts": [{"first": "0", "count": "5"}, {"first": "0", "count": "5"}],
    "other points": [{"first": 0, "count": 200}, {"first": 0, "count": 0}],
    "other places": [{"first": 7, "count": 5}, {"first": 7, "count": 5}],
}


@pytest.mark.parametrize("summary", SUMMARIES)
def test_a_part_with_a_strange_summary_is_written_again(
    summary, map_file, half_written, expected, done_tasks
):
    work, kept = half_written / WORK, SUMMARIES[summary]
    path = work / "write/000000.json"
    if isinstance(kept, str):
        path.write_text(kept, encoding="utf-8")
    else:
        forge(work, path.with_suffix(".done"), path, {"summaries": kept})
    cleaned(map_file, half_written)
    assert [task for task in done_tasks if task[0] == "write"] == [("write", 0), ("write", 1)]
    assert results(half_written) == expected


PLANS = {
    "nothing": lambda kept: "",
    "too deep": lambda kept: "[" * 100_000,
    "another kind": lambda kept: "[]",
    "no parts": lambda kept: kept | {"points": []},
    "other rows": lambda kept: kept | {"points": [[0, [1, 2]]]},
    "other sizes": lambda kept: kept | {"sizes": [1, 2]},
}


@pytest.mark.parametrize("plan", PLANS)
def test_parts_of_a_strange_plan_are_all_written_again(
    plan, map_file, half_written, expected, done_tasks
):
    work = half_written / WORK
    path = work / "parts.json"
    forged = PLANS[plan](read_sealed(path))
    if isinstance(forged, str):
        path.write_text(forged, encoding="utf-8")
    else:
        forge(work, work / f"{CREATING}.done", path, forged)
    cleaned(map_file, half_written)
    assert {number for stage, number in done_tasks if stage == "write"} == {0, 1, 2, 3}
    assert results(half_written) == expected


def test_a_work_folder_from_elsewhere_calls_nothing(map_file, half_written, expected, tmp_path):
    class Attack:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "called"),)

    work = half_written / WORK
    for path in [*work.rglob("*"), work / "parts.pickle", work / "write/000000.pickle"]:
        if not path.is_dir() and path.suffix != ".done" and path.name != "job.json":
            path.write_bytes(pickle.dumps(Attack()))
    with suppress(PipelineError, TilingError):
        cleaned(map_file, half_written)
    assert not (tmp_path / "called").exists()


@pytest.mark.parametrize("place", ["", "write", "outputs/000000-0", "job.json", "label.rows"])
@pytest.mark.parametrize("link", ["symbolic", "hard"])
def test_a_work_folder_that_leads_elsewhere_is_not_taken(
    place, link, map_file, half_written, expected, tmp_path, done_tasks
):
    inside, outside = half_written / WORK / place, tmp_path / "outside"
    inside.rename(outside)
    if link == "symbolic":
        inside.symlink_to(outside)
    elif outside.is_dir():
        pytest.skip("folders have no hard links")
    else:
        os.link(outside, inside)
    before = tree(outside)
    if not place and link == "symbolic":
        with pytest.raises(OutputError, match="expected a folder of a run's own, found a link"):
            cleaned(map_file, half_written)
        assert tree(outside) == before
        return
    report = cleaned(map_file, half_written)
    assert tree(outside) == before
    assert [warning for warning in report.warnings if "starting over" in warning]
    assert results(half_written) == expected


def tree(path):
    """Every file at or below a path, with its bytes."""
    files = path.rglob("*") if path.is_dir() else [path]
    return {file: file.read_bytes() for file in files if file.is_file()}


@pytest.mark.parametrize("content", ["", "[]", "7", "null", "[" * 100_000])
def test_a_job_that_says_nothing_is_written_again(content, map_file, interrupted, expected):
    # Each marker names the run that it is of.
    (interrupted / WORK / "job.json").write_text(content, encoding="utf-8")
    cleaned(map_file, interrupted)
    assert results(interrupted) == expected


def test_fresh_starts_over_without_a_warning(map_file, interrupted, expected, done_tasks):
    before = markers(interrupted)
    report = cleaned(map_file, interrupted, "output.keep_work=true", fresh=True)
    assert report.warnings == []
    assert set(before) <= {f"{WORK}/{stage}/{number:06d}.done" for stage, number in done_tasks}
    assert not before.items() & markers(interrupted).items()
    assert results(interrupted) == expected


def test_the_work_folder_is_gone_after_success_unless_it_is_to_be_kept(map_file, tmp_path):
    names = {"static.npy", "dynamic.npy", "labels.parquet", "report.html"}
    names |= {"config.yaml", "run.json"}
    cleaned(map_file, tmp_path / "out")
    assert {path.name for path in (tmp_path / "out").iterdir()} == names
    cleaned(map_file, tmp_path / "out", "output.keep_work=true")
    assert {path.name for path in (tmp_path / "out").iterdir()} == names | {WORK}
    assert not list((tmp_path / "out").rglob("*.part"))


def test_kept_work_serves_the_next_run(map_file, tmp_path, expected, done_tasks):
    cleaned(map_file, tmp_path / "out", "output.keep_work=true")
    done_tasks.clear()
    cleaned(map_file, tmp_path / "out")
    assert [stage for stage, _ in done_tasks] == ["write"]
    assert results(tmp_path / "out") == expected


@pytest.mark.parametrize(
    ("stage", "error"),
    [
        *((stage, ValueError("no luck")) for stage in ("survey", "cut", "ground")),
        *((stage, OSError(28, "No space left")) for stage in ("density", "label", "write")),
    ],
)
def test_a_failed_task_is_named_and_the_same_command_goes_on(
    stage, error, map_file, tmp_path, monkeypatch, expected, done_tasks
):
    number = 0 if stage in ("survey", "cut", "write") else 3
    fault = Fault(monkeypatch, stage, number, error)
    with pytest.raises(TasksFailedError) as raised:
        cleaned(map_file, tmp_path / "out")
    reason = "no luck" if isinstance(error, ValueError) else "No space left"
    message = str(raised.value)
    assert f"the stage {stage} failed ({number}: " in message
    assert reason in message
    assert "\n" not in message
    told = run_status(tmp_path / "out").to_text()
    assert f"task {number} failed: " in told
    assert reason in told
    assert not (tmp_path / "out/run.json").exists()
    assert not (tmp_path / "out/static.npy").exists()
    if stage in ("ground", "density", "label"):  # the others are done all the same
        tiles = len(list((tmp_path / "out" / WORK).glob("ground/*.done")))
        tiles += stage == "ground"
        assert {each for name, each in done_tasks if name == stage} == {*range(tiles)} - {3}
    fault.error = None
    done_tasks.clear()
    cleaned(map_file, tmp_path / "out")
    if stage != "write":
        assert [each for name, each in done_tasks if name == stage] == [number]
    assert results(tmp_path / "out") == expected


def test_work_that_was_copied_goes_on_and_leaves_the_original_alone(
    map_file, half_written, tmp_path, expected
):
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    moved = map_file.rename(elsewhere / "renamed.npy")
    shutil.copytree(half_written, elsewhere / "out")
    before = {path: path.read_bytes() for path in half_written.rglob("*") if path.is_file()}
    cleaned(moved, elsewhere / "out")
    assert results(elsewhere / "out") == expected
    after = {path: path.read_bytes() for path in half_written.rglob("*") if path.is_file()}
    assert after == before


@pytest.mark.parametrize("library", ["numpy", "scikit-learn", "numba"])
def test_work_of_other_versions_of_libraries_is_not_gone_on_with(
    library, map_file, interrupted, monkeypatch, expected
):
    true = opening.version
    monkeypatch.setattr(opening, "version", lambda name: "0" if name == library else true(name))
    report = cleaned(map_file, interrupted)
    assert [each for each in report.warnings if "another version" in each]
    assert results(interrupted) == expected


def test_work_in_files_of_another_format_is_not_gone_on_with(
    map_file, interrupted, monkeypatch, expected
):
    monkeypatch.setattr(opening, "_FORMAT", opening._FORMAT + 1)
    report = cleaned(map_file, interrupted)
    assert [each for each in report.warnings if "another version" in each]
    assert results(interrupted) == expected


@pytest.mark.parametrize(("decision", "is_another"), [("auto", True), ("paper", False)])
def test_scores_of_another_model_are_not_gone_on_with(decision, is_another, monkeypatch):
    configuration = load_configuration(None, [f"removal.decision={decision}"])
    before = opening.job_key("map", configuration)
    monkeypatch.setattr(opening, "models_digest", lambda: "others")
    assert (opening.job_key("map", configuration) != before) == is_another


def test_a_file_in_the_place_of_the_work_folder_is_no_obstacle(map_file, tmp_path, expected):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / WORK).write_bytes(b"")
    cleaned(map_file, tmp_path / "out")
    assert results(tmp_path / "out") == expected


def test_markers_name_no_files_outside_of_the_work_folder(map_file, interrupted, expected):
    precious = interrupted.parent / "precious"
    (precious / "deep").mkdir(parents=True)
    for name in ("../../precious", str(precious)):
        marker = interrupted / WORK / "density/000002.done"
        write_sealed(marker, read_sealed(marker) | {"written": [[name, None, 1, 1]]})
    cleaned(map_file, interrupted)
    assert (precious / "deep").is_dir()
    assert results(interrupted) == expected


def test_work_that_cannot_be_removed_does_not_fail_a_run_that_is_done(
    map_file, tmp_path, monkeypatch, expected
):
    def failing(work):
        raise PermissionError(13, "Permission denied", str(work))

    monkeypatch.setattr(run_module, "remove_work", failing)
    cleaned(map_file, tmp_path / "out")
    assert results(tmp_path / "out") == expected
