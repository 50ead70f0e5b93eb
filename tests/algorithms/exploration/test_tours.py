"""Tours through the frontiers: each robot one, everything that can be reached in one of them, much floor early."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.exploration.situation import (
    FIELD_KEPT_NS,
    Busy,
    FrontierCandidate,
    FrontierFields,
    FrontierPaths,
    Seeker,
    Situation,
)
from robrain.algorithms.exploration.strategies import joint
from robrain.algorithms.exploration.tours import CONSIDERED, FAR_M, LEAST_SAVING, Places, auto, plan_tours, tours
from robrain.algorithms.navigation.navigation_grid import NavigationGrid
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, GridGeometry


def straight(candidates, seekers, busy=()):
    """A situation on open floor: all ways are straight."""
    return Situation(
        candidates, seekers, busy, lambda place: np.array([place.distance_m(one.place) for one in candidates])
    )


def candidate(x_m, y_m=0.0, unknown_m2=4.0):
    return FrontierCandidate(Point2D(x_m, y_m), 1.0, unknown_m2)


def seeker(name, x_m=0.0, y_m=0.0, *avoided, goal=None):
    return Seeker(name, Point2D(x_m, y_m), tuple(avoided), goal)


def goals(choices):
    return {choice.robot: choice.place for choice in choices}


def test_robot_looks_into_the_small_place_on_its_way_to_the_large_one():
    small, large = candidate(2.0, unknown_m2=4.0), candidate(10.0, unknown_m2=12.0)
    assert goals(tours(straight([small, large], [seeker("r1")]))) == {"r1": small.place}


def test_robot_leaves_a_small_place_for_later_when_the_large_one_is_as_near_the_other_way():
    small, large = candidate(-2.0, unknown_m2=0.5), candidate(2.5, unknown_m2=12.0)
    assert goals(tours(straight([small, large], [seeker("r1")]))) == {"r1": large.place}


def test_two_robots_at_one_spot_share_out_two_branches():
    left = [candidate(-4.0), candidate(-6.0), candidate(-8.0)]
    right = [candidate(4.0), candidate(6.0), candidate(8.0)]
    made = goals(tours(straight([*left, *right], [seeker("r1"), seeker("r2")])))
    assert sorted(place.x_m for place in made.values()) == [-4.0, 4.0]


def test_frontier_beside_the_goal_of_a_busy_robot_waits():
    near, far = candidate(3.0), candidate(-5.0)
    assert goals(tours(straight([near, far], [seeker("r1")]))) == {"r1": near.place}
    busy = Busy(Point2D(2.0, 0.0), Point2D(3.0, 0.2))
    assert goals(tours(straight([near, far], [seeker("r1")], [busy]))) == {"r1": far.place}


def test_robot_keeps_its_goal_for_a_small_difference_and_leaves_it_for_a_large_one():
    kept = candidate(5.0)
    for other_m, chosen in ((-4.0, kept.place), (-1.0, Point2D(-1.0, 0.0))):
        made = tours(straight([kept, candidate(other_m)], [seeker("r1", goal=kept.place)]))
        assert goals(made) == {"r1": chosen}


def test_robot_is_sent_nowhere_it_avoids_and_nowhere_without_a_way():
    one, other = candidate(1.0), candidate(-6.0)
    assert goals(tours(straight([one, other], [seeker("r1", 0.0, 0.0, one.place)]))) == {"r1": other.place}
    none = Situation([one], [seeker("r1")], [], lambda _: np.array([math.inf]))
    assert tours(none) == []
    assert tours(straight([], [seeker("r1")])) == []
    assert tours(straight([one], [])) == []


def test_of_very_many_frontiers_those_that_promise_most_for_their_distance_are_shared_out():
    many = [candidate(3.0 + 0.1 * index, 30.0, unknown_m2=0.1) for index in range(2 * CONSIDERED)]
    best = candidate(2.0, unknown_m2=10.0)
    assert goals(tours(straight([*many, best], [seeker("r1")]))) == {"r1": best.place}


# -- the tours themselves ---------------------------------------------------------------------------------------


@st.composite
def problems(draw):
    robots, places = draw(st.integers(1, 3)), draw(st.integers(1, 7))
    coordinate = st.integers(0, 20)
    at = np.array([[draw(coordinate), draw(coordinate)] for _ in range(robots + places)], np.float64)
    paths_m = np.hypot(*(at[:, None, :] - at[None, :, :]).transpose(2, 0, 1))
    first_m = paths_m[:robots, robots:].copy()
    for robot in range(robots):
        for place in range(places):
            if draw(st.integers(0, 5)) == 0:
                first_m[robot, place] = math.inf
    weights, stays_m = np.array([[draw(st.integers(1, 12)) for _ in range(places)] for _ in range(2)], np.float64)
    return first_m, paths_m[robots:, robots:], weights, stays_m


def cost(problem, robot, tour):
    first_m, between_m, weights, stays_m = problem
    path_m = total = 0.0
    for index, place in enumerate(tour):
        path_m += first_m[robot, place] if index == 0 else between_m[tour[index - 1], place]
        total += weights[place] * path_m * FAR_M / (path_m + FAR_M)
        path_m += stays_m[place]
    return total


@pytest.mark.slow
@settings(deadline=None, max_examples=200)
@given(problems())
def test_every_place_that_can_be_reached_is_in_one_tour_of_a_robot_that_reaches_it(problem):
    first_m = problem[0]
    made = plan_tours(Places(*problem, FAR_M))
    assert sorted(place for tour in made for place in tour) == np.nonzero(np.isfinite(first_m).any(axis=0))[0].tolist()
    assert all(math.isfinite(first_m[robot, place]) for robot, tour in enumerate(made) for place in tour)


@settings(deadline=None, max_examples=100)
@given(problems())
def test_no_move_of_one_place_and_no_reversal_makes_tours_cheaper(problem):
    first_m = problem[0]
    made = plan_tours(Places(*problem, FAR_M))
    now = sum(cost(problem, robot, tour) for robot, tour in enumerate(made))
    others = []
    for robot, tour in enumerate(made):
        for index, place in enumerate(tour):
            rest = [
                [*tour[:index], *tour[index + 1 :]] if one == robot else list(made[one]) for one in range(len(made))
            ]
            for to in range(len(made)):
                for position in range(len(rest[to]) + 1) if math.isfinite(first_m[to, place]) else ():
                    moved = [list(one) for one in rest]
                    moved[to].insert(position, place)
                    others.append(moved)
            for end in range(index + 1, len(tour)):
                turned = [list(one) for one in made]
                turned[robot][index : end + 1] = turned[robot][index : end + 1][::-1]
                others.append(turned)
    for other in others:
        assert sum(cost(problem, robot, tour) for robot, tour in enumerate(other)) > now - 2 * LEAST_SAVING


# -- costs between frontiers ------------------------------------------------------------------------------------


def test_costs_between_frontiers_are_kept_for_some_seconds_and_those_from_new_ones_are_right_at_once():
    geometry = GridGeometry(0.1, 0.0, 0.0, 100, 60)
    classes = np.full(geometry.shape, FREE, np.int8)
    navigation, fields = NavigationGrid(classes, geometry, 0.28), FrontierFields()
    candidates = [candidate(1.0, 3.0), candidate(9.0, 3.0), candidate(8.0, 3.0)]

    def costs_m(start, end, now_ns):
        paths = FrontierPaths(navigation, candidates)
        return fields.costs_between(paths, navigation, now_ns)(candidates[start].place)[end]

    open_m = costs_m(0, 1, 0)
    assert open_m == pytest.approx(8.0, abs=0.3)
    walled = classes.copy()
    walled[10:, 48:52] = OCCUPIED
    navigation.update(walled)
    assert costs_m(0, 1, FIELD_KEPT_NS) == open_m
    assert costs_m(2, 0, FIELD_KEPT_NS) > 9.0
    assert costs_m(0, 1, FIELD_KEPT_NS + 1) > 9.0


def test_between_two_frontiers_the_less_of_both_directions_counts():
    candidates = [candidate(0.0), candidate(3.0)]
    rows = {candidates[0].place: [0.0, 3.0], candidates[1].place: [5.0, 0.0]}
    situation = Situation(
        candidates, [], [], lambda _: np.full(2, 9.0), costs_between=lambda place: np.array(rows[place])
    )
    assert situation.between([0, 1]).tolist() == situation.between_m.tolist() == [[0.0, 3.0], [3.0, 0.0]]
    assert situation.between([1]).tolist() == [[0.0]]


# -- the default ------------------------------------------------------------------------------------------------


def test_up_to_four_robots_are_sent_on_tours_and_more_jointly_whoever_is_busy():
    near, rich = candidate(2.0, unknown_m2=3.5), candidate(8.0, unknown_m2=12.0)
    alone = straight([near, rich], [seeker("r1")])
    assert goals(tours(alone)) != goals(joint(alone))
    assert auto(alone) == tours(alone)
    for others in (3, 4):
        busy = [Busy(Point2D(0.0, 40.0), Point2D(0.0, 50.0 + index)) for index in range(others)]
        situation = straight([candidate(2.0, unknown_m2=4.2), rich], [seeker("r1")], busy)
        assert goals(tours(situation)) != goals(joint(situation))
        assert auto(situation) == (tours if others == 3 else joint)(situation)


def test_a_frontier_takes_a_robot_of_a_team_longer_than_one_that_is_alone():
    poor, rich = candidate(-1.0, unknown_m2=2.0), candidate(12.0, unknown_m2=9.0)
    assert goals(tours(straight([poor, rich], [seeker("r1")]))) == {"r1": poor.place}
    far_away = Busy(Point2D(0.0, 40.0), Point2D(0.0, 50.0))
    assert goals(tours(straight([poor, rich], [seeker("r1")], [far_away]))) == {"r1": rich.place}
