"""The order of integers by their digits is that of a sort by comparing."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tiling.morton import ascending_order


@given(
    st.sampled_from([1, 2**16, 2**17, 2**32, 2**33, 2**48, 2**63]).flatmap(
        lambda beyond: arrays(np.int64, st.integers(0, 40), elements=st.integers(0, beyond - 1))
    )
)
def test_it_is_that_of_a_stable_sort(keys):
    np.testing.assert_array_equal(ascending_order(keys), np.argsort(keys, kind="stable"))
