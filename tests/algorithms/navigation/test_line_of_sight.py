import math

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from robrain.algorithms.navigation.path_planning import standpoint
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN

FLOOR = np.full((20, 20), FREE, np.int8)


def test_a_place_that_can_be_stood_at_is_looked_at_from_itself() -> None:
    assert standpoint(FLOOR, FLOOR == FREE, (7, 9), 5) == (7, 9)


def test_what_is_unknown_hides_nothing() -> None:
    classes = FLOOR.copy()
    classes[6:9] = UNKNOWN
    traversable = np.zeros(FLOOR.shape, np.bool_)
    traversable[12, 9] = True
    assert standpoint(classes, traversable, (5, 9), 10) == (12, 9)


def test_a_place_off_the_map_is_seen_from_its_edge_if_that_is_in_reach() -> None:
    assert standpoint(FLOOR, FLOOR == FREE, (-3, 5), 5) == (0, 5)
    assert standpoint(FLOOR, FLOOR == FREE, (-30, 5), 5) is None


@settings(max_examples=60, deadline=None)
@given(
    arrays(np.int8, (12, 12), elements=st.sampled_from([FREE, FREE, FREE, OCCUPIED, UNKNOWN])),
    arrays(np.bool_, (12, 12)),
    st.tuples(st.integers(0, 11), st.integers(0, 11)),
    st.integers(1, 8),
)
def test_a_standpoint_is_traversable_in_reach_and_none_in_plain_sight_is_nearer(classes, traversable, cell, reach):
    found = standpoint(classes, traversable, cell, reach)
    if found is not None:
        assert traversable[found]
        assert math.dist(found, cell) <= reach
    beside = [(cell[0] + step, cell[1]) for step in (-1, 0, 1) if 0 <= cell[0] + step < 12]
    for near in beside:  # nothing lies between these
        if traversable[near] and classes[near] != OCCUPIED and classes[cell] != OCCUPIED:
            assert found is not None
            assert math.dist(found, cell) <= math.dist(near, cell)
