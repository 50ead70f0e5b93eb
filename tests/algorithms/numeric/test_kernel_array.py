import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from robrain.algorithms.numeric.kernel_array import BOOL, FLOAT32, FLOAT64, INT8, INT32, INT64, kernel_array

GRID = np.arange(12, dtype=np.float64).reshape(3, 4)


def read_only(array):
    array = array.copy()
    array.flags.writeable = False
    return array


def test_an_array_that_is_as_wanted_is_handed_on_itself():
    assert kernel_array(GRID, FLOAT64) is GRID


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(GRID.T, id="by columns"),
        pytest.param(GRID[:, ::2], id="with gaps"),
        pytest.param(read_only(GRID), id="read-only"),
        pytest.param(GRID.astype(np.float32), id="of another type"),
        pytest.param(GRID.astype(">f8"), id="in another order of bytes"),
    ],
)
def test_another_is_copied(other):
    made = kernel_array(other, FLOAT64)
    assert np.array_equal(made, other)
    assert made is not other
    assert made.dtype == np.float64
    assert made.dtype.isnative
    assert made.flags.carray


@given(
    arrays.arrays(st.sampled_from([np.bool_, np.int8, np.int32]), arrays.array_shapes(max_dims=2, max_side=4)),
    st.sampled_from([BOOL, INT8, INT32, INT64, FLOAT32, FLOAT64]),
)
def test_it_is_what_numpys_require_makes(array, dtype):
    made, expected = kernel_array(array, dtype), np.require(array, dtype, ("C", "A", "W"))
    assert made.dtype == expected.dtype
    assert np.array_equal(made, expected)
    assert made.flags.carray
