"""The picture: which points are in which pixel, and in which colour."""

import sys

import numpy as np
import pytest
from matplotlib import image as images

from dynahull.observer import SilentObserver
from pipeline.errors import EvaluationError, MissingPackageError, OutputError
from pipeline.evaluation.picture import (
    COLOURS,
    colour_pixels,
    decision_counts,
    draw_picture,
)
from tests.pipeline.evaluation.clouds import cut, source_of

GREY, GREEN, BLUE, RED = COLOURS.values()
WHITE = (1.0, 1.0, 1.0)


@pytest.fixture
def scored(tmp_path):
    # Left to right: static kept, moved removed, static removed, moved kept, unlabelled, invalid.
    points = np.array(
        [[0.0, 0, 5], [1.2, 0, 5], [2.2, 0, 5], [3.2, 1.9, 5], [90, 0, 5], [np.nan, 0, 5]]
    )
    labels = np.array([0, 1, 0, 1, 2, 2], dtype=np.int8)
    removed = np.array([0, 1, 1, 0, 0, 0], dtype=bool)
    source = source_of(tmp_path / "map.npy", points, labels, removed)
    return cut(tmp_path / "cut", 3, map=source)["map"]


def test_points_are_counted_in_their_pixels(scored):
    counts, (left, right, bottom, top) = decision_counts(scored, 4)
    size = 3.2 / 4
    assert counts.shape == (4, 3, 5)
    assert counts.sum() == 4
    assert (left, bottom) == (0, 0)
    assert (right, top) == pytest.approx((5 * size, 3 * size))
    for decision, line, column in ((0, 0, 0), (1, 0, 1), (2, 0, 2), (3, 2, 4)):
        assert counts[decision, line, column] == 1


def test_one_place_is_one_pixel(tmp_path):
    source = source_of(tmp_path / "map.npy", np.ones((3, 3)), removed=np.zeros(3, dtype=bool))
    cloud = cut(tmp_path / "cut", map=source)["map"]
    assert decision_counts(cloud, 10)[0].tolist() == [
        [[3]],
        [[0]],
        [[0]],
        [[0]],
    ]


@pytest.mark.parametrize(
    ("kept", "right", "wrong", "missed", "colour"),
    [
        (0, 0, 0, 0, WHITE),
        (1, 0, 0, 0, GREY),
        (9, 0, 8, 0, GREY),
        (9, 0, 9, 0, BLUE),
        (0, 0, 1, 0, BLUE),
        (9, 1, 0, 0, GREEN),
        (0, 2, 9, 1, GREEN),
        (9, 2, 9, 2, RED),
    ],
)
def test_a_pixel_shows_the_commonest_and_the_worse_of_two(kept, right, wrong, missed, colour):
    image = colour_pixels(np.array([kept, right, wrong, missed]).reshape(4, 1, 1))
    assert tuple(image[0, 0]) == colour


def test_the_file_shows_every_colour(tmp_path):
    # A square full of points for each decision, side by side.
    square = np.stack(np.meshgrid(np.arange(60), np.arange(60), [0]), axis=-1).reshape(-1, 3) / 60
    points = np.concatenate([square + [shift, 0, 0] for shift in range(4)])
    labels = np.repeat(np.array([0, 1, 0, 1], dtype=np.int8), len(square))
    removed = np.repeat([False, True, True, False], len(square))
    source = source_of(tmp_path / "map.npy", points, labels, removed)
    cloud = cut(tmp_path / "cut", 5000, map=source)["map"]
    draw_picture(cloud, tmp_path / "map.png", SilentObserver())
    pixels = images.imread(tmp_path / "map.png")[..., :3].reshape(-1, 3)
    for colour in COLOURS.values():
        # A square of 300 by 300, less the gaps between its points; the legend's patch has 500.
        assert (np.abs(pixels - colour).max(axis=1) < 0.005).sum() > 20_000
    assert sorted(path.name for path in tmp_path.iterdir()) == ["cut", "map.npy", "map.png"]


def test_what_cannot_be_drawn_is_one_line(scored, tmp_path, monkeypatch):
    source = source_of(tmp_path / "none.npy", np.ones((6, 3)), np.full(6, 2, dtype=np.int8))
    nothing = cut(tmp_path / "none", map=source)["map"]
    with pytest.raises(EvaluationError, match="expected labelled points"):
        draw_picture(nothing, tmp_path / "map.png", SilentObserver())
    with pytest.raises(OutputError, match=r"map\.png: No such file"):
        draw_picture(scored, tmp_path / "nowhere" / "map.png", SilentObserver())
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingPackageError, match="needs Matplotlib: pip install"):
        draw_picture(scored, tmp_path / "map.png", SilentObserver())
