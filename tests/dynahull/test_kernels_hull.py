"""The compiled hull against exact arithmetic and Qhull, on maps and nasty neighbourhoods."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from dynahull.kernels import hull_densities
from dynahull.reference import FLATNESS, hull_volume
from tests.dynahull.exact_hull import exact_hull_volume
from tiling.collection import MapCollection, find_map_files

Points = NDArray[np.float64]

UTM = np.array([515384.823, 4918360.74, 2330.73])


def kernel_volume(points: Points) -> float:
    """The volume of the hull of all points, seen from the first of them."""
    queries = np.arange(len(points)) == 0
    result = hull_densities(points, np.arange(len(points)), len(points), queries=queries)
    return len(points) / result.density[0]


def thinness(points: Points) -> float:
    """Length over thickness, by singular values: how much a rounding of a coordinate matters."""
    singular = np.linalg.svd(points - points[0], compute_uv=False)
    return float(singular[0] / singular[2]) if singular[2] > 0 else np.inf


def plane(random: np.random.Generator, n: int) -> Points:
    return np.c_[random.random((n, 2)), np.zeros(n)]


def lattice(random: np.random.Generator, n: int) -> Points:
    return random.integers(-2, 3, (n, 3)).astype(float)


def fine_lattice(random: np.random.Generator, n: int) -> Points:
    return random.integers(-15, 16, (n, 3)) * 0.001


def duplicated(random: np.random.Generator, n: int) -> Points:
    return random.random((6, 3))[random.integers(0, 6, n)]


def sphere(random: np.random.Generator, n: int) -> Points:
    points = random.normal(size=(n, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def exact_sphere(random: np.random.Generator, n: int) -> Points:
    """All integer points at squared distance 50 from the origin, and repetitions."""
    grid = np.stack(np.meshgrid(*[np.arange(-7, 8)] * 3), -1).reshape(-1, 3)
    shell = grid[(grid**2).sum(1) == 50]
    return shell[random.integers(0, len(shell), n)].astype(float)


def line(random: np.random.Generator, n: int) -> Points:
    return np.outer(random.random(n), [1.0, 2.0, -1.0])


def needle(random: np.random.Generator, n: int) -> Points:
    return random.random((n, 3)) * [1.0, 1e-5, 1e-5]


def plate(random: np.random.Generator, n: int) -> Points:
    return random.random((n, 3)) * [1.0, 1.0, 1e-5]


def ribbon(random: np.random.Generator, n: int) -> Points:
    return random.random((n, 3)) * [1.0, 1e-3, 1e-6]


def far_point(random: np.random.Generator, n: int) -> Points:
    points = random.random((n, 3))
    points[-1] = [1e4, 2e4, -1e4]
    return points


def wedge(random: np.random.Generator, n: int) -> Points:
    """Two planes that meet: points on each are exactly coplanar."""
    points = np.c_[random.random((n, 2)), np.zeros(n)]
    points[: n // 2] = points[: n // 2][:, [2, 1, 0]]
    return points


def box_faces(random: np.random.Generator, n: int) -> Points:
    points = random.integers(0, 9, (n, 3)) / 8
    points[np.arange(n), random.integers(0, 3, n)] = random.integers(0, 2, n)
    return points


def two_clumps(random: np.random.Generator, n: int) -> Points:
    points = random.random((n, 3)) * 1e-6
    points[n // 2 :] += [1.0, 0.0, 0.0]
    return points


def cloud(random: np.random.Generator, n: int) -> Points:
    return random.normal(size=(n, 3))


FAMILIES = [
    plane,
    lattice,
    fine_lattice,
    duplicated,
    sphere,
    exact_sphere,
    line,
    needle,
    plate,
    ribbon,
    far_point,
    wedge,
    box_faces,
    two_clumps,
    cloud,
]


def as_they_are(points: Points) -> Points:
    return points


def utm(points: Points) -> Points:
    return points + UTM


def utm_float32(points: Points) -> Points:
    return utm(points * 10).astype(np.float32).astype(np.float64)


def quantised(step: float) -> Callable[[Points], Points]:
    def quantise(points: Points) -> Points:
        return np.round(points / step) * step

    quantise.__name__ = f"quantised to {step}"
    return quantise


PLACES = [as_they_are, utm, utm_float32, quantised(0.001), quantised(0.01), quantised(0.05)]


@pytest.mark.parametrize("place", PLACES, ids=lambda place: place.__name__)
@pytest.mark.parametrize("family", FAMILIES, ids=lambda family: family.__name__)
@settings(max_examples=4, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1), count=st.sampled_from([4, 5, 9, 75, 130]), turned=st.booleans()
)
def test_nasty_neighbourhoods_have_their_exact_volume(
    family: Callable[[np.random.Generator, int], Points],
    place: Callable[[Points], Points],
    seed: int,
    count: int,
    turned: bool,
) -> None:
    random = np.random.default_rng(seed)
    points = family(random, count)
    if turned:
        points = points @ Rotation.random(rng=random).as_matrix().T
    points = place(points)
    centred = points - points[0]
    volume = kernel_volume(points)
    if hull_volume(centred) == 0 or volume == 0:
        # Both apply one rule; roundings apart, they agree on which side of it a set lies.
        assert thinness(points) > 0.01 / FLATNESS or volume == hull_volume(centred)
    else:
        # A coordinate's own rounding, 1e-16 of the length, is that much of the thickness.
        tolerance = max(1e-9, 1e-14 * thinness(points))
        assert volume == pytest.approx(exact_hull_volume(centred), rel=tolerance)


@pytest.mark.parametrize(
    "points",
    [
        np.zeros((75, 3)),
        np.full((75, 3), UTM),
        np.outer(np.arange(75.0), [1.0, 1.0, 1.0]),
        np.c_[np.arange(75) % 9, np.arange(75) // 9, np.full(75, 0.037)],
        np.c_[np.arange(75) % 9, np.arange(75) // 9, np.arange(75) % 9] * 0.001,
    ],
    ids=["one place", "one place in UTM", "a line", "a level plane", "a tilted grid"],
)
def test_flat_points_have_no_volume(points: Points) -> None:
    assert kernel_volume(points) == 0
    assert hull_volume(points) == 0


@pytest.mark.parametrize("angle", [0.1, 1.0, 2.5])
def test_a_turned_plane_stays_flat(angle: float) -> None:
    random = np.random.default_rng(0)
    points = plane(random, 75) @ Rotation.from_rotvec([angle, 2 * angle, -angle]).as_matrix()
    assert kernel_volume(points) == 0


def test_known_bodies() -> None:
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
    assert kernel_volume(cube) == pytest.approx(1, rel=1e-14)
    assert kernel_volume(np.vstack([[0, 0, 0], np.eye(3)])) == pytest.approx(1 / 6, rel=1e-14)
    octahedron = np.vstack([np.eye(3), -np.eye(3)])
    assert kernel_volume(octahedron) == pytest.approx(4 / 3, rel=1e-14)


@pytest.mark.parametrize("scale", [1e-120, 1e-9, 1e9, 1e60])
def test_scale_does_not_matter(scale: float) -> None:
    points = cloud(np.random.default_rng(1), 75)
    expected = kernel_volume(points) * scale**2
    assert kernel_volume(points * scale) / scale == pytest.approx(expected, rel=1e-12)


MAPS = [
    "campus_cells",
    "campus_loop.laz",
    "corridor.pcd",
    "lobby_a.pcd",
    "lobby_b.pcd",
    "lone_star.copc.laz",
    "room_static_sensor.laz",
    "street_64beam_labelled.laz",
]


@pytest.mark.parametrize("name", MAPS)
def test_volumes_of_real_maps_are_those_of_qhull(name: str, shared_data: Path) -> None:
    batches = MapCollection(find_map_files([shared_data / "maps" / name])).batches(100_000)
    points = next(batches)[1].xyz
    points = points[np.isfinite(points).all(axis=1)]
    rows = np.arange(len(points))
    chosen = np.random.default_rng(0).choice(len(points), 150, replace=False)
    queries = np.isin(rows, chosen)
    density = hull_densities(points, rows, 75, queries=queries).density
    distance, neighbours = KDTree(points).query(points[chosen], 76)
    tie_free = distance[:, 74] * (1 + 1e-9) < distance[:, 75]
    assert tie_free.mean() > 0.2
    for at, around in zip(chosen[tie_free], neighbours[tie_free, :75], strict=True):
        volume = hull_volume(points[around] - points[at])
        assert density[at] == pytest.approx(75 / volume if volume else np.inf, rel=1e-9)
