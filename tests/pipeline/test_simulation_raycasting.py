"""Rays meet the first surface on their way, at the exact distance, and never pass through it."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.simulation.raycasting import first_hits, first_moving_hits
from pipeline.simulation.scene import Shapes, Surface


def boxes(*corners, slope=(0.0, 0.0), surface=Surface.WALL):
    return Shapes.of([(*corner, *slope) for corner in corners], [surface] * len(corners))


def cylinders(*rows, surface=Surface.PERSON):
    return Shapes.of(cylinders=rows, cylinder_surface=[surface] * len(rows))


def unit(*vectors):
    array = np.array(vectors, dtype=float).reshape(-1, 3)
    return array / np.linalg.norm(array, axis=1, keepdims=True)


def distances(shapes, origin, direction):
    return first_hits(shapes, np.array([origin], dtype=float), unit(direction)).distance[0]


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
        ((2, 0.5, 3), (0, 0, -1), 2.0),
        ((8, 0.5, 3), (0, 0, -1), 1.4),
        ((0, 0.5, 1.8), (1, 0, 0), 10.0),
        ((0, 0.5, 2.1), (1, 0, 0), np.inf),
        ((2, 0.5, -1), (0, 0, 1), 1.2),
    ],
    ids=["low end", "high end", "uphill", "over it", "from below"],
)
def test_ramp_is_met_where_geometry_says(origin, direction, expected):
    """Its upper side rises from 0.8 at x = 0 by 0.1 a metre, its lower one from 0."""
    ramp = boxes((0, 0, 0, 12, 1, 0.8), slope=(0.1, 0.0))
    assert distances(ramp, origin, direction) == pytest.approx(expected)


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


def moving_distances(shapes, frames, origins, directions):
    """One mover, elsewhere at the firing of each ray."""
    starts = np.array([[0, 0], [len(shapes.boxes), len(shapes.cylinders)]])
    frames = np.array(frames, dtype=float)[:, None]
    firings = np.arange(len(frames))
    reach = np.array([shapes.reach()])
    hits = first_moving_hits(shapes, starts, reach, frames, firings, origins, directions)
    return hits.distance


def test_mover_may_be_elsewhere_at_each_firing():
    frames = [(3, 0, 0, 0, 0), (7, 0, 0, 1, 0), (7, 9, 0, 0, 0)]
    origins = np.tile([0.0, 0.0, 1.0], (3, 1))
    ahead = unit((1, 0, 0), (1, 0, 0), (1, 0, 0))
    found = moving_distances(cylinders((0, 0, 0.5, 0, 2)), frames, origins, ahead)
    assert found == pytest.approx([2.5, 6.5, np.inf])


def test_mover_turns_with_its_heading_and_tilts_with_the_slope():
    """A car 4 m long and 2 m wide, its roof 1.5 m above the axis, 10 m away."""
    car = boxes((-2, -1, 0.2, 2, 1, 1.5))
    frames = [(10, 0, 0, 0, 0), (10, 0, 0, np.pi / 2, 0), (10, 0, 5, 0, 0.1), (10, 0, 5, 0, 0.1)]
    origins = np.array([(0, 0, 1), (0, 0, 1), (9, 0, 9), (11, 0, 9)], dtype=float)
    directions = unit((1, 0, 0), (1, 0, 0), (0, 0, -1), (0, 0, -1))
    found = moving_distances(car, frames, origins, directions)
    assert found == pytest.approx([8, 9, 9 - (5 + 1.5 - 0.1), 9 - (5 + 1.5 + 0.1)])


def test_nearest_of_all_hits_brings_its_surface():
    origins, directions = np.array([[0.0, 0.0, 1.0]] * 2), unit((1, 0, 0), (0, 1, 0))
    walls = boxes((5, -9, 0, 6, 9, 3), (-9, 2, 0, 9, 3, 3))
    people = cylinders((3, 0, 0.5, 0, 2), (0, 4, 0.5, 0, 2))
    for parts in ([walls, people], [people, walls]):
        hits = first_hits(Shapes.joined(parts), origins, directions)
        assert hits.distance == pytest.approx([2.5, 2.0])
        assert hits.surface.tolist() == [Surface.PERSON, Surface.WALL]


def test_no_bodies_no_hits():
    hits = first_hits(Shapes.of(), np.zeros((3, 3)), unit((1, 0, 0), (0, 1, 0), (0, 0, 1)))
    assert np.isinf(hits.distance).all()


coordinate = st.floats(-3, 3)
size = st.floats(0.1, 2)
slope = st.floats(-0.5, 0.5)


@settings(deadline=None, max_examples=150)
@given(
    box=st.tuples(coordinate, coordinate, coordinate, size, size, size),
    slopes=st.tuples(slope, slope),
    cylinder=st.tuples(coordinate, coordinate, size, coordinate, size),
    origin=st.tuples(coordinate, coordinate, coordinate),
    seed=st.integers(0, 2**32 - 1),
)
def test_space_before_a_hit_is_empty_and_behind_it_solid(box, slopes, cylinder, origin, seed):
    """Against membership in the bodies, stepped along the rays: an oracle without a quadratic."""
    x, y, z, *extent = box
    lower, upper = np.array([x, y, z]), np.array([x, y, z]) + extent
    cx, cy, radius, bottom, height = cylinder

    def inside(points, margin):
        lowered = points - np.stack(
            [np.zeros(points.shape[:-1])] * 2 + [points[..., :2] @ slopes], axis=-1
        )
        in_box = ((lowered > lower + margin) & (lowered < upper - margin)).all(axis=-1)
        level = (points[..., 2] > bottom + margin) & (points[..., 2] < bottom + height - margin)
        across = np.hypot(points[..., 0] - cx, points[..., 1] - cy)
        return in_box | (level & (across < radius - margin))

    begin = np.array(origin)
    if inside(begin, -1e-6):
        return
    directions = unit(*np.random.default_rng(seed).normal(size=(32, 3)))
    shapes = Shapes.joined(
        [
            boxes((*lower, *upper), slope=slopes),
            cylinders((cx, cy, radius, bottom, bottom + height)),
        ]
    )
    hits = first_hits(shapes, np.tile(begin, (32, 1)), directions)
    reach = np.minimum(hits.distance, 15.0)
    steps = np.linspace(0, 1, 300)[None, :, None] * reach[:, None, None]
    assert not inside(begin + steps * directions[:, None], 1e-9).any()
    met = np.isfinite(hits.distance)
    surface = begin + hits.distance[met, None] * directions[met]
    assert inside(surface, -1e-9).all()
    assert not inside(surface, 1e-9).any()


FACES = np.array(
    [
        (0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6), (0, 1, 4), (1, 5, 4),
        (2, 6, 3), (3, 6, 7), (0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5),
    ],
    dtype=np.uint32,
)  # fmt: skip


@pytest.mark.filterwarnings("ignore")  # of Open3D, while it is imported
def test_agrees_with_open3d_on_a_whole_building():
    open3d = pytest.importorskip("open3d", exc_type=ImportError)
    from pipeline.simulation.two_levels import storeys_scene  # noqa: PLC0415

    scene = storeys_scene(np.random.default_rng(0)).shapes
    shapes = Shapes.of(scene.boxes, scene.box_surface)
    corners = [
        (x, y, z + along_x * x + along_y * y)
        for x0, y0, z0, x1, y1, z1, along_x, along_y in shapes.boxes
        for z in (z0, z1)
        for y in (y0, y1)
        for x in (x0, x1)
    ]
    triangles = FACES[None] + 8 * np.arange(len(shapes.boxes), dtype=np.uint32)[:, None, None]
    oracle = open3d.t.geometry.RaycastingScene()
    tensor = open3d.core.Tensor
    oracle.add_triangles(tensor(np.float32(corners)), tensor(triangles.reshape(-1, 3)))
    directions = unit(*np.random.default_rng(1).normal(size=(20_000, 3)))
    origins = np.tile([1.4, 6.0, 0.9], (20_000, 1))
    rays = np.concatenate([origins, directions], axis=1).astype(np.float32)
    expected = oracle.cast_rays(tensor(rays))["t_hit"].numpy()
    # Open3D computes in float32, which resolves 2 micrometres at 30 m.
    assert first_hits(shapes, origins, directions).distance == pytest.approx(expected, abs=2e-5)
