"""Regions left on drawn maps: each kind, its place, size and box."""

import numpy as np
import pytest

from robrain.algorithms.exploration.map_survey import NO_ROOM, floor_rooms, unknown_shares
from robrain.algorithms.exploration.narrow_passages import Gap
from robrain.algorithms.exploration.remaining_regions import Evidence, exploration_left
from robrain.protocol.messages.maps.map_messages import REGIONS_MAX, LeftKind
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

GEOMETRY = GridGeometry(0.1, -4.0, -1.0, 160, 110)
"""Much larger than what is known, and its origin is not 0: a place in a wrong frame is found."""
ROBOT = Point2D(1.0, 4.0)


def drawn(*boxes: tuple[float, float, float, float, int]) -> np.ndarray:
    """A walled room of 8 × 4 m from (0, 3) to (8, 7), then boxes: x and y of two corners, and a class."""
    classes = np.full(GEOMETRY.shape, UNKNOWN, np.int8)
    room = ((-0.1, 2.9, 8.1, 7.1, OCCUPIED), (0.0, 3.0, 8.0, 7.0, FREE))
    for x0, y0, x1, y1, kind in (*room, *boxes):
        (row, column), (end_row, end_column) = (GEOMETRY.cell_of(x + 0.01, y + 0.01) for x, y in ((x0, y0), (x1, y1)))
        classes[row:end_row, column:end_column] = kind
    return classes


def wall_with_gap(cells: int) -> tuple[tuple[float, float, float, float, int], ...]:
    """A wall across the room at x 4.0 to 4.2, with a gap of this many cells from y 5.0."""
    return (4.0, 3.0, 4.2, 7.0, OCCUPIED), (4.0, 5.0, 4.2, 5.0 + 0.1 * cells, FREE)


def left(classes: np.ndarray, **evidence: object):
    return exploration_left(classes, GEOMETRY, Evidence(**{"robots": [ROBOT], "radius_m": 0.2, **evidence}))


def test_nothing_is_left_of_a_room_that_is_all_known() -> None:
    assert left(drawn()).regions == []


def test_floor_seen_through_a_fence_without_gaps_on_the_map_is_unreachable() -> None:
    (region,) = left(drawn(*wall_with_gap(0))).regions
    assert (region.kind, region.gap_m, region.needed_m) == (LeftKind.UNREACHABLE, None, None)
    assert region.area_m2 == pytest.approx(3.8 * 4.0)
    assert (region.low, region.high) == (Point2D(4.2, 3.0), Point2D(8.0, 7.0))
    assert 5.5 < region.place.x_m < 6.7
    assert 4.5 < region.place.y_m < 5.5


@pytest.mark.parametrize(("cells", "width_m"), [(1, 0.2), (2, 0.3)])
def test_floor_behind_a_gap_narrower_than_any_that_may_be_wide_enough_is_too_narrow(cells: int, width_m: float) -> None:
    (region,) = left(drawn(*wall_with_gap(cells))).regions
    assert region.kind is LeftKind.TOO_NARROW
    assert region.gap_m == pytest.approx(width_m)
    assert (region.needed_m, region.gap_at) == (0.44, None)
    assert region.area_m2 > 15.0


def test_a_gap_that_may_be_wide_enough_is_left_to_be_tried() -> None:
    assert left(drawn(*wall_with_gap(3))).regions == []


@pytest.mark.parametrize(("tries", "kinds"), [(1, []), (2, [LeftKind.TOO_NARROW])])
def test_a_gap_in_which_robots_failed_twice_is_too_narrow_with_the_measured_width(tries: int, kinds: list) -> None:
    gap = Gap(Point2D(3.8, 5.15), 0.387, tries, 0)
    regions = left(drawn(*wall_with_gap(3)), gaps=[gap]).regions
    assert [region.kind for region in regions] == kinds
    for region in regions:
        assert (region.gap_m, region.gap_at) == (0.387, gap.place)
        assert region.area_m2 > 15.0


def test_floor_in_which_a_robot_was_before_is_cut_off() -> None:
    (region,) = left(drawn(*wall_with_gap(0)), been=[Point2D(1.0, 5.0), Point2D(6.0, 4.0)]).regions
    assert region.kind is LeftKind.CUT_OFF


def test_floor_where_robots_failed_twice_is_tried() -> None:
    (region,) = left(drawn(*wall_with_gap(0)), failures=[(Point2D(6.0, 4.0), 2)]).regions
    assert (region.kind, region.tries) == (LeftKind.TRIED, 2)
    (region,) = left(drawn(*wall_with_gap(0)), failures=[(Point2D(6.0, 4.0), 1)]).regions
    assert (region.kind, region.tries) == (LeftKind.UNREACHABLE, 1)


DOORWAY = (8.0, 4.0, 8.1, 6.0, FREE)
"""The room's wall is open, and beyond it nothing is known."""


def test_unknown_beyond_a_frontier_that_robots_reach_is_unseen() -> None:
    (region,) = left(drawn(DOORWAY)).regions
    assert (region.kind, region.gap_m) == (LeftKind.UNSEEN, None)
    assert region.place.x_m == pytest.approx(8.05)
    assert 4.0 < region.place.y_m < 6.0
    assert region.low.x_m >= 8.0
    assert region.area_m2 == pytest.approx(2.0 * 4.1)  # to 2 m from the middle of the edge, on all sides


def test_of_many_regions_the_largest_are_named_and_the_others_summed() -> None:
    geometry = GridGeometry(0.1, 0.0, 0.0, 170, 70)
    classes = np.full(geometry.shape, OCCUPIED, np.int8)
    classes[10:50, 130:160] = FREE
    for number in range(72):
        row, column = 1 + 11 * (number % 6), 1 + 10 * (number // 6)
        classes[row : row + (10 if number >= 8 else 8), column : column + 8] = FREE
    found = exploration_left(classes, geometry, Evidence([Point2D(14.0, 3.0)], 0.2))
    assert [region.area_m2 for region in found.regions] == [0.8] * REGIONS_MAX
    assert (found.more, found.more_m2) == (8, pytest.approx(8 * 0.64))


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


def test_an_unseen_region_behind_a_gap_that_may_be_too_narrow_has_its_width() -> None:
    (region,) = left(drawn(*wall_with_gap(3), DOORWAY)).regions
    assert (region.kind, region.gap_m, region.needed_m) == (LeftKind.UNSEEN, pytest.approx(0.4), 0.44)
    gap = Gap(Point2D(3.8, 5.15), 0.41, 1, 0)
    (region,) = left(drawn(*wall_with_gap(3), DOORWAY), gaps=[gap]).regions
    assert (region.kind, region.gap_m) == (LeftKind.TOO_NARROW, 0.41)


def test_a_frontier_where_robots_failed_twice_is_tried() -> None:
    (region,) = left(drawn(DOORWAY), failures=[(Point2D(8.0, 5.0), 2)]).regions
    assert region.kind is LeftKind.TRIED
