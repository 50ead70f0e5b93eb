"""Walls that a map shows a second time are no evidence of where another map lies."""

import numpy as np
import pytest

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam.map_overlap import MapMatcher
from robrain.protocol.model.geometry import IDENTITY
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN
from tests.algorithms.slam.test_map_overlap import FEW, TEAM, WIDE

ROOM = TEAM.classes()[115:185, 115:205]
AT = FEW[1]


def rooms(second=None):
    """The team's room where it is, and a second one 8 m farther down."""
    grid = OccupancyGrid(WIDE)
    grid.merge_patch(115, 115, ROOM, 10)
    if second is not None:
        grid.merge_patch(35, 115, second, 10)
    return grid


def known_up_to(column):
    """The room of which only the left part is known."""
    part = ROOM.copy()
    part[:, column:] = UNKNOWN
    return part


def share_of(part):
    return np.count_nonzero(part == OCCUPIED) / np.count_nonzero(ROOM == OCCUPIED)


def is_there_twice(grid):
    return MapMatcher(TEAM, grid).fits_elsewhere(AT, IDENTITY)


def test_a_room_is_there_twice_where_a_map_has_an_equal_one():
    assert not is_there_twice(rooms())
    assert is_there_twice(rooms(ROOM))


def test_less_than_three_fifths_of_it_are_no_second_room():
    much, little = known_up_to(70), known_up_to(40)
    assert share_of(much) > 0.65
    assert 0.4 < share_of(little) < 0.55
    assert is_there_twice(rooms(much))
    assert not is_there_twice(rooms(little))


@pytest.mark.parametrize(("removed", "is_second"), [(1, True), (9, False)])
def test_a_room_that_lacks_walls_is_another_room(removed, is_second):
    other = ROOM.copy()
    rows, columns = np.nonzero(other == OCCUPIED)
    upper = np.argsort(-rows, kind="stable")[:removed]
    other[rows[upper], columns[upper]] = FREE
    assert is_there_twice(rooms(other)) == is_second


def test_maps_are_not_joined_by_a_room_that_either_of_them_has_twice():
    twins = rooms(ROOM)
    assert MapMatcher(twins, TEAM).find(AT) is None
    assert MapMatcher(TEAM, twins).find(AT) is None
    single = rooms(known_up_to(40))
    assert MapMatcher(single, TEAM).find(AT) is not None
    assert MapMatcher(TEAM, single).find(AT) is not None
