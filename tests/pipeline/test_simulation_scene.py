"""Rays meet the first surface on their way, at the exact distance, and never pass through it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.simulation.scene import Boxes, Cylinders, Surface, first_hits


def boxes(*corners, surface=Surface.WALL):
    array = np.array(corners, dtype=float).reshape(-1, 6)
    return Boxes(array[:, :3], array[:, 3:], np.full(len(array), surface, np.uint8))


def cylinders(*rows, surface=Surface.PERSON):
    x, y, radius, bottom, top = np.array(rows, dtype=float).reshape(-1, 5).T
    centre = np.stack([x, y], axis=1)[None]
    return Cylinders(centre, radius, bottom, top, np.full(len(x), surface, np.uint8))


def unit(*vectors):
    array = np.array(vectors, dtype=float).reshape(-1, 3)
    return array / np.linalg.norm(array, axis=1, keepdims=True)


def distances(bodies, origin, direction):
    directions = unit(direction)
    return first_hits(bodies, np.array([origin], dtype=float), directions).distance[0]


@pytest.mark.parametrize(
    ("origin", "direction", "expected"),
    [
        ((0, 0.5, 0.5), (1, 0, 0), 2.0),
        ((5, 0.5, 0.5), (-1, 0, 0), 2.0),
        ((0, 0.5, 0.5), (-1, 0, 0), np.inf),
        ((0, 1.5, 0.5), (1, 0, 0), np.inf),
        ((2.5, 0.5, 4.0), (0, 0, -1), 3.0),
        ((1, -0.5, 0.5), (1, 1, 0), np.sqrt(2)),
        ((2.5, 0.5, 0.5), (1, 0, 0), np.inf),
    ],
    ids=["front", "back", "behind", "beside", "above", "oblique", "from within"],
)
def test_box_is_met_where_geometry_says(origin, direction, expected):
    assert distances(boxes((2, 0, 0, 3, 1, 1)), origin, direction) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("origin", "direction", "expected"),
    [
        ((0, 0, 1), (1, 0, 0), 2.5),
        ((0, 0.3, 1), (1, 0, 0), 3 - 0.4),
        ((0, 0.51, 1), (1, 0, 0), np.inf),
        ((3, 0, 5), (0, 0, -1), 3.0),
        ((3.6, 0, 5), (0, 0, -1), np.inf),
        ((0, 0, 3), (3, 0, -1), np.sqrt(10)),
        ((0, 0, 2.1), (1, 0, 0), np.inf),
        ((3, 0, 1), (1, 0, 0), np.inf),
    ],
    ids=["middle", "chord", "beside", "above", "past the rim", "cap", "over it", "from within"],
)
def test_cylinder_is_met_where_geometry_says(origin, direction, expected):
    assert distances(cylinders((3, 0, 0.5, 0, 2)), origin, direction) == pytest.approx(expected)


def test_cylinder_may_stand_elsewhere_for_each_ray():
    person = cylinders((0, 0, 0.5, 0, 2))
    centre = np.array([[[3.0, 0.0]], [[7.0, 0.0]], [[7.0, 9.0]]])
    walking = Cylinders(centre, person.radius, person.bottom, person.top, person.surface)
    origins = np.tile([0.0, 0.0, 1.0], (3, 1))
    hits = first_hits(walking, origins, unit((1, 0, 0), (1, 0, 0), (1, 0, 0)))
    assert hits.distance == pytest.approx([2.5, 6.5, np.inf])


def test_nearer_of_two_hits_brings_its_surface():
    origins, directions = np.array([[0.0, 0.0, 1.0]] * 2), unit((1, 0, 0), (0, 1, 0))
    wall = first_hits(boxes((5, -9, 0, 6, 9, 3), (-9, 2, 0, 9, 3, 3)), origins, directions)
    person = first_hits(cylinders((3, 0, 0.5, 0, 2), (0, 4, 0.5, 0, 2)), origins, directions)
    for hits in (wall.nearer(person), person.nearer(wall)):
        assert hits.distance == pytest.approx([2.5, 2.0])
        assert hits.surface.tolist() == [Surface.PERSON, Surface.WALL]


def test_no_bodies_no_hits():
    hits = first_hits(boxes(), np.zeros((3, 3)), unit((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    assert np.isinf(hits.distance).all()


coordinate = st.floats(-3, 3)
size = st.floats(0.1, 2)


@settings(deadline=None, max_examples=150)
@given(
    box=st.tuples(coordinate, coordinate, coordinate, size, size, size),
    cylinder=st.tuples(coordinate, coordinate, size, coordinate, size),
    origin=st.tuples(coordinate, coordinate, coordinate),
    seed=st.integers(0, 2**32 - 1),
)
def test_space_before_a_hit_is_empty_and_behind_it_solid(box, cylinder, origin, seed):
    """Against membership in the bodies, stepped along the rays: an oracle without a quadratic."""
    x, y, z, *extent = box
    lower, upper = np.array([x, y, z]), np.array([x, y, z]) + extent
    cx, cy, radius, bottom, height = cylinder

    def inside(points, margin):
        in_box = ((points > lower + margin) & (points < upper - margin)).all(axis=-1)
        level = (points[..., 2] > bottom + margin) & (points[..., 2] < bottom + height - margin)
        across = np.hypot(points[..., 0] - cx, points[..., 1] - cy)
        return in_box | (level & (across < radius - margin))

    begin = np.array(origin)
    if inside(begin, -1e-6):
        return
    directions = unit(*np.random.default_rng(seed).normal(size=(32, 3)))
    origins = np.tile(begin, (32, 1))
    hits = first_hits(boxes((*lower, *upper)), origins, directions).nearer(
        first_hits(cylinders((cx, cy, radius, bottom, bottom + height)), origins, directions)
    )
    reach = np.minimum(hits.distance, 15.0)
    steps = np.linspace(0, 1, 300)[None, :, None] * reach[:, None, None]
    assert not inside(begin + steps * directions[:, None], 1e-9).any()
    met = np.isfinite(hits.distance)
    surface = begin + hits.distance[met, None] * directions[met]
    assert inside(surface, -1e-9).all()
    assert not inside(surface, 1e-9).any()
