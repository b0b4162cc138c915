"""What is shown of a result: recordings that Rerun itself reads; a window needs a screen."""

import re
import shutil
import subprocess
import sys
from ctypes.util import find_library
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

from dynahull import Label
from pipeline import view
from pipeline.configuration.run import load_configuration
from pipeline.errors import MissingViewerError, OutputError
from pipeline.outputs.reading import read_result
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.view import (
    LABEL_COLOURS,
    density_colours,
    open3d_cloud,
    view_result,
    view_with_open3d,
)

POINTS = np.random.default_rng(0).normal(size=(500, 3)) + 1e6
POINTS[3] = np.nan


def result(folder, *wanted, suffix=".npy", files=1):
    """Clean the points, in one file or several, and return the output folder."""
    names = [folder / f"map_{number}{suffix}" for number in range(files)]
    for name, part in zip(names, np.array_split(POINTS, files), strict=True):
        if suffix == ".npy":
            np.save(name, np.rec.fromarrays(part.T, names="x,y,z"))
        else:
            text = (
                f"FIELDS x y z\nSIZE 8 8 8\nTYPE F F F\nWIDTH {len(part)}\nHEIGHT 1\nDATA ascii\n"
            )
            name.write_text(text + "".join(f"{x} {y} {z}\n" for x, y, z in part.tolist()))
    settings = ["ground.method=none", "neighbours.k=20", "clustering.count=1"]
    configuration = load_configuration("paper", [*settings, "output.report=none", *wanted])
    run(names, folder / "out", configuration, StageObserver(LogDisplay()))
    return folder / "out"


def by_place(points):
    order = np.lexsort(points.xyz.T)
    density = None if points.density is None else points.density[order]
    return points.xyz[order], points.labels[order], density


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """Points, labels and densities of a run that kept all, in the order of the input."""
    return read_result(result(tmp_path_factory.mktemp("known"), "output.labels=true"))


def test_points_come_in_the_order_of_the_input_where_labels_are_kept(known):
    np.testing.assert_array_equal(known.xyz, np.delete(POINTS, 3, axis=0))
    assert np.count_nonzero(known.labels == Label.DYNAMIC) == 24
    limit = known.density[known.labels == Label.DYNAMIC].max()
    assert (known.density[known.labels == Label.STATIC] >= limit).all()


@pytest.mark.parametrize("suffix", [".npy", ".pcd"])
@pytest.mark.parametrize("files", [1, 3])
@pytest.mark.parametrize(
    "wanted",
    [("output.mode=label",), ("output.mode=label", "output.labels=true"), ("output.labels=true",)],
)
def test_every_kind_of_output_tells_the_same(tmp_path, known, suffix, files, wanted):
    points = read_result(result(tmp_path, *wanted, suffix=suffix, files=files))
    np.testing.assert_array_equal(points.xyz, known.xyz)
    np.testing.assert_array_equal(points.labels, known.labels)
    np.testing.assert_array_equal(points.density, known.density)


def test_two_maps_tell_what_stays_and_what_goes(tmp_path, known):
    points = read_result(result(tmp_path, "output.labels=false"))
    assert points.density is None
    for found, expected in zip(by_place(points)[:2], by_place(known)[:2], strict=True):
        np.testing.assert_array_equal(found, expected)


def test_labels_of_other_points_are_refused(tmp_path):
    folder = result(tmp_path, "output.labels=true")
    np.save(folder / "static.npy", np.load(folder / "static.npy")[:-1])
    with pytest.raises(OutputError, match="500 labels: files were changed since the run"):
        read_result(folder)


@pytest.mark.parametrize("content", ["[]", "{}", "nothing", '{"files": 3}'])
def test_a_folder_without_a_result_is_refused(tmp_path, content):
    with pytest.raises(OutputError, match=r"found no run\.json"):
        read_result(tmp_path)
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(OutputError, match=r"run\.json: .* found a damaged file"):
        read_result(tmp_path)


def test_densities_have_the_colour_of_their_rank():
    density = np.array([3.0, np.nan, 1.0, np.inf, 2.0])
    colours = density_colours(density)
    assert colours[2].tolist() == [68, 1, 84]
    assert colours[3].tolist() == [253, 231, 37]
    assert colours[1].tolist() == list(view.UNSCORED_COLOUR)
    assert len({tuple(colour) for colour in colours.tolist()}) == 5
    assert density_colours(np.empty(0)).shape == (0, 3)


def test_the_recording_is_one_that_rerun_reads(tmp_path, known):
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    view_result(result(tmp_path, "output.labels=true"), tmp_path / "map.rrd")
    command = [sys.executable, "-m", "rerun", "rrd", "print", "-v", str(tmp_path / "map.rrd")]
    ended = subprocess.run(command, capture_output=True, text=True, check=True)
    entities = re.findall(r"- (/\S*) - data columns: \[(.*)\]", ended.stdout)
    drawn = {entity: columns for entity, columns in entities if "Points3D:positions" in columns}
    assert set(drawn) == {"/label/static", "/label/dynamic", "/density/scored"}
    assert all("Points3D:colors" in columns for columns in drawn.values())
    assert any("ViewCoordinates" in columns for entity, columns in entities if entity == "/")


class Stream:
    """Takes what is logged, in place of Rerun's."""

    logged: dict[str, SimpleNamespace]

    def __init__(self, *_, **__):
        Stream.logged = {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def __getattr__(self, name):
        return lambda *_, **__: None

    def log(self, entity, what, static):
        assert static
        Stream.logged[entity] = what


def fake_rerun():
    blueprint = SimpleNamespace(
        **{
            name: lambda *_, **__: None
            for name in (
                *("Blueprint", "Horizontal", "Spatial3DView"),
                *("BlueprintPanel", "SelectionPanel", "TimePanel"),
            )
        }
    )
    return SimpleNamespace(
        blueprint=blueprint,
        RecordingStream=Stream,
        AnyValues=dict,
        ViewCoordinates=SimpleNamespace(RIGHT_HAND_Z_UP="z up"),
        Radius=SimpleNamespace(ui_points=float),
        Points3D=lambda xyz, colors, radii: SimpleNamespace(xyz=xyz, colours=colors),
    )


def test_every_point_is_drawn_once_by_label_and_once_by_density(tmp_path, known):
    view.write_recording(fake_rerun(), known, "map", tmp_path / "map.rrd")
    logged = Stream.logged
    assert len(logged["/label/dynamic"].xyz) == 24
    assert logged["/label/dynamic"].colours == [view.LABEL_COLOURS[Label.DYNAMIC]]
    assert len(logged["/label/static"].xyz) == len(known.xyz) - 24
    assert len(logged["/density/scored"].xyz) == len(known.xyz)
    drawn = logged["/density/scored"].xyz
    assert drawn.dtype == np.float32 and drawn.min() == 0
    np.testing.assert_allclose(drawn, known.xyz - known.xyz.min(axis=0), atol=1e-6)


def test_without_rerun_one_line_says_how_to_get_it(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(MissingViewerError, match="needs Rerun: pip install"):
        view_result(tmp_path)


def test_without_a_screen_one_line_says_what_to_do(tmp_path, monkeypatch):
    monkeypatch.setattr(view, "_import_rerun", fake_rerun)
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(MissingViewerError, match=r"needs a screen, .* --save FILE\.rrd"):
        view_result(tmp_path)


def test_a_viewer_that_cannot_draw_is_an_error(tmp_path, monkeypatch):
    folder = result(tmp_path)
    monkeypatch.setattr(view, "_import_rerun", fake_rerun)
    monkeypatch.setenv("DISPLAY", ":0")
    commands = []

    def fail(command, check):
        commands.append(command)
        return SimpleNamespace(returncode=101)

    monkeypatch.setattr(subprocess, "run", fail)
    with pytest.raises(MissingViewerError, match="viewer ended with code 101"):
        view_result(folder)
    assert commands[0][:4] == [sys.executable, "-P", "-m", "rerun"]


def test_a_recording_goes_into_a_folder_that_is_there(tmp_path, monkeypatch):
    folder = result(tmp_path)
    monkeypatch.setattr(view, "_import_rerun", fake_rerun)
    with pytest.raises(OutputError, match=r"map\.rrd: expected a folder to write in"):
        view_result(folder, tmp_path / "none" / "map.rrd")


def drawing_program():
    """Return what opens a window on a machine that has neither a screen nor a GPU."""
    program = shutil.which("xvfb-run")
    if program is None:
        pytest.skip("the program xvfb-run is absent")
    if not list(Path("/usr/share/vulkan/icd.d").glob("lvp_icd*.json")):
        pytest.skip("no Vulkan that draws without a GPU (mesa-vulkan-drivers)")
    for library in ("X11", "Xcursor", "Xi", "xkbcommon-x11"):
        if find_library(library) is None:
            pytest.skip(f"the library {library} of the viewer's window is absent")
    return [program, "-a", "-s", "-screen 0 1000x700x24"]


def test_the_window_shows_both_views(tmp_path):
    pytest.importorskip("rerun", reason="the extra `rerun` is not installed")
    program = drawing_program()
    from PIL import Image  # noqa: PLC0415 (comes with matplotlib)

    recording, picture = tmp_path / "out.rrd", tmp_path / "window.png"
    view_result(result(tmp_path, "output.labels=true"), recording)
    ended = subprocess.run(
        [*program, sys.executable, "-m", "rerun", recording,
         "--screenshot-to", picture, "--window-size", "900x600"],
        capture_output=True, text=True, timeout=200, check=False,
    )  # fmt: skip
    assert ended.returncode == 0, ended.stderr
    shown = np.asarray(Image.open(picture).convert("RGB")).astype(int)
    left, right = np.array_split(shown[100:, 300:], 2, axis=1)

    def drawn(part, colour):
        return np.count_nonzero(np.abs(part - colour).max(axis=2) < 60)

    for label in (Label.STATIC, Label.DYNAMIC):
        assert drawn(left, LABEL_COLOURS[label][:3]) > 100
    darkest, brightest = density_colours(np.array([1.0, 2.0]))
    assert drawn(right, darkest) > 100
    assert drawn(right, brightest) > 20


def test_open3d_draws_the_same_points_by_label(known):
    open3d = pytest.importorskip("open3d", reason="Open3D is missing", exc_type=ImportError)
    cloud = open3d_cloud(open3d, known)
    corner = known.xyz.min(axis=0)
    np.testing.assert_allclose(np.asarray(cloud.points) + corner, known.xyz)
    red = np.asarray(cloud.colors)[known.labels == Label.DYNAMIC]
    np.testing.assert_allclose(red * 255, [LABEL_COLOURS[Label.DYNAMIC]] * len(red))


def test_without_a_screen_or_open3d_one_line_says_so(tmp_path, monkeypatch):
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    monkeypatch.setitem(sys.modules, "open3d", ModuleType("open3d"))
    with pytest.raises(MissingViewerError, match="needs a screen"):
        view_with_open3d(tmp_path)
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingViewerError, match="view needs Open3D: pip install"):
        view_with_open3d(tmp_path)
