"""Densities of tiles are bit for bit those of the whole map, whatever the tiles and their halos."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahull import MethodParameters
from dynahull.clustering import Clusters
from dynahull.density import SPREAD_COLUMNS, cluster_densities
from pipeline.tiles.borders import Region, core_densities
from pipeline.tiles.nearest import FreePoints


class Grid:
    """A map cut into squares, with a halo of any width."""

    def __init__(self, points, size, halo):
        self.points, self.size, self.halo = points, size, halo
        self.cells = np.floor(points.xyz[:, :2] / size)
        self.names = np.unique(self.cells, axis=0)

    def box(self, tile):
        low = self.names[tile] * self.size
        return low, (self.names[tile] + 1) * self.size

    def near(self, low, high):
        boxes = [self.box(tile) for tile in range(len(self.names))]
        return [
            tile for tile, (first, last) in enumerate(boxes)
            if tile != self.own and (first <= high).all() and (last >= low).all()
        ]  # fmt: skip

    def free_points(self, tile, near):
        own = self.points.select((self.cells == self.names[tile]).all(axis=1))
        return own.select(near(own.xyz[:, :2], own.xyz[:, :2]))

    def scored(self, tile, clusters, parameters):
        """Score one tile as a run does."""
        self.own = tile
        low, high = self.box(tile)
        low, high = low - self.halo, high + self.halo
        flat = self.points.xyz[:, :2]
        inside = ((flat >= low) & (flat < high)).all(axis=1)
        core = (self.cells == self.names[tile]).all(axis=1)
        known = self.points.select(inside)
        region = Region(low, high)
        return core, core_densities(known, core[inside], region, self, clusters, parameters)


def whole(points, clusters, parameters):
    membership = clusters.nearest(points.xyz)
    density = np.full(len(points), np.nan)
    spread = np.full((len(points), SPREAD_COLUMNS), np.nan, np.float32)
    for cluster in np.unique(membership):
        members = np.flatnonzero(membership == cluster)
        density[members], spread[members] = cluster_densities(
            points.xyz[members], points.rows[members], parameters
        )
    return membership, density, spread


@settings(deadline=None, max_examples=15)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(4, 60),
    st.sampled_from([0.0, 0.1, 0.7, 5.0]),
    st.sampled_from([0.7, 2.0, 20.0]),
    st.sampled_from([0.0, 1e6 + 0.1]),
    st.sampled_from(["scattered", "gridded", "duplicated"]),
    st.sampled_from(["cpu", "reference"]),
)
def test_tiles_score_what_the_whole_map_scores(seed, k, halo, size, shift, kind, device):
    random = np.random.default_rng(seed)
    xyz = random.normal(size=(250, 3)) * [1.5, 1.5, 0.4]
    if kind == "gridded":
        xyz = np.round(xyz, 1)
    if kind == "duplicated":
        xyz = xyz[random.integers(0, 60, 250)]
    points = FreePoints(xyz + shift, random.permutation(250).astype(np.int64))
    clusters = Clusters(np.array([[-1.0, 0, 0], [1, 0, 0], [9, 9, 0]]) + shift)
    parameters = MethodParameters.of(
        {
            "neighbours": {"k": k},
            "density": {"device": device},
            "removal": {"decision": "auto"},
        }
    )
    membership, density, spread = whole(points, clusters, parameters)
    grid = Grid(points, size, halo)
    for tile in range(len(grid.names)):
        core, scores = grid.scored(tile, clusters, parameters)
        np.testing.assert_array_equal(scores.cluster, membership[core])
        np.testing.assert_array_equal(scores.density, density[core])
        np.testing.assert_array_equal(scores.spread, spread[core])


@pytest.mark.parametrize("halo", [0.5, 3.0])
def test_a_wide_halo_needs_no_other_tile_and_a_narrow_one_does(halo):
    random = np.random.default_rng(0)
    points = FreePoints(random.uniform(0, 10, (4000, 3)) * [1, 1, 0.1], np.arange(4000))
    clusters = Clusters(np.zeros((1, 3)))
    parameters = MethodParameters.of({"neighbours": {"k": 20}})
    finished = Grid(points, 5.0, halo).scored(0, clusters, parameters)[1].finished_elsewhere
    # The tile's outer sides are the map's own border here, which it does not know.
    assert (finished == 0) == (halo == 3.0)


def test_a_cluster_of_too_few_points_is_not_scored_in_any_tile():
    points = FreePoints(np.array([[0.0, 0, 0], [1, 0, 0], [2, 1, 1]]), np.arange(3))
    grid = Grid(points, 1.0, 0.1)
    for tile in range(3):
        _, scores = grid.scored(tile, Clusters(np.zeros((1, 3))), MethodParameters())
        assert np.isnan(scores.density).all()
