"""How maps of different frames lie to each other: what is found, what contradicts, and what is not enough."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam import map_overlap
from robrain.algorithms.slam.map_overlap import COMMON_MIN, MapMatcher, Overlap, cells_outside
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from tests.algorithms.mapping.lidar_floor import ANGLES_RAD, NOBODY, RANGE_M, ROOM, ROOM_PLACES, LidarFloor
from tests.algorithms.slam.submap_walks import off

WIDE = GridGeometry(0.1, -12.0, -12.0, 240, 240)
BOXES = ((0, 0, 8, 0.24), (0, 0, 0.24, 6), (7.76, 0, 8, 6), (0, 5.76, 8, 6))
CRATED = LidarFloor(*BOXES, (3.06, 2.02, 3.72, 2.68), (5.5, 3.44, 6.42, 4.1), (1.6, 3.8, 2.4, 4.4))
"""The room with one more crate."""
BARE = LidarFloor(*BOXES)


def mapped(floor, places, T_own_floor=IDENTITY, geometry=WIDE):
    """What a robot maps that believes its frame to lie so."""
    grid = OccupancyGrid(geometry)
    for stamp_ms, place in enumerate(places, 1):
        ranges_m = floor.ranges_m(place)
        grid.integrate_scan(T_own_floor.compose(place), ANGLES_RAD, ranges_m, RANGE_M, stamp_ms, NOBODY)
    return grid


TEAM = mapped(ROOM, ROOM_PLACES)
FEW = [Pose2D(1.0, 1.0, 0.0), Pose2D(2.1, 3.12, 0.0), Pose2D(4.5, 5.0, 0.0), Pose2D(4.5, 1.0, 0.0)]


@settings(deadline=None, max_examples=12)
@given(st.floats(-3.0, 1.0), st.floats(-3.0, 1.0), st.floats(-math.pi, math.pi))
def test_maps_of_one_room_in_frames_that_are_turned_and_shifted_lie_on_each_other(x_m, y_m, yaw_rad):
    T_own_floor = Pose2D(x_m, y_m, yaw_rad)
    matcher = MapMatcher(mapped(ROOM, FEW, T_own_floor), TEAM)
    found = matcher.find(T_own_floor.compose(FEW[1]))
    assert found is not None
    at = T_own_floor.compose(FEW[1])
    assert off(found.T_other_own.compose(at), FEW[1]) == pytest.approx((0.0, 0.0, 0.0), abs=0.06)
    assert found.overlap.evidence > 3000
    assert found.overlap == matcher.overlap(found.T_other_own)


def test_a_room_without_what_stands_in_it_looks_the_same_from_both_ends():
    """Half a turn about its middle: walls alone do not tell which it is."""
    bare = mapped(BARE, ROOM_PLACES)
    assert MapMatcher(bare, bare).find(FEW[1]) is None
    assert MapMatcher(TEAM, TEAM).find(FEW[1]) is not None


def test_of_two_rooms_that_are_equal_but_for_a_crate_neither_is_an_answer():
    """One room has a crate that should not be there; of the other, a part of a wall is not known yet."""
    room = TEAM.classes()[115:185, 115:205]
    crated, partial = room.copy(), room.copy()
    crated[51:59, 21:29] = OCCUPIED
    partial[:35, 79:] = UNKNOWN
    twins = OccupancyGrid(WIDE)
    twins.merge_patch(115, 115, crated, 10)
    twins.merge_patch(35, 115, partial, 10)
    assert MapMatcher(TEAM, twins).find(FEW[1]) is None


@pytest.mark.parametrize(("count", "is_searched"), [(59, False), (60, True)])
def test_a_place_with_few_walls_about_it_is_not_looked_for(monkeypatch, count, is_searched):
    searched = []
    monkeypatch.setattr(map_overlap, "search_places", lambda *asked: searched.append(asked) or [])
    rows, columns = np.nonzero(TEAM.classes() == OCCUPIED)
    nearest = np.argsort(np.hypot(rows - 130, columns - 130), kind="stable")[:count]
    classes = np.full(WIDE.shape, UNKNOWN, np.int8)
    classes[rows[nearest], columns[nearest]] = OCCUPIED
    classes[5, 5:200] = OCCUPIED  # farther than 8 m
    assert MapMatcher(grid_of(classes, WIDE), TEAM).find(Pose2D(1.0, 1.0, 0.0)) is None
    assert bool(searched) == is_searched


SIDE = 40
SMALL = GridGeometry(0.1, -2.0, 1.0, SIDE, SIDE)


def grid_of(classes, geometry=SMALL):
    grid = OccupancyGrid(geometry)
    grid.merge_patch(0, 0, classes.astype(np.int8), 10)
    return grid


def floor_with(*walls):
    classes = np.full((SIDE, SIDE), FREE)
    classes[0] = OCCUPIED
    for row, column in walls:
        classes[row, column] = OCCUPIED
    return classes


LINE = [(20, 10), (20, 11), (20, 12), (20, 13)]
CLUSTERS = [
    (LINE, 4),
    (LINE[:3], 0),
    ([(20, 10), (21, 11), (22, 12), (23, 11)], 4),  # connected over corners
    ([(20, 10), (20, 12), (20, 14), (20, 16), (20, 18)], 0),  # single cells
    ([*LINE, (30, 30), (30, 32)], 4),
    ([*LINE, *[(row + 5, column) for row, column in LINE], (30, 4)], 8),
    ([(39, 36), (39, 37), (39, 38), (39, 39)], 4),
]


@pytest.mark.parametrize(("walls", "contradicting"), CLUSTERS)
def test_walls_that_are_floor_on_the_other_map_contradict_it_where_they_are_connected(walls, contradicting):
    clear, walled = grid_of(floor_with()), grid_of(floor_with(*walls))
    assert MapMatcher(walled, clear).overlap(IDENTITY)[:2] == (SIDE, contradicting)
    assert MapMatcher(clear, walled).overlap(IDENTITY)[:2] == (SIDE, contradicting), "whichever map has them"


@pytest.mark.parametrize("away", [-3, -2, -1, 0, 1, 2, 3])
@pytest.mark.parametrize("upright", [True, False])
def test_walls_up_to_two_cells_apart_are_the_same_wall_on_whichever_side_they_lie(away, upright):
    own, other = (
        grid_of(floor_with(*[(18 + n, 18 + aside) if upright else (18 + aside, 18 + n) for n in range(4)]))
        for aside in (0, away)
    )
    expected = (SIDE + 4, 0) if abs(away) <= 2 else (SIDE, 8)
    assert MapMatcher(own, other).overlap(IDENTITY)[:2] == expected


def test_what_either_map_does_not_know_says_nothing():
    walled = grid_of(floor_with(*LINE))
    nothing = grid_of(np.full((SIDE, SIDE), UNKNOWN))
    assert MapMatcher(walled, nothing).overlap(IDENTITY)[:2] == (0, 0)
    assert MapMatcher(nothing, walled).overlap(IDENTITY)[:2] == (0, 0)
    assert MapMatcher(walled, walled).overlap(Pose2D(50.0, 0.0, 0.0)) == Overlap(0, 0, 0)


@pytest.mark.parametrize("place", [Pose2D(1.0, 0.5, 0.0), Pose2D(0.0, 0.0, math.pi / 2), Pose2D(-0.7, 0.3, -math.pi)])
def test_maps_are_compared_as_they_lie_to_each_other(place):
    """What lies so in the one is there in the other, cell for cell."""
    own = grid_of(floor_with(*LINE))
    wide = GridGeometry(0.1, -8.0, -8.0, 160, 160)
    classes = np.full(wide.shape, UNKNOWN, np.int8)
    for row in range(SIDE):
        for column in range(SIDE):
            middle = SMALL.center_of(row, column)
            there = place.compose(Pose2D(middle.x_m, middle.y_m, 0.0))
            classes[wide.cell_of(there.x_m, there.y_m)] = own.classes()[row, column]
    matcher = MapMatcher(own, grid_of(classes, wide))
    assert matcher.overlap(place)[:2] == (SIDE + 4, 0)
    assert matcher.overlap(Pose2D(place.x_m + 1.0, place.y_m + 1.0, place.yaw_rad)).contradicting > 0


BODY_AT = SMALL.center_of(20, 11)


@pytest.mark.parametrize(
    ("own", "other", "contradicting"),
    [
        ([(0.0, 0.0, 0.2)], [], 0),
        ([], [(0.0, 0.0, 0.2)], 0),
        ([], [(0.8, 0.0, 0.2)], 4),
        ([(0.0, 0.8, 0.2)], [], 4),
        ([(0.0, 0.8, 0.6)], [], 0),
        ([(5.0, 5.0, 0.2), (0.0, 0.0, 0.2)], [(3.0, 0.0, 0.1)], 0),
    ],
)
@pytest.mark.parametrize("T_other_own", [IDENTITY, Pose2D(0.4, -0.2, 0.0), Pose2D(0.3, 0.1, math.pi / 2)])
def test_what_may_be_a_robot_on_either_map_contradicts_nothing(own, other, contradicting, T_other_own):
    """Bodies are told in cells' distances from the crate, in the frame of the map whose robots they are."""
    wide = GridGeometry(0.1, -8.0, -8.0, 160, 160)
    clear = grid_of(np.full(wide.shape, FREE), wide)
    own_at = np.array([(BODY_AT.x_m + x_m, BODY_AT.y_m + y_m, r) for x_m, y_m, r in own]).reshape(-1, 3)
    other_at = [(T_other_own.compose(Pose2D(BODY_AT.x_m + x_m, BODY_AT.y_m + y_m, 0.0)), r) for x_m, y_m, r in other]
    there = np.array([(at.x_m, at.y_m, r) for at, r in other_at]).reshape(-1, 3)
    classes = np.full((SIDE, SIDE), UNKNOWN)
    classes[18:23, 8:16] = FREE
    for row, column in LINE:
        classes[row, column] = OCCUPIED
    matcher = MapMatcher(grid_of(classes), clear, own_at, there)
    assert matcher.overlap(T_other_own).contradicting == contradicting


SQUARE = [(row, column) for row in range(20, 23) for column in range(10, 12)]
"""6 cells."""
LONG = [(30, column) for column in range(5, 15)]
"""1 m: no robot is so long."""


@pytest.mark.parametrize(
    ("walls", "strangers", "contradicting"),
    [
        (SQUARE, 0, 6),
        (SQUARE, 1, 0),
        (SQUARE + [(row, 30) for row in range(20, 28)], 1, 6),  # the larger one is left out
        (SQUARE + [(row, 30) for row in range(20, 28)], 2, 0),
        (LONG, 3, 10),
        ([(row, 30) for row in range(20, 29)], 1, 9),
        (LONG + SQUARE, 1, 10),
        ([(row, column) for row in range(2, 5) for column in range(10, 12)], 1, 4),  # at the wall in row 0
    ],
)
def test_as_many_small_things_as_there_may_be_unknown_robots_contradict_nothing(walls, strangers, contradicting):
    clear, walled = grid_of(floor_with()), grid_of(floor_with(*walls))
    assert MapMatcher(walled, clear, strangers=strangers).overlap(IDENTITY).contradicting == contradicting
    assert MapMatcher(clear, walled, strangers=strangers).overlap(IDENTITY).contradicting == contradicting


@pytest.mark.parametrize(
    ("T_other_own", "outside"),
    [
        (IDENTITY, 0),
        (Pose2D(-1.0, 0.0, 0.0), 10 * (SIDE - 1)),
        (Pose2D(0.0, 1.0, 0.0), 10 * SIDE),
        (Pose2D(0.0, 0.0, math.pi), (SIDE - 1) * SIDE),
    ],
)
def test_floor_that_lies_beyond_the_edge_of_the_other_map_is_counted(T_other_own, outside):
    assert cells_outside(grid_of(floor_with()), T_other_own, SMALL) == outside


def test_a_crate_that_has_come_since_contradicts_the_map_unless_a_robot_stood_there():
    own, (x_m, y_m) = mapped(CRATED, FEW), (2.0, 4.1)
    assert MapMatcher(own, TEAM).find(FEW[0]) is None
    crate = np.array([(x_m, y_m, 0.6)])
    for bodies in ((crate, NOBODY), (NOBODY, crate)):
        found = MapMatcher(own, TEAM, *bodies).find(FEW[0])
        assert found is not None
        assert off(found.T_other_own, IDENTITY) == pytest.approx((0.0, 0.0, 0.0), abs=0.06)


@pytest.mark.parametrize(
    ("agreeing", "contradicting", "is_match"),
    [
        (COMMON_MIN, 0, True),
        (COMMON_MIN - 1, 0, False),
        (396, 4, True),
        (395, 4, False),
        (990, 10, True),
        (989, 10, False),
        (0, 0, False),
    ],
)
def test_maps_show_the_same_place_if_enough_walls_agree_and_next_to_none_contradicts(agreeing, contradicting, is_match):
    overlap = Overlap(agreeing, contradicting, 4000)
    assert overlap.evidence == (4000 + 5 * agreeing if is_match else 0)
    assert overlap.share == pytest.approx(agreeing / max(agreeing + contradicting, 1))
    assert overlap.weight == max(agreeing - 2 * contradicting, 0)


def test_an_answer_needs_as_much_evidence_as_is_asked_for():
    own = mapped(ROOM, FEW)
    found = MapMatcher(own, TEAM).find(FEW[1])
    assert found is not None
    evidence = found.overlap.evidence
    assert MapMatcher(own, TEAM, evidence_min=evidence).find(FEW[1]) == found
    assert MapMatcher(own, TEAM, evidence_min=evidence + 1).find(FEW[1]) is None
