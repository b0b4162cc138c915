"""Work that was damaged while no run was at it: the results are the same, and nothing is blamed."""

import os
import random
import shutil
from pathlib import Path

import laspy
import numpy as np
import pytest

from pipeline.commands import app as cli
from pipeline.configuration.run import load_configuration
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.status import run_status
from pipeline.tiles import stages
from pipeline.work.folder import WORK_FOLDER

SETTINGS = [
    "removal.decision=paper",
    "neighbours.k=8",
    "clustering.count=2",
    "tiling.max_points=200",
    "tiling.halo=0.3",
    "execution.workers=1",
    "output.labels=true",
    "output.report=none",
]

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")


class Killed(BaseException):
    """Ends the process at once, as far as the run can tell."""


def npy_map(folder):
    points = np.random.default_rng(3).uniform(size=(500, 3)) * [9, 7, 2]
    points[77] = np.nan
    np.save(folder / "map.npy", points)
    return folder / "map.npy"


def las_map(folder, name="map.las"):
    generator = np.random.default_rng(4)
    header = laspy.LasHeader(version="1.4", point_format=6)
    header.scales = [0.001] * 3
    points = laspy.LasData(header)
    points.xyz = generator.uniform(size=(500, 3)) * [9, 7, 2]
    points.classification = generator.integers(1, 3, 500)
    points.write(folder / name)
    return folder / name


def laz_map(folder):
    return las_map(folder, "map.laz")


def text_map(folder):
    points = np.random.default_rng(5).uniform(size=(500, 3)) * [9, 7, 2]
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 500\nHEIGHT 1\n"
    rows = "\n".join(" ".join(f"{value:.4f}" for value in point) for point in points)
    text = f"{head}VIEWPOINT 0 0 0 1 0 0 0\nPOINTS 500\nDATA ascii\n{rows}\n"
    (folder / "map.pcd").write_text(text, encoding="utf-8")
    return folder / "map.pcd"


MOMENTS = {
    "cut": (text_map, "cut", 1, ["ground.method=none"]),
    "chunk": (npy_map, "chunk", 2, ["ground.method=none"]),
    "columns": (npy_map, "columns", 2, ["ground.method=slope"]),
    "height": (npy_map, "height", 2, ["ground.method=slope", "max_height=1.2"]),
    "ground": (laz_map, "ground", 2, ["ground.method=las_class"]),
    "ground, LAS chunks": (las_map, "ground", 2, ["ground.method=none", "tiling.format=las"]),
    "narrow halo": (npy_map, "ground", 3, ["tiling.halo=0.1", "ground.method=slope"]),
    "density": (npy_map, "density", 2, ["ground.method=none"]),
    "density, a model a tile": (npy_map, "label", 2, ["clustering.scope=tile"]),
    "evidence": (npy_map, "evidence", 2, ["removal.decision=auto", "ground.method=slope"]),
    "label, of evidence": (npy_map, "label", 2, ["removal.decision=auto", "ground.method=none"]),
    "write": (las_map, "write", 1, ["ground.method=none"]),
    "write, points between others": (npy_map, "write", 2, ["ground.method=none"]),
}
"""Map, the stage and task that a run is killed in, and its settings."""


def flip_a_bit(path, place):
    content = bytearray(path.read_bytes())
    if content:
        content[int(place * len(content))] ^= 1 << int(place * 8)
        path.write_bytes(content)


def cut_short(path, place):
    os.truncate(path, int(place * path.stat().st_size))


def empty(path, place):
    path.write_bytes(b"")


def lengthen(path, place):
    with path.open("ab") as file:
        file.write(b"\0\0\0\0")


def delete(path, place):
    path.unlink()


DAMAGE = [flip_a_bit, cut_short, empty, lengthen, delete]


def cleaned(map_file, folder, wanted):
    configuration = load_configuration(None, [*SETTINGS, *wanted])
    return run([map_file], folder, configuration, StageObserver(LogDisplay()))


def told_by(report):
    """What a run warned of, except that these maps are sparse."""
    return [each for each in report.warnings if "the map is sparse" not in each]


def results(folder):
    found = (path for path in folder.iterdir() if path.suffix not in (".json", ".yaml"))
    return {path.name: path.read_bytes() for path in found if path.is_file()}


def kind_of(path):
    """Folder and suffix: the tasks of a stage leave files of the same kinds."""
    named = path.stem.isdigit() or len(path.parts) > 2
    return path.parent / f"*{path.suffix}" if named else path


@pytest.fixture(scope="module", params=MOMENTS)
def killed(request, tmp_path_factory):
    """Map, settings, a folder with the work of a killed run, and what it would have given."""
    make, stage, number, wanted = MOMENTS[request.param]
    place = tmp_path_factory.mktemp("killed")
    map_file = make(place)
    task = stages.TASKS[stage]

    def killing(job, task_number):
        if len(list((job.root / stage).glob("*.done"))) == number:
            raise Killed
        return task(job, task_number)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pipeline.work.job.ROWS_AT_A_TIME", 200)
        patch.setattr("pipeline.tiles.writing.DEFAULT_BATCH", 100)
        cleaned(map_file, place / "whole", wanted)
        patch.setitem(stages.TASKS, stage, killing)
        with pytest.raises(Killed):
            cleaned(map_file, place / "out", wanted)
    return map_file, wanted, place / "out", results(place / "whole")


@pytest.fixture(autouse=True)
def small_ranges(monkeypatch):
    monkeypatch.setattr("pipeline.work.job.ROWS_AT_A_TIME", 200)
    monkeypatch.setattr("pipeline.tiles.writing.DEFAULT_BATCH", 100)


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_file_of_any_kind_is_made_again(damage, killed, tmp_path):
    map_file, wanted, out, expected = killed
    chance = random.Random(7)
    work = out / WORK_FOLDER
    files = sorted(path.relative_to(work) for path in work.rglob("*") if path.is_file())
    kinds = {}
    for path in files:
        kinds.setdefault(kind_of(path), []).append(path)
    assert len(kinds) > 5
    chosen = list(kinds.items())
    if damage is not flip_a_bit:  # each kind is damaged in one of the other ways as well
        chosen = chosen[DAMAGE.index(damage) - 1 :: len(DAMAGE) - 1]
    for kind, of_kind in chosen:
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        shutil.copytree(out, tmp_path / "out")
        damage(tmp_path / "out" / WORK_FOLDER / chance.choice(of_kind), chance.random())
        run_status(tmp_path / "out")
        report = cleaned(map_file, tmp_path / "out", wanted)
        assert results(tmp_path / "out") == expected, kind
        assert all("not as it was written" in each for each in told_by(report)), report.warnings
    assert results(out.parent / "whole") == expected


def test_many_damaged_files_are_made_again(killed, tmp_path):
    map_file, wanted, out, expected = killed
    chance = random.Random(8)
    for _ in range(2):
        shutil.rmtree(tmp_path / "out", ignore_errors=True)
        shutil.copytree(out, tmp_path / "out")
        work = tmp_path / "out" / WORK_FOLDER
        files = [path for path in sorted(work.rglob("*")) if path.is_file()]
        for path in chance.sample(files, len(files) // 3):
            chance.choice(DAMAGE)(path, chance.random())
        folders = [path for path in sorted(work.rglob("*")) if path.is_dir()]
        shutil.rmtree(chance.choice(folders))
        cleaned(map_file, tmp_path / "out", wanted)
        assert results(tmp_path / "out") == expected


def test_nothing_is_done_again_where_nothing_is_damaged(killed, tmp_path, monkeypatch):
    map_file, wanted, out, expected = killed
    shutil.copytree(out, tmp_path / "kept")
    before = {path.relative_to(out / WORK_FOLDER) for path in (out / WORK_FOLDER).glob("*/*.done")}
    done = set()
    do_task = stages.do_task

    def spy(stage, folder, number):
        done.add(Path(stage, f"{number:06d}.done"))
        return do_task(stage, folder, number)

    monkeypatch.setattr(stages, "do_task", spy)
    report = cleaned(map_file, out, wanted)
    found = results(out)
    shutil.rmtree(out)
    (tmp_path / "kept").rename(out)
    assert not before & done
    assert told_by(report) == []
    assert found == expected


def test_damage_under_a_running_run_is_not_blamed_on_the_map(
    tmp_path, monkeypatch, capsys, nothing_waits_for_the_disk
):
    map_file = npy_map(tmp_path)
    settings = [word for each in SETTINGS for word in ("--set", each)]
    command = ["dynahull-pipeline", "run", str(map_file), "-o", str(tmp_path / "out"), *settings]
    monkeypatch.setattr("sys.argv", command)
    monkeypatch.setattr("logging.basicConfig", lambda **_: None)
    monkeypatch.setattr(cli.signal, "signal", lambda *_: None)
    for stage, name in [
        ("chunk", "cut/000000.arrays"),
        ("density", "ground/000001.arrays"),
        ("density", "free/*.parquet"),
        ("density", "clusters.arrays"),
        ("label", "cuts.json"),
        ("label", "density/000001.arrays"),
    ]:
        for damage in (empty, delete, cut_short):
            task = stages.TASKS[stage]

            def damaging(job, number, task=task, damage=damage, name=name):
                for path in job.root.glob(name):
                    if path.stat().st_size:
                        damage(path, 0.01)  # all that is there is needed
                return task(job, number)

            with monkeypatch.context() as patch:
                patch.setitem(stages.TASKS, stage, damaging)
                with pytest.raises(SystemExit) as ended:
                    cli.main()
            assert ended.value.code == 1
            error = [line for line in capsys.readouterr().err.splitlines() if "error:" in line]
            assert len(error) == 1, name
            assert "Traceback" not in error[0]
            assert "the map" not in error[0].replace("the same command", "")
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 0
