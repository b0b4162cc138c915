"""What a user is told of a map: where it is so, once, and nowhere else."""

import numpy as np
import pytest

from dynahull import MethodParameters, clean
from dynahull.result import ClusterSummary
from dynahull.warn import (
    density_levels,
    warn_of_clusters,
    warn_of_densities,
    warn_of_ground,
    warn_of_much_removed,
    warn_of_sparse_map,
    wide_neighbourhoods,
)
from tests.listener import Listener


def said_of_clusters(counts, **removal):
    listener = Listener()
    removal = {"decision": "paper", **removal}
    parameters = MethodParameters.of({"clustering": {"count": len(counts)}, "removal": removal})
    warn_of_clusters(counts, parameters, listener)
    return listener.warnings


def said_of_ground(ground, total, method="slope"):
    listener = Listener()
    warn_of_ground(ground, total, method, listener)
    return listener.warnings


def test_a_tiny_cluster_that_decides_about_the_others_is_named():
    (warning,) = said_of_clusters([9_000, 10_000, 200, 8_000, 9_500])
    assert "cluster 2 has 200 points, and half of all clusters 9,000 or more" in warning
    # (8000 - 200) / (10000 - 200) of 15 percent, and 5 percent.
    assert "takes 16.9 to 20.0 % of them" in warning
    assert "clustering.seed or clustering.count" in warning


@pytest.mark.parametrize(
    ("counts", "removal"),
    [
        ([9_000, 10_000, 450, 8_000, 9_500], {}),
        ([9_000, 100], {}),
        ([9_000, 10_000, 70, 8_000, 9_500], {}),
        ([9_000, 10_000, 200, 8_000, 9_500], {"decision": "auto"}),
        ([9_000, 10_000, 200, 8_000, 9_500], {"min_percent": 20}),
    ],
    ids=["a twentieth", "two clusters", "fewer than k do not count", "evidence", "one share"],
)
def test_other_clusters_are_not(counts, removal):
    assert said_of_clusters(counts, **removal) == []


def test_hardly_any_ground_is_said_with_what_to_try():
    (warning,) = said_of_ground(1_999, 100_000)
    assert "1,999 of 100,000 points, ground.method slope" in warning
    assert "try ground.method=csf, or none" in warning
    (warning,) = said_of_ground(0, 10, "las_class")
    assert "try ground.method=slope" in warning


@pytest.mark.parametrize("case", [(2_000, 100_000), (0, 100_000, "none"), (0, 0)])
def test_enough_ground_or_none_wanted_is_not_said(case):
    assert said_of_ground(*case) == []


def test_clean_counts_the_ground_among_the_points_that_take_part():
    random = np.random.default_rng(0)
    wall = random.uniform(size=(400, 3)) * [4, 0.02, 2]
    classes = np.zeros(400, np.uint8)
    classes[:7] = 2
    for left_out, warned in ((0, True), (100, False)):
        listener = Listener()
        clean(
            wall,
            ground={"method": "las_class"},
            classification=classes,
            left_out=np.arange(400) >= 400 - left_out,
            neighbours={"k": 8},
            observer=listener,
        )
        assert any("hardly any ground" in each for each in listener.warnings) == warned


def said_of_densities(density):
    listener = Listener()
    warn_of_densities(density_levels(density), listener)
    return listener.warnings


def populations(*groups):
    """Densities of groups, each of so many points about a logarithm to base 2."""
    random = np.random.default_rng(0)
    return np.concatenate([2 ** random.normal(middle, 1.0, count) for count, middle in groups])


def test_densities_of_one_population_are_said():
    (warning,) = said_of_densities(populations((50_000, 12)))
    assert "no second, sparser population" in warning


@pytest.mark.parametrize("share", [0.01, 0.1])
def test_densities_of_two_populations_are_not(share):
    ghosts = int(50_000 * share)
    assert said_of_densities(populations((50_000 - ghosts, 12), (ghosts, 5))) == []


def test_a_second_population_of_hardly_any_points_counts_for_nothing():
    assert said_of_densities(populations((50_000, 12), (50, 3)))


@pytest.mark.parametrize("density", [np.array([np.nan, np.inf]), populations((9_999, 12))])
def test_few_densities_say_nothing(density):
    assert said_of_densities(density) == []


def test_counts_of_parts_add_up():
    density = populations((1_000, 12), (100, 5), (3, -80), (3, 100))
    density[::50] = np.nan
    parts = [density_levels(part) for part in np.array_split(density, 7)]
    assert (np.sum(parts, axis=0) == density_levels(density)).all()
    assert density_levels(density).sum() == np.isfinite(density).sum()


@pytest.mark.parametrize(("wide", "warned"), [(501, True), (500, False)])
def test_a_sparse_map_is_said(wide, warned):
    spread = np.zeros((1_000, 5), np.float32)
    spread[:wide, 2] = 0.3
    listener = Listener()
    warn_of_sparse_map(wide_neighbourhoods(spread), len(spread), listener)
    assert any("sparse, or was downsampled" in each for each in listener.warnings) == warned


@pytest.mark.parametrize(("spacing", "warned"), [(0.02, False), (0.4, True)])
def test_clean_looks_at_how_wide_neighbourhoods_are(spacing, warned):
    side = np.arange(30) * spacing
    x, z = np.meshgrid(side, side)
    wall = np.column_stack([x.ravel(), 0.1 * np.sin(x.ravel()), z.ravel()])
    listener = Listener()
    clean(wall, "auto", ground={"method": "none"}, clustering={"count": 1}, observer=listener)
    assert any("sparse, or was downsampled" in each for each in listener.warnings) == warned


@pytest.mark.parametrize(("removed", "warned"), [(101, True), (100, False)])
def test_a_map_of_which_much_goes_is_said(removed, warned):
    clusters = [
        ClusterSummary(index, (0.0, 0.0, 0.0), 150, 5.0, None, gone)
        for index, gone in enumerate((removed, 0))
    ]
    listener = Listener()
    warn_of_much_removed(clusters, listener)
    assert any("of 300 scored points go" in each for each in listener.warnings) == warned
