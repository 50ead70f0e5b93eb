"""How maps of different frames lie to each other: what is found, what contradicts, and what is not enough."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.slam import map_overlap
from robrain.algorithms.slam.map_overlap import YAWS, MapMatcher, Overlap, cells_outside, search_places
from robrain.protocol.model.geometry import IDENTITY, Pose2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from tests.algorithms.mapping.lidar_floor import ANGLES_RAD, GEOMETRY, NOBODY, RANGE_M, ROOM, ROOM_PLACES, LidarFloor
from tests.algorithms.slam.submap_walks import off

WIDE = GridGeometry(0.1, -12.0, -12.0, 240, 240)
BOXES = ((0, 0, 8, 0.24), (0, 0, 0.24, 6), (7.76, 0, 8, 6), (0, 5.76, 8, 6))
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


def test_what_either_map_does_not_know_says_nothing():
    walled = grid_of(floor_with(*LINE))
    nothing = grid_of(np.full((SIDE, SIDE), UNKNOWN))
    assert MapMatcher(walled, nothing).overlap(IDENTITY)[:2] == (0, 0)
    assert MapMatcher(nothing, walled).overlap(IDENTITY)[:2] == (0, 0)
    assert MapMatcher(walled, walled).overlap(Pose2D(50.0, 0.0, 0.0)) == Overlap(0, 0, 0)


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


KNOWN_ROOM = TEAM.classes()[115:185, 115:205]
AT = FEW[1]


def rooms(second=None):
    """The team's room where it is, and a second one 8 m farther down."""
    grid = OccupancyGrid(WIDE)
    grid.merge_patch(115, 115, KNOWN_ROOM, 10)
    if second is not None:
        grid.merge_patch(35, 115, second, 10)
    return grid


def known_up_to(column):
    """The room of which only the left part is known."""
    part = KNOWN_ROOM.copy()
    part[:, column:] = UNKNOWN
    return part


def is_there_twice(grid):
    return MapMatcher(TEAM, grid).fits_elsewhere(AT, IDENTITY)


def test_a_room_is_there_twice_where_a_map_has_an_equal_one():
    assert not is_there_twice(rooms())
    assert is_there_twice(rooms(KNOWN_ROOM))


def test_maps_are_not_joined_by_a_room_that_either_of_them_has_twice():
    twins = rooms(KNOWN_ROOM)
    assert MapMatcher(twins, TEAM).find(AT) is None
    assert MapMatcher(TEAM, twins).find(AT) is None
    single = rooms(known_up_to(40))
    assert MapMatcher(single, TEAM).find(AT) is not None
    assert MapMatcher(TEAM, single).find(AT) is not None


ROOM_MAP = ROOM.mapped(*ROOM_PLACES).log_odds


def distance_and_turn(pose, other):
    return pose.distance_m(other), abs(math.remainder(pose.yaw_rad - other.yaw_rad, math.tau))


@settings(deadline=None, max_examples=30)
@given(st.sampled_from([*ROOM_PLACES, Pose2D(0.45, 0.45, 0.0), Pose2D(7.5, 5.5, 0.0)]), st.floats(-math.pi, math.pi))
def test_a_scan_is_found_on_the_map_in_whatever_direction_it_was_made(place, yaw_rad):
    true = Pose2D(place.x_m, place.y_m, yaw_rad)
    (_, found), *_ = search_places(ROOM_MAP, GEOMETRY, ROOM.points(true), 4)
    off_m, off_rad = distance_and_turn(found, true)
    assert off_m < 0.2
    assert off_rad < math.tau / YAWS


def test_memory_for_places_is_bounded():
    """One point beside a wall lies on it in all directions, from nearly everywhere."""
    log_odds = np.full((300, 300), -50, np.int8)
    log_odds[::8, ::8] = 50
    found = search_places(log_odds, GridGeometry(0.1, 0.0, 0.0, 300, 300), np.array([(0.4, 0.0)]), 1_000_000)
    assert len(found) == map_overlap.NODES_MAX


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


def test_an_answer_needs_as_much_evidence_as_is_asked_for():
    own = mapped(ROOM, FEW)
    found = MapMatcher(own, TEAM).find(FEW[1])
    assert found is not None
    evidence = found.overlap.evidence
    assert MapMatcher(own, TEAM, evidence_min=evidence).find(FEW[1]) == found
    assert MapMatcher(own, TEAM, evidence_min=evidence + 1).find(FEW[1]) is None
