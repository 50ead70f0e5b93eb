"""Elementary functions of arrays are those of `math`, to the last bit."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.numeric.elementary_functions import arctan2, exp, log, log10

values = st.lists(st.floats(-700.0, 700.0), min_size=1, max_size=20)


@given(values)
def test_each_entry_is_what_math_makes_of_it(given_values: list[float]) -> None:
    whole = np.array(given_values)
    above = np.abs(whole) + 1e-9
    assert exp(whole).tolist() == [math.exp(value) for value in given_values]
    assert log(above).tolist() == [math.log(value) for value in above.tolist()]
    assert log10(above).tolist() == [math.log10(value) for value in above.tolist()]
    assert arctan2(whole, above).tolist() == [math.atan2(*each) for each in zip(given_values, above, strict=True)]


@pytest.mark.parametrize("function", [exp, log, log10])
def test_shape_is_kept_and_a_view_may_be_given(function) -> None:
    square = np.arange(1.0, 13.0).reshape(3, 4)
    np.testing.assert_allclose(function(square.T[:, ::2]), getattr(np, function.__name__)(square.T[:, ::2]), rtol=1e-15)
    square.setflags(write=False)
    assert function(square).shape == (3, 4)
    np.testing.assert_allclose(arctan2(square, square.T.reshape(3, 4)), np.arctan2(square, square.T.reshape(3, 4)))
