"""What is shown of a result; the window itself needs a screen."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from pipeline.configuration import load_configuration
from pipeline.errors import MissingViewerError, OutputError
from pipeline.progress import LogDisplay, StageObserver
from pipeline.run import run
from pipeline.view import DYNAMIC_COLOUR, STATIC_COLOUR, read_result, view_result


@pytest.fixture
def result(tmp_path):
    points = np.random.default_rng(0).normal(size=(500, 3)) + 1e6
    points[3] = np.nan
    np.save(tmp_path / "map.npy", points)
    settings = ["ground.method=none", "neighbours.k=20", "clustering.count=1"]
    configuration = load_configuration(None, settings)
    run([tmp_path / "map.npy"], tmp_path / "out", configuration, StageObserver(LogDisplay()))
    return tmp_path / "out"


class Cloud:
    def __init__(self, points):
        self.points = points

    def paint_uniform_color(self, colour):
        self.colour = colour


def test_both_parts_are_read_near_the_origin(result):
    static, dynamic = read_result(result)
    assert len(static) + len(dynamic) == 499
    assert len(dynamic) == 24
    np.testing.assert_array_equal(np.vstack([static, dynamic]).min(axis=0), 0)
    assert np.vstack([static, dynamic]).max() < 20


def test_removed_points_are_drawn_in_a_colour_of_their_own(result, monkeypatch):
    shown = []
    viewer = SimpleNamespace(
        geometry=SimpleNamespace(PointCloud=Cloud),
        utility=SimpleNamespace(Vector3dVector=np.asarray),
        visualization=SimpleNamespace(
            draw_geometries=lambda clouds, window_name: shown.extend(clouds)
        ),
    )
    monkeypatch.setitem(sys.modules, "open3d", viewer)
    view_result(result)
    assert [cloud.colour for cloud in shown] == [STATIC_COLOUR, DYNAMIC_COLOUR]
    assert [len(cloud.points) for cloud in shown] == [475, 24]


def test_without_open3d_one_line_says_how_to_get_it(result, monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(MissingViewerError, match=r"pip install 'dynahull-pipeline\[open3d\]'"):
        view_result(result)


def test_a_folder_without_a_result_is_refused(tmp_path):
    with pytest.raises(OutputError, match=r"found no run\.json"):
        view_result(tmp_path)
