import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.navigation.right_of_way import Track, escape_cells, sample_path
from robrain.protocol.model.grid_geometry import GridGeometry

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 100, 40)
SPEED_M_S = 0.6
KEEP_M, APART_M = 0.4, 0.2


def floor(*boxes):
    """Traversable are these boxes of rows and columns."""
    mask = np.zeros(GEOMETRY.shape, np.bool_)
    for top, left, bottom, right in boxes:
        mask[top:bottom, left:right] = True
    return mask


def oncoming(x0, x1, y=2.05):
    positions = sample_path(np.array([(x0, y), (x1, y)]), 100.0)
    return Track(positions, SPEED_M_S, positions.shape[0] - 1, KEEP_M, goes_first=True)


CORRIDOR = (19, 5, 22, 95)
BAY_AHEAD = (22, 40, 30, 44)
BAY_BEHIND = (22, 10, 30, 14)


def escape(mask, column, *tracks, row=20):
    return escape_cells(mask, GEOMETRY, (row, column), SPEED_M_S, tracks, APART_M)


def test_robot_does_not_brush_past_one_that_stands_even_on_its_first_step():
    corridor, bay = (20, 5, 21, 95), (10, 33, 20, 35)
    behind = oncoming(1.0, 9.0)
    stands = Track(np.array([(3.0, 2.05 + 0.56)]), SPEED_M_S, 0, KEEP_M, goes_first=False)
    assert escape(floor(corridor, bay), 27, behind)[-1][1] in (33, 34)
    assert escape(floor(corridor, bay), 27, behind, stands) is None


@settings(max_examples=50, deadline=None)
@given(st.integers(8, 90), st.floats(0.6, 9.4), st.floats(0.6, 9.4))
def test_no_refuge_lies_within_reach_of_the_others_way(column, x0, x1):
    other = oncoming(x0, x1)
    mask = floor(CORRIDOR, BAY_AHEAD, BAY_BEHIND)
    cells = escape(mask, column, other)
    if cells is None:
        return
    assert mask[cells[:, 0], cells[:, 1]].all()
    assert np.abs(np.diff(cells, axis=0)).max(initial=0) <= 1
    place = (cells[-1][1] * 0.1 + 0.05, cells[-1][0] * 0.1 + 0.05)
    near_m = np.hypot(*(other.positions - place).T).min()
    assert near_m >= min(KEEP_M + APART_M, np.hypot(*(other.positions[0] - place))) - 1e-6
