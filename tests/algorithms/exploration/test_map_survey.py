"""Unknown floor goes to the frontier that is nearest to it; the known floor is divided at its narrow places."""

import numpy as np

from robrain.algorithms.exploration.map_survey import NO_ROOM, floor_rooms, unknown_shares
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN

CELL_M = 0.1


def walled(rows=40, columns=80):
    classes = np.full((rows, columns), FREE, np.int8)
    classes[[0, -1]] = classes[:, [0, -1]] = OCCUPIED
    return classes


def two_rooms(door_cells):
    """Two rooms of 3.8 by 3.9 m with a door in the middle of the wall between them."""
    classes = walled()
    classes[:, 40] = OCCUPIED
    first = 20 - door_cells // 2
    classes[first : first + door_cells, 40] = FREE
    return classes


def test_a_door_parts_two_rooms():
    rooms = floor_rooms(two_rooms(8), CELL_M)
    assert len({rooms[20, 10], rooms[20, 70]}) == 2
    assert len(np.unique(rooms[2:-2, 2:36])) == 1
    assert len(np.unique(rooms[2:-2, 45:-2])) == 1


def test_a_gap_nearly_as_wide_as_the_rooms_parts_nothing():
    rooms = floor_rooms(two_rooms(34), CELL_M)
    assert rooms[20, 10] == rooms[20, 70]


def test_cells_that_are_not_free_are_in_no_room():
    classes = two_rooms(8)
    classes[5:9, 5:9] = UNKNOWN
    rooms = floor_rooms(classes, CELL_M)
    assert np.array_equal(rooms == NO_ROOM, classes != FREE)


def test_rooms_behind_a_wall_without_a_door_are_two_and_numbers_are_without_gaps():
    rooms = floor_rooms(two_rooms(0), CELL_M)
    assert sorted(np.unique(rooms)) == [NO_ROOM, 0, 1]


def test_a_corridor_is_parted_from_the_rooms_along_it():
    classes = walled(60, 90)
    classes[20] = OCCUPIED
    classes[21:, [30, 60]] = OCCUPIED
    for middle in (15, 45, 75):
        classes[20, middle - 4 : middle + 4] = FREE
    rooms = floor_rooms(classes, CELL_M)
    assert len({rooms[10, 45], rooms[45, 15], rooms[45, 45], rooms[45, 75]}) == 4


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
