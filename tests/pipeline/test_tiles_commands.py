"""The commands about tiles: plan, tile, status, clean."""

import json
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
from collections import namedtuple
from pathlib import Path

import laspy
import numpy as np
import pyarrow.parquet as pq
import pytest
from distributed import LocalCluster

from pipeline.commands import app as cli
from pipeline.configuration.run import load_configuration
from pipeline.outputs.folder import output_folder
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.tiles import stages

SMALL = [
    "ground.method=none",
    "neighbours.k=8",
    "clustering.count=2",
    "tiling.max_points=100",
    "tiling.halo=0.5",
    "execution.workers=1",
]
WORK = ".dynahull-work"
TLS_ALONE = "error: --tls: expected --cluster or --scheduler with it, found neither"
PROJECT = Path(__file__).resolve().parents[2]


pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")


@pytest.fixture
def map_file(tmp_path):
    points = np.random.default_rng(1).uniform(size=(1001, 3)) * [9, 7, 2]
    points[500] = np.nan
    np.save(tmp_path / "map.npy", points)
    return tmp_path / "map.npy"


@pytest.fixture
def call(tmp_path, monkeypatch, capsys):
    """Run the command line as a process would: exit code, standard output, error lines."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(logging, "basicConfig", lambda **_: None)
    monkeypatch.setattr(cli.signal, "signal", lambda *_: None)

    def called(*arguments, wanted=SMALL):
        needs_settings = arguments[0] in ("run", "plan", "tile")
        settings = [each for setting in wanted for each in ("--set", setting)]
        monkeypatch.setattr(
            sys, "argv", ["dynahull-pipeline", *map(str, arguments), *settings * needs_settings]
        )
        with pytest.raises(SystemExit) as ended:
            cli.main()
        said = capsys.readouterr()
        errors = [line for line in said.err.splitlines() if line.startswith("error: ")]
        return ended.value.code or 0, said.out, errors

    return called


def cleaned(map_file, folder, *wanted):
    configuration = load_configuration(None, [*SMALL, *wanted])
    return run([map_file], folder, configuration, StageObserver(LogDisplay()))


def figures(text):
    """The lines of a plan as a dictionary."""
    pairs = [line.split(":", 1) for line in text.splitlines() if ":" in line]
    return {name: value.strip() for name, value in pairs}


class TestPlan:
    def test_its_figures_are_those_of_the_run(self, map_file, tmp_path, call):
        code, text, _ = call("plan", map_file)
        assert code == 0
        told = figures(text)
        cleaned(map_file, tmp_path / "out", "output.keep_work=true")
        store = json.loads((tmp_path / "out" / WORK / "tiles/store.json").read_text("utf-8"))
        counts = json.loads(store["layout"])["counts"]
        assert told["points"] == "1,001"
        assert sum(counts) == 1000
        expected = f"{len(counts)} ({min(counts)} to {max(counts)} points, median "
        assert told["tiles"].startswith(expected)
        assert re.search(r"median (\d+)", told["tiles"])[1] == str(int(np.median(counts)))
        chunks = (tmp_path / "out" / WORK / "tiles/chunks").iterdir()
        held = sum(pq.read_metadata(path).num_rows for path in chunks)
        halo, share = re.fullmatch(r"(\S+) m, (\d+) % more points to read", told["halo"]).groups()
        assert float(halo) == store["halo"] == 0.5
        # Columns of a quarter metre count whole or not at all.
        assert int(share) == pytest.approx(100 * (held / 1000 - 1), rel=0.2)
        assert held > 1300
        assert told["workers"] == "1"

    def test_it_writes_nothing(self, map_file, tmp_path, call):
        before = sorted(tmp_path.iterdir())
        assert call("plan", map_file)[0] == 0
        assert sorted(tmp_path.iterdir()) == before

    def test_a_small_map_is_one_tile(self, map_file, call):
        code, text, _ = call("plan", map_file, wanted=["tiling.max_points=1001"])
        assert code == 0
        assert "one tile: cleaned in memory" in text
        assert figures(text)["tiles"].startswith("1 (")

    def test_a_ground_method_that_needs_the_whole_map_makes_one_tile(self, map_file, call):
        code, text, _ = call("plan", map_file, wanted=[*SMALL, "ground.method=csf"])
        assert code == 0
        assert "one tile: cleaned in memory" in text
        assert figures(text)["tiles"].startswith("1 (")

    def test_a_map_without_finite_points_has_a_plan(self, tmp_path, call):
        np.save(tmp_path / "nothing.npy", np.full((500, 3), np.nan))
        code, text, _ = call("plan", "nothing.npy")
        assert code == 0
        assert figures(text)["tiles"] == "0 (no points)"

    @pytest.mark.parametrize("command", ["plan", "run", "tile"])
    def test_too_little_memory_is_refused_before_any_work(self, command, map_file, tmp_path, call):
        before = sorted(tmp_path.iterdir())
        output = [] if command == "plan" else ["-o", "out"]
        wanted = [*SMALL, "execution.memory=1MiB"]
        code, text, errors = call(command, map_file, *output, wanted=wanted)
        assert code == 1
        assert ("temporary" in text) == (command == "plan")
        assert len(errors) == 1
        assert re.search(
            r"a worker would take .* MiB .*\d+ points with its halo\) and has 1.0 MiB: choose "
            "a smaller tiling.max_points",
            errors[0],
        )
        assert sorted(tmp_path.iterdir()) == before

    @pytest.mark.parametrize("command", ["run", "tile"])
    def test_workers_that_could_not_begin_are_not_started(
        self, command, map_file, tmp_path, call, monkeypatch
    ):
        started = "pipeline.cluster.choice.local_workers"
        monkeypatch.setattr(started, lambda *_: pytest.fail("workers were started"))
        before = sorted(tmp_path.iterdir())
        wanted = [*SMALL, "execution.workers=2", "execution.memory=2"]
        monkeypatch.setattr("pipeline.plan.resources.available_cores", lambda _: 2)
        code, _, errors = call(command, map_file, "-o", "out", wanted=wanted)
        assert code == 1
        assert errors == [
            "error: a worker takes 350.0 MiB before it has read a point, and has 2 bytes: "
            "choose more execution.memory"
        ]
        assert sorted(tmp_path.iterdir()) == before

    @pytest.mark.parametrize("command", ["plan", "run"])
    @pytest.mark.parametrize(
        ("setting", "taken", "remedy"),
        [
            ("tiling.max_points=1001", "350.1", "a smaller tiling.max_points"),
            ("ground.method=csf", "350.3", "a ground.method other than csf"),
        ],
    )
    def test_one_tile_that_does_not_fit_into_memory_is_refused_before_any_work(
        self, setting, taken, remedy, command, map_file, tmp_path, call
    ):
        before = sorted(tmp_path.iterdir())
        output = [] if command == "plan" else ["-o", "out"]
        wanted = [*SMALL, setting, "removal.decision=paper", "execution.memory=64MiB"]
        code, _, errors = call(command, map_file, *output, wanted=wanted)
        assert code == 1
        assert len(errors) == 1
        assert re.search(
            r"map\.npy: as one tile, the 1,001 points would take "
            rf"{re.escape(taken)} MiB, and there are 64\.0 MiB: choose {remedy}",
            errors[0],
        )
        assert sorted(tmp_path.iterdir()) == before

    @pytest.mark.parametrize("command", ["plan", "run", "tile"])
    def test_too_small_a_disk_is_refused_before_any_work(
        self, command, map_file, tmp_path, call, monkeypatch
    ):
        usage = namedtuple("usage", "total used free")
        monkeypatch.setattr(shutil, "disk_usage", lambda _: usage(10**9, 10**9 - 2000, 2000))
        before = sorted(tmp_path.iterdir())
        code, text, errors = call(command, map_file, *([] if command == "plan" else ["-o", "out"]))
        assert code == 1
        assert ("temporary" in text) == (command == "plan")
        assert len(errors) == 1
        assert re.search(r"temporary files .* of results, and 2.0 KiB are free", errors[0])
        assert sorted(tmp_path.iterdir()) == before

    def test_the_picture_is_a_png_of_the_map(self, map_file, tmp_path, call):
        pytest.importorskip("matplotlib")
        code, text, _ = call("plan", map_file, "--picture", "plan.png")
        assert code == 0
        assert "plan.png" in text
        picture = (tmp_path / "plan.png").read_bytes()
        assert picture.startswith(b"\x89PNG\r\n\x1a\n")
        assert picture.endswith(b"IEND\xaeB`\x82")


class TestTile:
    def check_cores(self, xyz, rows, core, points):
        """All chunks together hold each finite point once in a core, and halos besides."""
        xyz, rows, core = (np.concatenate(each) for each in (xyz, rows, core))
        finite = np.flatnonzero(np.isfinite(points).all(axis=1))
        np.testing.assert_array_equal(np.sort(rows[core]), finite)
        np.testing.assert_array_equal(xyz, points[rows])
        assert not core.all()

    def test_a_plan_counts_what_is_added_to_the_points(self, map_file, call):
        plain, labelled, table = (
            figures(call("plan", map_file, wanted=[*SMALL, "output.labels=false", *each])[1])
            for each in (
                [f"output.{added}", "output.report=none", "removal.decision=paper"]
                for added in ("mode=split", "mode=label", "labels=true")
            )
        )
        assert plain["outputs"] == f"about {map_file.stat().st_size / 1024:.1f} KiB"
        more = map_file.stat().st_size + 10 * 1001
        assert labelled["outputs"] == table["outputs"] == f"about {more / 1024:.1f} KiB"

    def test_chunks_hold_every_point_once(self, map_file, tmp_path, call):
        code, text, _ = call("tile", map_file, "-o", "chunks of it")
        assert code == 0
        folder = tmp_path / "chunks of it"
        assert {path.name for path in folder.iterdir()} == {"chunks", "store.json"}
        paths = sorted((folder / "chunks").iterdir())
        assert f"{len(paths)} tiles in chunks of it/chunks" in text
        assert len(paths) > 8
        _, text, _ = call("tile", map_file, "-o", "one", wanted=[*SMALL, "tiling.max_points=5000"])
        assert "written: 1 tile in one/chunks" in text
        tables = [pq.read_table(path) for path in paths]
        assert tables[0].column_names == ["x", "y", "z", "row", "core"]
        # They are to be kept: small rather than soon written.
        assert pq.read_metadata(paths[0]).row_group(0).column(0).compression == "ZSTD"
        xyz = [np.column_stack([table[axis].to_numpy() for axis in "xyz"]) for table in tables]
        rows, core = ([table[name].to_numpy() for table in tables] for name in ("row", "core"))
        self.check_cores(xyz, rows, core, np.load(map_file))
        for number, table in enumerate(tables):
            place = json.loads(table.schema.metadata[b"tile"])
            assert (place["tile"], place["halo"]) == (number, 0.5)
            low, high = np.array(place["low"]), np.array(place["high"])
            flat = xyz[number][:, :2]
            inside = ((flat >= low) & (flat < high)).all(axis=1)
            np.testing.assert_array_equal(inside, core[number])
            around = (np.load(map_file)[:, :2] >= low - 0.5) & (
                np.load(map_file)[:, :2] < high + 0.5
            )
            np.testing.assert_array_equal(rows[number], np.flatnonzero(around.all(axis=1)))

    def test_workers_elsewhere_cut_the_same_chunks(self, map_file, tmp_path, call):
        assert call("tile", map_file, "-o", "here")[0] == 0
        nothing_else = {"dashboard_address": "127.0.0.1:0"}
        with LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address=None,
            scheduler_kwargs=nothing_else,
        ) as cluster:  # fmt: skip
            there = ["-o", "there", "--scheduler", cluster.scheduler_address]
            assert call("tile", map_file, *there)[0] == 0
        here, there = (sorted((tmp_path / name / "chunks").iterdir()) for name in ("here", "there"))
        assert [path.read_bytes() for path in here] == [path.read_bytes() for path in there]
        code, _, errors = call("tile", map_file, "-o", "secret", "--tls")
        assert (code, errors) == (2, [TLS_ALONE])
        assert call("run", map_file, "-o", "secret", "--tls")[2] == errors

    @pytest.mark.parametrize("chunk_format", ["las", "laz"])
    def test_las_chunks_are_read_by_other_tools(self, chunk_format, tmp_path, call):
        points = np.random.default_rng(2).integers(0, [900, 700, 200], (700, 3)) * 0.01
        np.save(tmp_path / "grid.npy", points)
        wanted = [*SMALL, f"tiling.format={chunk_format}"]
        assert call("tile", "grid.npy", "-o", "out", wanted=wanted)[0] == 0
        paths = sorted((tmp_path / "out/chunks").glob(f"*.{chunk_format}"))
        assert len(paths) > 5
        chunks = [laspy.read(path) for path in paths]
        self.check_cores(
            [np.asarray(chunk.xyz) for chunk in chunks],
            [np.asarray(chunk.row).astype(np.int64) for chunk in chunks],
            [np.asarray(chunk.core).astype(bool) for chunk in chunks],
            points,
        )

    def test_las_is_refused_with_the_reason_where_no_grid_fits(self, map_file, tmp_path, call):
        code, _, errors = call("tile", map_file, "-o", "out", wanted=[*SMALL, "tiling.format=las"])
        assert code == 3
        assert len(errors) == 1
        assert re.search(r"map\.npy: expected coordinates .*integer \* scale.*Parquet", errors[0])
        assert not list((tmp_path / "out").rglob("*.las"))

    def test_a_folder_with_something_in_it_is_refused(self, map_file, tmp_path, call):
        (tmp_path / "full").mkdir()
        (tmp_path / "full/notes.txt").write_text("mine", encoding="utf-8")
        code, _, errors = call("tile", map_file, "-o", "full")
        assert code == 1
        assert "full: expected an empty folder" in errors[0]
        assert [path.name for path in (tmp_path / "full").iterdir()] == ["notes.txt"]

    def test_a_ground_method_that_needs_the_whole_map_does_not_widen_the_halo(
        self, map_file, tmp_path, call
    ):
        wanted = [each for each in SMALL if "halo" not in each] + ["ground.method=csf"]
        code, _, errors = call("tile", map_file, "-o", "out", wanted=wanted)
        assert (code, errors) == (0, [])
        store = json.loads((tmp_path / "out/store.json").read_text("utf-8"))
        assert np.isfinite(store["halo"])

    def test_the_same_command_goes_on_where_it_failed(self, map_file, tmp_path, call, monkeypatch):
        assemble = stages.TASKS["chunk"]
        done = []

        def faulty(job, tile):
            if tile == 3 and not done:
                raise OSError(28, "No space left on device")
            return assemble(job, tile)

        def counting(job, tile):
            done.append(tile)
            return assemble(job, tile)

        monkeypatch.setitem(stages.TASKS, "chunk", faulty)
        code, _, errors = call("tile", map_file, "-o", "out")
        assert code == 1
        assert "No space left" in errors[0]
        assert [path.name for path in (tmp_path / "out").iterdir()] == [WORK]
        monkeypatch.setitem(stages.TASKS, "chunk", counting)
        assert call("tile", map_file, "-o", "out")[0] == 0
        assert done == [3]

    @pytest.mark.parametrize("moment", ["chunks", "store.json", WORK])
    @pytest.mark.parametrize("other_map", [False, True])
    def test_killed_while_it_publishes_it_goes_on(
        self, moment, other_map, map_file, tmp_path, call
    ):
        killing = f"""
import os, signal
from pathlib import Path
rename = Path.rename
def killed(self, target):
    rename(self, target)
    if self.name == {moment!r}:
        os.kill(os.getpid(), signal.SIGKILL)
Path.rename = killed
from pipeline.commands.app import main
main()
"""
        settings = [each for setting in SMALL for each in ("--set", setting)]
        arguments = ["tile", str(map_file), "-o", "out", *settings]
        ended = subprocess.run([sys.executable, "-c", killing, *arguments], cwd=tmp_path,
                               env=os.environ | {"PYTHONPATH": str(PROJECT)}, check=False,
                               capture_output=True)  # fmt: skip
        assert ended.returncode == -signal.SIGKILL
        if other_map:
            np.save(map_file, np.load(map_file) * [1, 1, 0.5])
        if moment == WORK:  # all but the removal of the work was done
            assert call("clean", "out")[0] == 0
            assert {path.name for path in (tmp_path / "out").iterdir()} == {"chunks", "store.json"}
            return
        assert call("tile", map_file, "-o", "out")[0] == 0
        assert call("tile", map_file, "-o", "whole")[0] == 0
        found, expected = (
            {path.relative_to(tmp_path / name): path.read_bytes()
             for path in (tmp_path / name).rglob("*") if path.is_file()}
            for name in ("out", "whole")
        )  # fmt: skip
        assert found == expected


class TestStatusAndClean:
    @pytest.fixture
    def failed(self, map_file, tmp_path, monkeypatch, call):
        """A folder that holds the work of a run of which a tile failed."""
        score = stages.TASKS["density"]

        def faulty(job, tile):
            if tile == 2:
                raise ValueError("a tile of bad luck")
            return score(job, tile)

        with monkeypatch.context() as patch:
            patch.setitem(stages.TASKS, "density", faulty)
            code, _, errors = call("run", map_file, "-o", "out")
        assert code == 1
        assert "failed (2: a tile of bad luck)" in errors[0]
        return tmp_path / "out"

    def test_status_of_a_failed_run_names_the_task_and_the_reason(self, failed, call):
        code, text, _ = call("status", failed)
        assert code == 0
        tiles = len(list((failed / WORK / "tiles/chunks").iterdir()))
        assert f"{failed}: not running; the command that began it goes on" in text
        assert re.search(rf"^ground +{tiles} tasks done$", text, re.MULTILINE)
        assert re.search(
            rf"^density +{tiles - 1} of {tiles} tasks done, 1 failed, 0 waiting", text, re.MULTILINE
        )
        assert "task 2 failed: a tile of bad luck" in text

    def test_status_of_a_run_at_work_tells_stage_tasks_and_rate(
        self, map_file, tmp_path, call, monkeypatch
    ):
        told = []
        score = stages.TASKS["density"]
        monkeypatch.setattr(stages, "_STATE_EVERY", 0.0)

        def watched(job, tile):
            told.append(call("status", tmp_path / "out")[1])
            return score(job, tile)

        monkeypatch.setitem(stages.TASKS, "density", watched)
        cleaned(map_file, tmp_path / "out")
        tiles = len(told)
        assert tiles > 8
        for done, text in enumerate(told):
            assert f"{tmp_path / 'out'}: running" in text
            assert f"{done} of {tiles} tasks done, 0 failed, {tiles - done} waiting" in text
        assert re.search(r"[\d,]+ points/s, \d+ s left in this stage", told[-1])
        assert call("status", tmp_path / "out")[1] == f"{tmp_path / 'out'}: finished\n"

    def test_status_of_no_run_is_an_error(self, tmp_path, call):
        for place in ("nowhere", "."):
            code, _, errors = call("status", place)
            assert code == 1
            assert "expected the output folder of a run" in errors[0]

    def test_clean_removes_the_work_and_keeps_results(self, map_file, failed, tmp_path, call):
        code, text, _ = call("clean", failed)
        assert code == 0
        assert WORK in text
        assert not failed.exists()  # there was nothing but the work

        cleaned(map_file, failed, "output.keep_work=true")
        before = {path.name for path in failed.iterdir()}
        assert call("clean", failed)[0] == 0
        assert {path.name for path in failed.iterdir()} == before - {WORK}
        assert call("clean", failed) == (
            1, "", [f"error: {failed}: no unfinished work of a run in this folder"]
        )  # fmt: skip

    def test_clean_refuses_while_a_run_is_at_work(self, failed, tmp_path, call):
        with output_folder(failed, []):
            code, _, errors = call("clean", failed)
            assert code == 1
            assert "a run is at work" in errors[0]
            assert (failed / WORK).is_dir()
        assert call("clean", "nowhere")[0] == 1

    def test_clean_refuses_while_tiles_are_cut(self, map_file, tmp_path, call, monkeypatch):
        told = []
        assemble = stages.TASKS["chunk"]

        def watched(job, tile):
            told.append(call("clean", tmp_path / "out"))
            return assemble(job, tile)

        monkeypatch.setitem(stages.TASKS, "chunk", watched)
        assert call("tile", map_file, "-o", "out")[0] == 0
        assert {code for code, _, _ in told} == {1}
