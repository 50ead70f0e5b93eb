"""Unknown floor goes to the frontier that is nearest to it."""

import numpy as np

from robrain.algorithms.exploration.map_look import unknown_shares
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN


def strip(length=20):
    """Known floor of two cells at each end, unknown floor between them: one row."""
    classes = np.full((1, length), UNKNOWN, np.int8)
    classes[0, :2] = classes[0, -2:] = FREE
    return classes


def test_two_frontiers_share_what_is_between_them():
    assert unknown_shares(strip(), [(0, 1), (0, 18)], 100).tolist() == [8, 8]


def test_cells_beyond_reach_count_for_none():
    assert unknown_shares(strip(), [(0, 1), (0, 18)], 3).tolist() == [3, 3]


def test_known_walls_and_floor_are_not_crossed():
    classes = strip()
    classes[0, 6] = OCCUPIED
    assert unknown_shares(classes, [(0, 1), (0, 18)], 100).tolist() == [4, 11]
    classes[0, 6] = FREE
    assert unknown_shares(classes, [(0, 1), (0, 18)], 100).tolist() == [4, 11]


def test_of_frontiers_equally_near_the_first_gets_the_cell():
    assert unknown_shares(strip(5), [(0, 1), (0, 3)], 9).tolist() == [1, 0]
    assert unknown_shares(strip(5), [(0, 3), (0, 1)], 9).tolist() == [1, 0]


def test_without_frontiers_and_with_frontiers_beside_the_map_nothing_is_shared():
    assert unknown_shares(strip(), [], 5).tolist() == []
    assert unknown_shares(strip(), [(3, 50)], 5).tolist() == [0]
