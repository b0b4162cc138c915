"""The promises of the fused kernel: exact neighbours, and bits that depend on nothing else."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from dynahull.errors import InvalidParametersError, InvalidPointsError
from dynahull.kernels import hull_densities, nearest_rows, squared_reaches
from dynahull.reference import nearest_neighbours, reference_densities

Points = NDArray[np.float64]

UTM = np.array([515384.823, 4918360.74, 2330.73])


def surface(seed: int, count: int, step: float = 0.0) -> Points:
    """A rough floor, quantised if a step is given."""
    random = np.random.default_rng(seed)
    points = random.random((count, 3)) * [10, 10, 0.2]
    points[:, 2] += np.sin(points[:, 0])
    return np.round(points / step) * step if step else points


def sphere(seed: int, count: int) -> Points:
    """Points as far from the first, but for less than single precision can tell."""
    random = np.random.default_rng(seed)
    points = random.normal(size=(count, 3))
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    points *= 1 + random.normal(scale=1e-12, size=(count, 1))
    points[0] = 0.0
    return points


SHAPES = {
    "surface": lambda: surface(0, 900),
    "quantised": lambda: surface(1, 900, 0.5),
    "duplicates": lambda: np.repeat(surface(2, 30), 30, axis=0),
    "one place": lambda: np.zeros((300, 3)),
    "line": lambda: np.outer(np.arange(400.0), [1, 0, 0]),
    "uneven": lambda: np.random.default_rng(3).normal(size=(700, 3)) ** 15,
    "outliers": lambda: np.vstack([surface(4, 600), surface(5, 40) * 1e4]),
    "utm": lambda: surface(6, 600) + UTM,
    "few": lambda: surface(7, 20),
    "sphere": lambda: sphere(8, 400),
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("k", [4, 75, 200])
def test_neighbours_are_those_of_the_plain_version(shape: str, k: int) -> None:
    points = SHAPES[shape]()
    rows = np.random.default_rng(9).permutation(10 * len(points))[: len(points)]
    expected = rows[nearest_neighbours(points, rows, k)]
    assert np.array_equal(nearest_rows(points, rows, k), expected)


@pytest.mark.parametrize("exponent", [-470, 470])
def test_neighbours_do_not_depend_on_the_unit(exponent: int) -> None:
    points, rows = surface(10, 900), np.arange(900)
    scaled = nearest_rows(np.ldexp(points, exponent), rows, 75)
    assert np.array_equal(scaled, nearest_rows(points, rows, 75))


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("k", [4, 75, 200])
def test_densities_are_those_of_the_plain_version(shape: str, k: int) -> None:
    points = SHAPES[shape]()[::3]
    rows = np.arange(len(points))
    expected = reference_densities(points, rows, k)
    assert hull_densities(points, rows, k).density == pytest.approx(expected, rel=1e-9)


def test_squared_reach_is_that_of_numpy_to_the_last_bit() -> None:
    points = surface(8, 500) + UTM
    rows = np.arange(len(points))
    far = points[nearest_neighbours(points, rows, 75)[:, -1]] - points
    expected = (far[:, 0] * far[:, 0] + far[:, 1] * far[:, 1]) + far[:, 2] * far[:, 2]
    assert np.array_equal(squared_reaches(points, rows, 75), expected)
    assert np.array_equal(hull_densities(points, rows, 75).squared_reach, expected)


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    count=st.integers(4, 1200),
    k=st.sampled_from([4, 20, 75]),
    step=st.sampled_from([0.0, 0.1, 1.0]),
)
def test_the_bits_do_not_depend_on_order_company_queries_or_threads(
    seed: int, count: int, k: int, step: float
) -> None:
    random = np.random.default_rng(seed)
    points = surface(seed, count, step)
    rows = random.permutation(3 * count)[:count]
    expected = hull_densities(points, rows, k)

    shuffle = random.permutation(count)
    shuffled = hull_densities(points[shuffle], rows[shuffle], k, threads=2)
    assert np.array_equal(shuffled.density, expected.density[shuffle])
    assert np.array_equal(shuffled.squared_reach, expected.squared_reach[shuffle])

    if count > k:
        company = np.vstack([points, random.random((50, 3)) + 1e4])
        among = hull_densities(company, np.r_[rows, 3 * count + np.arange(50)], k)
        assert np.array_equal(among.density[:count], expected.density)

    queries = random.random(count) < 0.2
    some = hull_densities(points, rows, k, queries=queries)
    assert np.array_equal(some.density[queries], expected.density[queries])
    assert np.isnan(some.density[~queries]).all()
    assert np.isnan(some.squared_reach[~queries]).all()


@settings(max_examples=10, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), step=st.sampled_from([0.0, 0.2]))
def test_a_part_with_enough_halo_gives_the_bits_of_the_whole(seed: int, step: float) -> None:
    points, rows = surface(seed, 3000, step), np.arange(3000)
    whole = hull_densities(points, rows, 20)
    part = points[:, 0] < 5
    cut = hull_densities(points[part], rows[part], 20)
    certain = cut.squared_reach < (5 - points[part, 0]) ** 2
    assert certain.mean() > 0.3
    assert np.array_equal(cut.density[certain], whole.density[part][certain])


@pytest.mark.parametrize(
    "points",
    [
        np.repeat([[1.0, 2.0, 3.0]], 100_000, axis=0),
        np.outer(np.arange(100_000.0), [1.0, 0.0, 0.0]),
        np.outer(np.repeat(np.arange(100.0), 1000), [1.0, 2.0, 0.0]),
        np.random.default_rng(0).normal(size=(60_000, 3)) ** 25,
        np.vstack([np.random.default_rng(0).random((60_000, 3)), surface(0, 2000) * 1e5]),
    ],
    ids=["one place", "a line", "a hundred places", "uneven", "outliers"],
)
def test_no_arrangement_is_quadratic(points: Points) -> None:
    # Quadratic work on any of these takes minutes; an even cloud of as many, about a second.
    assert len(squared_reaches(points, np.arange(len(points)), 75)) == len(points)


def test_progress_counts_every_point_once_in_the_calling_thread() -> None:
    points = surface(0, 10_000)
    for threads in (1, 2):
        told: list[int] = []
        hull_densities(points, np.arange(10_000), 4, threads=threads, on_progress=told.append)
        assert sum(told) == 10_000
        assert len(told) > 1


def test_an_error_of_the_observer_ends_the_work() -> None:
    def fail(done: int) -> None:
        raise RuntimeError("stop")

    for threads in (1, 2):
        with pytest.raises(RuntimeError, match="stop"):
            hull_densities(
                surface(0, 20_000), np.arange(20_000), 4, threads=threads, on_progress=fail
            )


@pytest.mark.parametrize(
    ("points", "rows", "k", "threads", "error"),
    [
        (np.zeros((3, 3)), np.arange(3), 75, 1, InvalidPointsError),
        (np.zeros((5, 2)), np.arange(5), 75, 1, InvalidPointsError),
        (np.full((5, 3), np.nan), np.arange(5), 75, 1, InvalidPointsError),
        (np.full((5, 3), np.inf), np.arange(5), 75, 1, InvalidPointsError),
        (np.full((5, 3), 1e200), np.arange(5), 75, 1, InvalidPointsError),
        (np.zeros((5, 3)), np.arange(4), 75, 1, InvalidPointsError),
        (np.zeros((5, 3)), np.arange(5), 3, 1, InvalidParametersError),
        (np.zeros((5, 3)), np.arange(5), 75, 0, InvalidParametersError),
    ],
)
def test_what_cannot_be_computed_is_refused(
    points: Points, rows: NDArray[np.int64], k: int, threads: int, error: type[Exception]
) -> None:
    with pytest.raises(error):
        hull_densities(points, rows, k, threads=threads)


def test_the_precision_of_the_turns_leaves_no_trace() -> None:
    """A neighbourhood is tried in the precision that the query before it needed."""
    random = np.random.default_rng(0)
    smooth, lattice = surface(0, 2000), surface(1, 2000, 0.1)
    points = np.vstack([smooth, lattice + [0.5, 0.5, 0]])
    rows = np.arange(len(points))
    expected = hull_densities(points, rows, 75).density
    for _ in range(5):
        queries = random.random(len(points)) < 0.02
        some = hull_densities(points, rows, 75, queries=queries).density
        assert np.array_equal(some[queries], expected[queries])
