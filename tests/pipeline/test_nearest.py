"""The nearest points met so far are those that a look at all points at once would find."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from dynahull.reference import nearest_neighbours
from pipeline.tiles.nearest import FreePoints, NearestSoFar


@settings(deadline=None, max_examples=40)
@given(
    st.integers(0, 2**32 - 1),
    st.integers(1, 30),
    st.integers(0, 90),
    st.booleans(),
    st.sampled_from([0.0, 1e6 + 0.1]),
    st.booleans(),
)
def test_parts_offered_one_after_the_other(seed, k, count, gridded, shift, reach_known):
    random = np.random.default_rng(seed)
    xyz = random.normal(size=(count, 3))
    xyz = (np.round(xyz, 0) if gridded else xyz) + shift
    points = FreePoints(xyz, random.permutation(count).astype(np.int64))
    centres = random.normal(size=(5, 3)).round(0) + shift
    expected = nearest_neighbours(points.xyz, points.rows, k, centres)
    reach = np.full(5, np.inf)
    if reach_known and count >= k:
        farthest = points.xyz[expected[:, -1]]
        reach = np.linalg.norm(farthest - centres, axis=1)
    search = NearestSoFar(centres, k, reach)
    for part in np.array_split(np.arange(count), 4):
        search.offer(points.select(part), np.arange(5))
    low, high = search.bounds()
    for slot, found in search.neighbourhoods():
        np.testing.assert_array_equal(found.rows, points.rows[expected[slot]])
        np.testing.assert_array_equal(found.xyz, points.xyz[expected[slot]])
        assert ((found.xyz[:, :2] >= low) & (found.xyz[:, :2] <= high)).all()
