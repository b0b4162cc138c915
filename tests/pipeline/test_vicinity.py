"""A vicinity leaves out no place that a point reaches."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.tiles.nearest import Vicinity


@settings(deadline=None, max_examples=200)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([0.0, 1e-3, 1.0, 250.0]),
    st.sampled_from([0.0, 1e-9, 0.01, 1.0, 40.0]),
    st.sampled_from([0.0, 1e6 + 0.1, -3e9]),
)
def test_every_place_within_reach_is_held(seed, extent, reach, shift):
    random = np.random.default_rng(seed)
    xyz = random.uniform(-1, 1, (30, 3)) * extent + shift
    reaches = reach * random.uniform(0.5, 1.0, 30)
    vicinity = Vicinity(xyz, reaches)
    # Places on the very edge of each reach, in eight directions along and across the axes.
    turns = np.repeat(np.arange(8) * np.pi / 4, 30)
    step = np.column_stack([np.cos(turns), np.sin(turns), np.zeros(240)])
    places = np.tile(xyz, (8, 1)) + step * np.tile(reaches, 8)[:, None]
    assert vicinity.holds(xyz).all()
    assert vicinity.holds(places).all()
    flat, endless = places[:, :2], np.full((len(places), 1), np.inf)
    assert vicinity.meets(flat, flat).all()
    beside = np.hstack([-endless, flat[:, 1:]]), np.hstack([endless, flat[:, 1:]])
    assert vicinity.meets(*beside).all()
    assert vicinity.meets(flat, np.hstack([endless, endless])).all()


def test_what_is_far_is_left_out():
    corners = np.array([[0.0, 0, 0], [100, 100, 0]])
    vicinity = Vicinity(corners, np.array([1.0, 0.7]))
    assert vicinity.holds(np.array([[100.0, 99.3, 5]])).all()
    far = np.array([[0.0, 100, 0], [50, 50, 0], [-9, 0, 0], [0, 109, 0], [1e300, 0, 0]])
    assert not vicinity.holds(far).any()
    # In the raster's memory, what is just beyond a line of cells is the beginning of the next.
    beyond = vicinity.high[1] - vicinity.low[1]
    assert not vicinity.holds(np.array([[0.0, beyond, 0]])).any()
    low = np.array([[20.0, 20], [-np.inf, 120]])
    assert not vicinity.meets(low, np.array([[80.0, 80], [np.inf, np.inf]])).any()
