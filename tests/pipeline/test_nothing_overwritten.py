"""Attacks on what is the user's: maps that a command reads, and files beside its outputs."""

import errno
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path

import laspy
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import yaml

from pipeline import run as run_module
from pipeline.configuration.run import load_configuration
from pipeline.errors import OutputError
from pipeline.evaluation.inputs import EvaluationOptions
from pipeline.evaluation.report import evaluate_files
from pipeline.outputs import folder as outputs
from pipeline.outputs.folder import output_folder
from pipeline.planning import plan_map, tile_map
from pipeline.preview import WHOLE, preview
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.simulation import SimulationParameters, write_simulation
from pipeline.view import view_result
from tiling.formats import open_map
from tiling.output_file import create_file, write_only, writing_only_into

pytestmark = pytest.mark.usefixtures("nothing_waits_for_the_disk")

FAST = [
    "output.labels=false",
    "ground.method=none",
    "neighbours.k=8",
    "clustering.count=2",
    "execution.workers=1",
]
TILED = [*FAST, "tiling.max_points=150", "tiling.halo=0.5"]
FORMATS = ("npy", "pcd", "ply", "parquet", "laz", "npz")


def points(count=400, seed=0):
    return np.random.default_rng(seed).uniform(size=(count, 3)).round(3) * [8, 8, 2]


def save(path, count=400, seed=0):
    path.parent.mkdir(parents=True, exist_ok=True)
    np.save(path, points(count, seed))
    return path


def configuration(*settings, base=FAST):
    return load_configuration(None, [*base, *settings])


def observer():
    return StageObserver(LogDisplay())


def clean(maps, output, *settings, base=FAST):
    return run(
        [str(each) for each in maps], output, configuration(*settings, base=base), observer()
    )


def state(folder):
    """Return the bytes of every file below a folder, by name."""
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in folder.rglob("*")
        if path.is_file()
    }


@pytest.mark.parametrize("base", [FAST, TILED])
def test_files_of_one_name_given_through_dots_stay(tmp_path, monkeypatch, base):
    save(tmp_path / "w/q/c/a.npy")
    save(tmp_path / "maps/a.npy", seed=1)
    before = state(tmp_path)
    monkeypatch.chdir(tmp_path / "w/q/c")
    clean(["a.npy", "../../../maps/a.npy"], tmp_path / "out", base=base)
    after = state(tmp_path)
    assert {name: after[name] for name in before} == before
    written = sorted(name for name in after if name.endswith("a.npy") and name not in before)
    assert written == [
        f"out/{kind}/{name}"
        for kind in ("dynamic", "static")
        for name in ("maps/a.npy", "w/q/c/a.npy")
    ]


def test_files_of_one_name_through_links_of_folders_stay(tmp_path, monkeypatch):
    save(tmp_path / "disk/deep/a.npy")
    save(tmp_path / "disk/a.npy", seed=1)
    (tmp_path / "here").mkdir()
    (tmp_path / "here/link").symlink_to(tmp_path / "disk/deep")
    before = state(tmp_path)
    monkeypatch.chdir(tmp_path / "here")
    clean(["link/a.npy", "link/../a.npy"], tmp_path / "out")
    after = state(tmp_path)
    assert {name: after[name] for name in before} == before


@pytest.mark.parametrize("suffix", FORMATS)
def test_no_writer_leaves_the_folder_nor_writes_over_a_file(tmp_path, suffix):
    source = map_of(suffix, tmp_path)
    reader = open_map(source)
    (tmp_path / "out").mkdir()
    taken = tmp_path / f"out/taken.{suffix}"
    taken.write_text("mine")
    (tmp_path / f"out/link.{suffix}").symlink_to(source)
    before = state(tmp_path)
    with writing_only_into(tmp_path / "out"):
        for name in (f"../{source.name}", f"../new.{suffix}"):
            with pytest.raises(PermissionError, match="outside the output folder"):
                reader.writer(tmp_path / "out" / name, 10)
        for name in ("taken", "link"):
            with pytest.raises(FileExistsError):
                reader.writer(tmp_path / f"out/{name}.{suffix}", 10)
    assert state(tmp_path) == before


def map_of(suffix, folder):
    path = folder / f"map.{suffix}"
    if suffix == "npy":
        return save(path, 10)
    if suffix == "npz":
        np.savez(path, points=points(10))
    elif suffix == "parquet":
        with path.open("wb") as file:  # by name Arrow writes UTF-8 names only
            pq.write_table(pa.table(dict(zip("xyz", points(10).T, strict=True))), file)
    elif suffix == "laz":
        las = laspy.create(point_format=6, file_version="1.4")
        las.x, las.y, las.z = points(10).T
        las.write(path)
    else:
        head = {
            "pcd": "VERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 10\n"
            "HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 10\nDATA ascii\n",
            "ply": "ply\nformat ascii 1.0\nelement vertex 10\nproperty float x\nproperty float y\n"
            "property float z\nend_header\n",
        }
        rows = "".join(f"{x} {y} {z}\n" for x, y, z in points(10).tolist())
        path.write_text(head[suffix] + rows)
    return path


def test_files_are_opened_for_writing_within_the_folder_alone(tmp_path):
    inside, outside = tmp_path / "out", tmp_path / "map.npy"
    inside.mkdir()
    outside.write_text("mine")
    (inside / "elsewhere").symlink_to(tmp_path)
    with writing_only_into(inside):
        create_file(inside / "new").close()
        write_only(inside / "new").close()
        for path in (outside, inside / "../map.npy", inside / "elsewhere/map.npy"):
            for opened in (create_file, write_only):
                with pytest.raises(PermissionError):
                    opened(path)
    assert outside.read_text() == "mine"


def alias_by_hard_link(path, folder):
    os.link(path, folder / "alias.npy")
    return folder / "alias.npy"


def alias_by_link(path, folder):
    (folder / "alias.npy").symlink_to(path)
    return folder / "alias.npy"


def alias_by_path(path, folder):
    (folder / "deep").mkdir()
    return folder / "deep" / ".." / path.relative_to(folder)


ALIASES = [alias_by_hard_link, alias_by_link, alias_by_path]


@pytest.mark.parametrize("alias", ALIASES)
@pytest.mark.parametrize("result", ["static.npy", "dynamic.npy"])
def test_an_input_that_is_also_a_result_is_refused_by_any_name(tmp_path, alias, result):
    clean([save(tmp_path / "map.npy")], tmp_path / "out")
    given = alias(tmp_path / "out" / result, tmp_path)
    before = state(tmp_path)
    for settings in ([], ["output.mode=label"]):  # results replaced, and results only removed
        with pytest.raises(OutputError, match="this input lies where a result goes"):
            clean([given], tmp_path / "out", *settings)
        assert state(tmp_path) == before


def test_an_earlier_result_among_several_inputs_is_not_removed(tmp_path):
    clean([save(tmp_path / "map.npy")], tmp_path / "out")
    before = state(tmp_path)
    with pytest.raises(OutputError, match="this input lies where a result goes"):
        clean([tmp_path / "out/static.npy", tmp_path / "out/dynamic.npy"], tmp_path / "out")
    assert state(tmp_path) == before


def test_two_results_that_a_file_system_takes_for_one_are_refused_before_any_work(
    tmp_path, monkeypatch
):
    """As file systems do that know no capitals."""
    made = set()

    def create(path):
        name = str(path).casefold()
        if name in made:
            raise FileExistsError(errno.EEXIST, "File exists", str(path))
        made.add(name)
        return create_file(path)

    monkeypatch.setattr(outputs, "create_file", create)
    maps = [save(tmp_path / "maps/A.npy"), save(tmp_path / "maps/a.npy", seed=1)]
    monkeypatch.setattr(run_module, "content_hash", lambda paths: pytest.fail("the work began"))
    with pytest.raises(OutputError, match=r"a\.npy: two files of the map would be written here"):
        clean(maps, tmp_path / "out")


@pytest.mark.parametrize("place", [".dynahull-partial", ".dynahull-work/tiles"])
def test_an_input_within_a_folder_that_is_emptied_is_refused(tmp_path, place):
    given = save(tmp_path / "out" / place / "map.npy")
    before = state(tmp_path)
    for command in (
        lambda: clean([given], tmp_path / "out"),
        lambda: tile([given], tmp_path / "out"),
    ):
        with pytest.raises(OutputError, match="this input lies where a run works"):
            command()
        assert state(tmp_path) == before


def tile(maps, output):
    return tile_map([str(each) for each in maps], output, configuration(base=TILED), observer())


@pytest.mark.parametrize("name", [".dynahull-partial", ".dynahull-work", ".dynahull-work-removed"])
def test_a_link_in_the_place_of_a_run_s_own_folder_is_refused(tmp_path, name):
    given = save(tmp_path / "map.npy")
    save(tmp_path / "precious/thesis.npy")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(tmp_path / "precious")
    before = state(tmp_path)
    for command in (clean, tile):
        with pytest.raises(OutputError, match="found a link"):
            command([given], tmp_path / "out")
        assert state(tmp_path) == before


def test_a_result_folder_that_is_a_link_elsewhere_is_refused(tmp_path):
    maps = [save(tmp_path / "maps/a.npy"), save(tmp_path / "maps/b.npy", seed=1)]
    (tmp_path / "out").mkdir()
    (tmp_path / "out/static").symlink_to(tmp_path / "maps")
    before = state(tmp_path / "maps")
    with pytest.raises(OutputError, match="found a link out of"):
        clean(maps, tmp_path / "out")
    # What an earlier run is said to have written there is not removed either.
    report = {"version": "1", "input_hash": "0", "outputs": ["static/a.npy", "run.json"]}
    (tmp_path / "out/run.json").write_text(json.dumps(report))
    with pytest.raises(OutputError, match="found a link out of"):
        clean(maps[:1], tmp_path / "out")
    assert state(tmp_path / "maps") == before


def test_a_list_of_outputs_that_no_run_wrote_removes_nothing(tmp_path):
    given = save(tmp_path / "map.npy")
    (tmp_path / "out").mkdir()
    (tmp_path / "out/thesis.tex").write_text("mine")
    names = ["thesis.tex", "../map.npy", str(given), "run.json", "static/../../map.npy"]
    report = {"version": "1", "input_hash": "0", "outputs": names}
    (tmp_path / "out/run.json").write_text(json.dumps(report))
    clean([given], tmp_path / "out")
    assert (tmp_path / "out/thesis.tex").read_text() == "mine"
    assert given.is_file()


def test_a_file_that_appears_while_a_run_works_is_not_replaced(tmp_path):
    results = [Path("static.npy"), Path("run.json")]
    with (
        pytest.raises(OutputError, match="no run wrote"),
        output_folder(tmp_path / "out", results) as staging,
    ):
        (staging / "static.npy").write_text("new")
        (staging / "run.json").write_text("{}")
        (tmp_path / "out/static.npy").write_text("mine")
    assert (tmp_path / "out/static.npy").read_text() == "mine"


def publish_and_die(folder, renames):
    """Publish results in a process that dies after so many of them are renamed."""
    process = os.fork()
    if not process:
        rename, done = Path.replace, []

        def replace(path, target):
            if len(done) == renames:
                os._exit(9)
            done.append(rename(path, target))

        Path.replace = replace
        results = [Path("dynamic.npy"), Path("static.npy"), Path("run.json")]
        with output_folder(folder, results) as staging:
            for name in results:
                (staging / name).write_text("new")
        os._exit(0)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 9


@pytest.mark.parametrize("renames", [0, 1, 2])
def test_of_a_publishing_that_was_killed_only_its_own_files_make_way(tmp_path, renames):
    folder = tmp_path / "out"
    given = save(tmp_path / "map.npy")
    clean([given], folder)
    publish_and_die(folder, renames)
    (folder / "labels.parquet").write_text("mine")
    with pytest.raises(OutputError, match="no run wrote"):
        clean([given], folder, "output.labels=true")
    assert (folder / "labels.parquet").read_text() == "mine"
    clean([given], folder)
    assert (folder / "run.json").is_file()
    if renames:
        publish_and_die(folder, renames)
        (folder / "dynamic.npy").write_text("mine now")
        with pytest.raises(OutputError, match="no run wrote"):
            clean([given], folder)
        assert (folder / "dynamic.npy").read_text() == "mine now"


def test_the_part_of_a_preview_replaces_nothing(tmp_path):
    given = save(tmp_path / "hall.npy", 3_000)
    for name in ("part_hall.npy", "part_1_hall.npy"):
        (tmp_path / "out").mkdir(exist_ok=True)
        (tmp_path / "out" / name).write_text("mine")
    before = state(tmp_path)
    for _ in range(2):
        preview(
            [str(given)], tmp_path / "out", configuration(), observer(), points=1_000, window=WHOLE
        )
    after = state(tmp_path)
    assert {name: after[name] for name in before} == before


def test_the_part_of_a_preview_is_not_written_through_a_link(tmp_path):
    given = save(tmp_path / "hall.npy", 3_000)
    (tmp_path / "out").mkdir()
    (tmp_path / "out/.dynahull-preview").symlink_to(tmp_path)
    with pytest.raises(OutputError, match="found a link"):
        preview(
            [str(given)], tmp_path / "out", configuration(), observer(), points=1_000, window=WHOLE
        )


def test_a_picture_of_a_plan_replaces_no_map(tmp_path):
    pytest.importorskip("matplotlib")
    given = save(tmp_path / "map.npy")
    linked = tmp_path / "linked.png"
    linked.symlink_to(given)
    before = state(tmp_path)
    for picture, reason in ((given, "ends in .png"), (linked, "this is what is read")):
        with pytest.raises(OutputError, match=reason):
            plan_map([str(given)], configuration(), observer(), picture)
        assert state(tmp_path) == before
    (tmp_path / "other.npy").write_text("mine")
    (tmp_path / "plan.png").symlink_to(tmp_path / "other.npy")
    plan_map([str(given)], configuration(), observer(), tmp_path / "plan.png")
    assert (tmp_path / "other.npy").read_text() == "mine"
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")


def test_figures_of_an_evaluation_replace_nothing_that_it_reads(tmp_path):
    given = save(tmp_path / "map.npy")
    clean([given], tmp_path / "out")
    before = state(tmp_path)
    for figures in (tmp_path / "out/run.json", given):
        with pytest.raises(OutputError, match=r"this is what is read|ends in \.json"):
            evaluate_files(str(tmp_path / "out"), str(given), None, EvaluationOptions(), figures)
        assert state(tmp_path) == before


def test_a_recording_replaces_no_map(tmp_path):
    clean([save(tmp_path / "map.npy")], tmp_path / "out")
    before = state(tmp_path)
    for place in ("out/static.npy", "map.npy"):
        with pytest.raises(OutputError, match=r"ends in \.rrd"):
            view_result(tmp_path / "out", tmp_path / place)
        assert state(tmp_path) == before


SCENE = SimulationParameters(scans=2, walkers=1)


@pytest.mark.parametrize("name", ["map.pcd", "truth.parquet", "scans/000001.pcd", "times.txt"])
def test_a_simulation_replaces_only_simulations(tmp_path, name):
    folder = tmp_path / "mine"
    (folder / name).parent.mkdir(parents=True)
    (folder / name).write_text("mine")
    (folder / "simulation.yaml").write_text(yaml.safe_dump(["not a simulation's"]))
    with pytest.raises(OutputError, match="no simulation wrote"):
        write_simulation(SCENE, folder, map_only=True)
    assert (folder / name).read_text() == "mine"


def test_scans_of_a_simulation_are_not_looked_for_through_a_link(tmp_path):
    write_simulation(SCENE, tmp_path / "sim", map_only=True)
    (tmp_path / "scans").mkdir()
    (tmp_path / "scans/000000.pcd").write_text("mine")
    (tmp_path / "sim/scans").symlink_to(tmp_path / "scans")
    with pytest.raises(OutputError, match="found a link"):
        write_simulation(SCENE, tmp_path / "sim", map_only=True)
    assert (tmp_path / "scans/000000.pcd").read_text() == "mine"


def test_tiles_take_no_folder_of_the_user_s_back(tmp_path):
    """As `tile` does with what it published itself before it was killed."""
    folder = tmp_path / "out"
    (folder / ".dynahull-work/tiles").mkdir(parents=True)
    (folder / "chunks").mkdir()
    (folder / "chunks/thesis.tex").write_text("mine")
    with pytest.raises(OutputError, match="expected an empty folder"):
        tile([save(tmp_path / "map.npy")], folder)
    assert (folder / "chunks/thesis.tex").read_text() == "mine"


WATCH = """
import os, sys
LOG = os.environ["WATCHED"]
WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
CHANGES = {"os.rename": (0, 1), "os.remove": (0,), "os.rmdir": (0,), "os.link": (0, 1),
           "os.symlink": (1,), "os.truncate": (0,), "os.chmod": (0,), "os.mkdir": (0,)}

def log(line):
    # Opened each time: a fork closes what it does not know.
    handle = os.open(LOG, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    os.write(handle, line + b"\\n")
    os.close(handle)

def note(event, arguments):
    if event == "open" and arguments[0] == LOG:
        return
    try:
        if event == "open" and isinstance(arguments[0], (str, bytes)) and arguments[2] & WRITING:
            places = arguments[:1]
        elif event in CHANGES:
            places = [arguments[index] for index in CHANGES[event]]
            folder = arguments[-1] if event in ("os.remove", "os.rmdir", "os.mkdir") else -1
            if folder != -1:
                places = [os.path.join(os.readlink(f"/proc/self/fd/{folder}"), *places)]
        else:
            return
        for place in places:
            if not isinstance(place, int):
                log(os.fsencode(os.path.abspath(os.fsdecode(place))))
    except Exception as error:
        log(f"watching failed: {event} {error!r}".encode())

sys.addaudithook(note)
"""


@pytest.mark.linux_only
@pytest.mark.parametrize(
    "command",
    [
        ["run", "-o", "out"],
        ["run", "-o", "out", "--labels", "--set", "tiling.max_points=150"],
        ["run", "-o", "out", "--set", "output.mode=label", "--set", "tiling.max_points=150"],
        ["preview", "-o", "out", "--thin", "--points", "1000"],
        ["tile", "-o", "out", "--set", "tiling.max_points=150"],
    ],
)
def test_nothing_but_the_output_folder_is_ever_opened_for_writing(tmp_path, command):
    """By all processes of a command, as Python itself tells it."""
    save(tmp_path / "maps/w/q/c/a.npy", 1_500)
    save(tmp_path / "maps/a.npy", 1_500, seed=1)
    for name in ("watch", "tmp"):
        (tmp_path / name).mkdir()
    (tmp_path / "watch/sitecustomize.py").write_text(WATCH)
    settings = [f"--set={each}" for each in (*FAST[:-1], "execution.workers=2", "tiling.halo=0.5")]
    if command[0] == "preview":
        settings.append("--set=tiling.max_points=100000")
    environment = os.environ | {
        "PYTHONPATH": str(tmp_path / "watch"),
        "WATCHED": str(tmp_path / "watched"),
        "TMPDIR": str(tmp_path / "tmp"),
    }
    before = state(tmp_path / "maps")
    maps = ["a.npy", "../../../a.npy"]
    words = [*command, "-o", str(tmp_path / "out"), *maps, *settings]
    program = [sys.executable, "-c", "from pipeline.commands.app import main; main()"]
    subprocess.run([*program, *words], cwd=tmp_path / "maps/w/q/c", env=environment, check=True)
    assert state(tmp_path / "maps") == before
    places = {Path(line) for line in (tmp_path / "watched").read_text().splitlines()}
    assert places, "nothing was watched"
    own = [tmp_path / "out", tmp_path / "tmp", Path("/dev")]
    # Compiled code is kept where Python finds it, see `dynahull.compilation`.
    own += [Path.home() / ".cache", Path(__file__).resolve().parents[2]]
    # Sockets lie in a private folder of a shorter name, see `pipeline.temporary`.
    own += [
        each for each in places if each.parent == Path("/tmp") and each.name.startswith("dynahull-")
    ]
    foreign = [each for each in places if not any(each.is_relative_to(place) for place in own)]
    assert foreign == []
