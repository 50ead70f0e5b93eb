"""Tours that know rooms, work and mates' ways."""

import numpy as np
import pytest

from robrain.algorithms.exploration.explorer import Explorer, Scout
from robrain.algorithms.exploration.map_survey import MapSurvey
from robrain.algorithms.exploration.situation import Busy, FrontierCandidate, Seeker, Situation
from robrain.algorithms.exploration.strategies import ROOMS, joint, strategy_of
from robrain.algorithms.exploration.tours import DOOR_M, MEET_M, auto, meetings_m, rooms, tours
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry

GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 120, 60)


class Look:
    """Rooms by x: one to each `room_m`."""

    def __init__(self, candidates, shares_m2, room_m=1000.0, room_m2=20.0):
        self._room_m = room_m
        self.room_m2 = room_m2
        self.shares_m2 = np.array(shares_m2, np.float64)
        self.frontier_rooms = np.array([self.room_of(one.place) for one in candidates])

    def room_of(self, place):
        return int((place.x_m + 500.0) // self._room_m)


def at(x_m, y_m=0.0):
    return FrontierCandidate(Point2D(x_m, y_m), 1.0, 4.0)


def straight(candidates, seekers, busy=(), *, shares_m2=None, room_m=1000.0):
    shares_m2 = [4.0] * len(candidates) if shares_m2 is None else shares_m2
    return Situation(
        candidates,
        seekers,
        busy,
        lambda place: np.array([place.distance_m(one.place) for one in candidates]),
        floor=Look(candidates, shares_m2, room_m),
    )


def goals(choices):
    return {choice.robot: choice.place.x_m for choice in choices}


def seeker(name, x_m=0.0, *, goal=None):
    return Seeker(name, Point2D(x_m, 0.0), goal=None if goal is None else Point2D(goal, 0.0))


def test_much_unknown_floor_far_away_outweighs_a_little_nearby():
    near, far = at(-2.0), at(6.0)
    assert goals(rooms(straight([near, far], [seeker("r1")], shares_m2=[2.0, 2.0]))) == {"r1": -2.0}
    assert goals(rooms(straight([near, far], [seeker("r1")], shares_m2=[2.0, 40.0]))) == {"r1": 6.0}


def test_robot_in_front_of_much_work_leaves_the_rest_to_the_others():
    """The second goes where the first will have no time for, although that is nearer to the first."""
    large, beyond = at(3.0), at(5.0)
    made = goals(rooms(straight([large, beyond], [seeker("r1"), seeker("r2", -6.0)], shares_m2=[40.0, 4.0])))
    assert made == {"r1": 3.0, "r2": 5.0}


def test_robot_finishes_its_room_before_it_takes_something_nearer_outside():
    inside, outside = at(2.2), at(5.5)
    one = [seeker("r1", 4.0)]
    assert goals(rooms(straight([inside, outside], one))) == {"r1": 5.5}
    assert goals(rooms(straight([inside, outside], one, room_m=5.0))) == {"r1": 2.2}
    assert DOOR_M > 0.3


def test_way_against_another_robots_way_costs_more_and_one_behind_it_does_not():
    candidates = [at(10.0), at(-10.0)]
    towards = straight(candidates, [seeker("r1", 0.0), seeker("r2", 5.0, goal=-10.0)])
    assert meetings_m(towards).tolist() == [[MEET_M, 0.0], [0.0, 0.0]]
    behind = straight(candidates, [seeker("r1", 0.0), seeker("r2", 5.0, goal=10.0)])
    assert meetings_m(behind).tolist() == [[0.0, 0.0], [0.0, 0.0]]


def test_busy_robots_are_met_as_well_and_robots_whose_goal_is_no_frontier_are_not():
    candidates = [at(10.0), at(-10.0)]
    coming, leaving = Busy(Point2D(5.0, 0.0), Point2D(-10.0, 0.0)), Busy(Point2D(5.0, 0.0), Point2D(0.0, 40.0))
    assert meetings_m(straight(candidates, [seeker("r1")], [coming])).tolist() == [[MEET_M, 0.0]]
    assert meetings_m(straight(candidates, [seeker("r1")], [leaving])).tolist() == [[0.0, 0.0]]


def test_ways_that_run_against_each_other_for_a_short_stretch_cost_a_part():
    candidates = [at(10.0), at(4.0)]
    made = meetings_m(straight(candidates, [seeker("r1")], [Busy(Point2D(5.0, 0.0), Point2D(4.0, 0.0))]))
    assert made.tolist() == [[pytest.approx(MEET_M / 2), 0.0]]


def test_robot_makes_way_to_the_other_side_if_one_comes_towards_it():
    candidates = [at(6.0), at(-7.0), at(-40.0)]
    coming = Busy(Point2D(5.5, 0.0), Point2D(-40.0, 0.0))
    assert goals(rooms(straight(candidates[:2], [seeker("r1")]))) == {"r1": 6.0}
    assert goals(rooms(straight(candidates, [seeker("r1")], [coming]))) == {"r1": -7.0}


def test_without_a_map_what_frontiers_promise_counts_instead():
    candidates = [at(2.0), FrontierCandidate(Point2D(-2.0, 0.0), 1.0, 12.0)]
    situation = Situation(
        candidates, [seeker("r1")], [], lambda place: np.array([place.distance_m(one.place) for one in candidates])
    )
    assert goals(rooms(situation)) == {"r1": -2.0}


# -- the default ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("robots", "room_m2", "known_m2", "by_rooms"),
    [
        (3, 20, 20, True),
        (4, 44, 20, True),
        (5, 44, 151, True),
        (8, 44, 151, True),
        (2, 20, 151, False),
        (4, 46, 151, False),
        (8, 46, 151, False),
        (5, 20, 149, False),
    ],
)
def test_three_robots_and_more_are_sent_by_rooms_where_those_are_small(robots, room_m2, known_m2, by_rooms):
    near, far = at(-2.0), at(6.0)
    busy = [Busy(Point2D(0.0, 90.0 + number), Point2D(0.0, 95.0 + number)) for number in range(robots - 1)]
    situation = straight([near, far], [seeker("r1")], busy, shares_m2=[2.0, 40.0])
    situation.floor.room_m2, situation.floor.known_m2 = room_m2, known_m2
    assert goals(rooms(situation)) == {"r1": 6.0}
    assert goals(tours(situation)) == goals(joint(situation)) == {"r1": -2.0}
    assert (auto(situation) == rooms(situation)) is by_rooms


def test_a_map_without_a_room_has_no_small_rooms():
    assert MapSurvey(OccupancyGrid(GEOMETRY), []).room_m2 == np.inf


# -- what the map shows -----------------------------------------------------------------------------------------


def two_rooms():
    """A corridor of two rooms, known as far as 1 m from the ends; the right end is wider."""
    classes = np.full(GEOMETRY.shape, UNKNOWN, np.int8)
    classes[10:50, 20:100] = FREE
    classes[[9, 50], 10:100] = classes[9:51, 9] = OCCUPIED
    classes[10:50, 60] = OCCUPIED
    classes[27:34, 60] = FREE
    return classes


def test_map_tells_the_rooms_and_shares_of_frontiers():
    left, right = at(2.0, 3.0), at(9.9, 3.0)
    grid = OccupancyGrid(GEOMETRY)
    grid.merge_patch(0, 0, two_rooms(), 1)
    look = MapSurvey(grid, [left.place, right.place])
    assert look.frontier_rooms[0] == look.room_of(Point2D(4.0, 2.0)) != look.frontier_rooms[1]
    assert look.room_of(Point2D(-3.0, 2.0)) < 0
    # The door belongs to one of the rooms, of 16.0 and 15.6 m².
    assert look.room_m2 == pytest.approx((16.0**2 + 15.67**2) / (16.0 + 15.67), abs=0.05)
    assert look.shares_m2[0] == pytest.approx(4.0)
    assert look.shares_m2[1] > 8.0


def test_explorer_gives_its_strategy_the_map():
    class Floor:
        grid = OccupancyGrid(GEOMETRY)
        version = 1

    Floor.grid.merge_patch(0, 0, two_rooms(), 1)
    seen = []

    def spy(situation):
        seen.append(situation)
        return strategy_of(ROOMS, lambda name, why: pytest.fail(f"{name}: {why}"))(situation)

    explorer = Explorer(Floor, spy)
    chosen = explorer.choose([Scout("r1", Point2D(5.0, 3.0), 0.2), Scout("r2", Point2D(5.0, 2.0), 0.2)], [], 0)
    assert len({choice.place for choice in chosen}) == 2
    assert seen[0].floor is not None
    assert len(seen[0].floor.shares_m2) == len(seen[0].candidates)
