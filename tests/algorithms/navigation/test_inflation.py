import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from scipy import ndimage

from robrain.algorithms.navigation.navigation_grid import clearance_m


@pytest.mark.slow
@settings(deadline=None)
@given(arrays(np.bool_, array_shapes(min_dims=2, max_dims=2, max_side=15)), st.floats(0.05, 3.0))
def test_clearance_is_the_euclidean_distance_to_the_nearest_obstacle(occupied: np.ndarray, limit_m: float) -> None:
    closed = np.pad(occupied, 1, constant_values=True)
    expected = np.minimum(0.1 * ndimage.distance_transform_edt(~closed)[1:-1, 1:-1], limit_m)
    clearance = clearance_m(occupied, 0.1, limit_m)
    assert clearance.dtype == np.float32
    assert clearance == pytest.approx(expected, rel=1e-6)


def test_arena_edge_counts_as_an_obstacle() -> None:
    clearance = clearance_m(np.zeros((5, 7), np.bool_), 1.0, 10.0)
    assert clearance[2].tolist() == [1.0, 2.0, 3.0, 3.0, 3.0, 2.0, 1.0]
