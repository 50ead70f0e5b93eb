import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from robrain.algorithms.numeric.kernel_array import BOOL, FLOAT32, FLOAT64, INT8, INT32, INT64, kernel_array

GRID = np.arange(12, dtype=np.float64).reshape(3, 4)


def test_an_array_that_is_as_wanted_is_handed_on_itself():
    assert kernel_array(GRID, FLOAT64) is GRID


@given(
    arrays.arrays(st.sampled_from([np.bool_, np.int8, np.int32]), arrays.array_shapes(max_dims=2, max_side=4)),
    st.sampled_from([BOOL, INT8, INT32, INT64, FLOAT32, FLOAT64]),
)
def test_it_is_what_numpys_require_makes(array, dtype):
    made, expected = kernel_array(array, dtype), np.require(array, dtype, ("C", "A", "W"))
    assert made.dtype == expected.dtype
    assert np.array_equal(made, expected)
    assert made.flags.carray
