"""Exploration strategies: by name, also those of other distributions; the joint one, tours, and rooms."""

import math
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.exploration.map_survey import MapSurvey
from robrain.algorithms.exploration.situation import Busy, Choice, FrontierCandidate, FrontierPaths, Seeker, Situation
from robrain.algorithms.exploration.strategies import (
    AUTO,
    BURGARD,
    CROWD_PENALTY_M,
    CROWD_RADIUS_M,
    GAIN_M_PER_M2,
    JOINT,
    MINPOS,
    NEAREST,
    ROOMS,
    STRATEGIES,
    TOURS,
    burgard,
    joint,
    minpos,
    nearest,
    strategy_of,
)
from robrain.algorithms.exploration.tours import (
    DOOR_M,
    FAR_M,
    MEET_M,
    Places,
    auto,
    meetings_m,
    plan_tours,
    rooms,
    tours,
)
from robrain.algorithms.mapping.occupancy_grid import OccupancyGrid
from robrain.algorithms.navigation.navigation_grid import NavigationGrid
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.model.grid_geometry import FREE, OCCUPIED, UNKNOWN, GridGeometry
from robrain.protocol.registry import UnknownEntry
from robrain.sim.scenarios.scenario import Scenario
from tests.installed_distributions import install

__all__ = ["install"]

A, B, C = (FrontierCandidate(Point2D(float(x_m), 0.0), 1.0, 1.0) for x_m in (1, 5, 9))
R1, R2 = Seeker("r1", Point2D(0.0, 0.0)), Seeker("r2", Point2D(2.0, 0.0))
PATHS_M = np.array([[1.0, 5.0, 9.0], [1.0, 3.0, math.inf]])
STOCK = {AUTO: auto, NEAREST: nearest, MINPOS: minpos, BURGARD: burgard, JOINT: joint, TOURS: tours, ROOMS: rooms}


def on_a_line(candidates, seekers, busy=(), paths_m=None) -> Situation:
    """Paths are along x, unless (robots, frontiers) path costs are given."""
    xs_m = np.array([candidate.place.x_m for candidate in candidates])
    rows = {} if paths_m is None else {seeker.place: row for seeker, row in zip(seekers, paths_m, strict=True)}
    return Situation(candidates, seekers, busy, lambda place: rows.get(place, np.abs(xs_m - place.x_m)))


def goals(choices) -> dict[str, Point2D]:
    return {choice.robot: choice.place for choice in choices}


def test_the_nearest_frontier_goes_to_the_first_robot_that_it_is_nearest_to() -> None:
    made = nearest(on_a_line([A, B, C], [R1, R2], paths_m=PATHS_M))
    assert goals(made) == {"r1": A.place, "r2": B.place}
    assert [choice.cost_m for choice in made] == [1.0, 3.0]


def test_the_nearest_frontier_is_none_that_is_taken_or_shunned_or_out_of_reach() -> None:
    assert goals(nearest(on_a_line([A, B, C], [R1], [Busy(A.place, A.place)]))) == {"r1": B.place}
    shy = R1._replace(avoided=(A.place,))
    assert goals(nearest(on_a_line([A, B, C], [shy]))) == {"r1": B.place}
    assert nearest(on_a_line([A, B, C], [R1], paths_m=np.full((1, 3), math.inf))) == []


def test_minpos_sends_a_robot_where_fewer_are_nearer_though_it_is_farther() -> None:
    ahead, behind = Seeker("r1", Point2D(4.0, 0.0)), Seeker("r2", Point2D(3.0, 0.0))
    ends = [A, B, C]
    assert goals(minpos(on_a_line(ends, [ahead, behind]))) == {"r1": B.place, "r2": A.place}
    # To the robot behind alone, the goal ahead is as near; a busy robot there counts as well.
    assert goals(minpos(on_a_line([A, B], [behind]))) == {"r2": A.place}
    assert goals(minpos(on_a_line([A, B], [behind], [Busy(Point2D(2.0, 0.0), C.place)]))) == {"r2": B.place}


def test_burgard_sends_the_second_robot_away_from_the_goal_of_the_first() -> None:
    near, far = FrontierCandidate(Point2D(2.0, 0.0), 1.0), FrontierCandidate(Point2D(-4.0, 0.0), 1.0)
    ends = [FrontierCandidate(Point2D(1.5, 0.0), 1.0), near, far]
    made = burgard(on_a_line(ends, [R1, Seeker("r2", Point2D(0.1, 0.0))]))
    assert set(goals(made).values()) == {ends[0].place, far.place}


@given(
    st.lists(st.lists(st.sampled_from([0.5, 1.0, 2.0, math.inf]), min_size=3, max_size=3), min_size=1, max_size=4),
    st.sampled_from(sorted(STOCK)),
)
def test_no_stock_strategy_gives_two_robots_a_frontier_or_one_without_a_path(
    ways: list[list[float]], name: str
) -> None:
    seekers = [Seeker(f"r{row}", Point2D(0.0, float(row))) for row in range(len(ways))]
    made = STOCK[name](on_a_line([A, B, C], seekers, paths_m=np.array(ways)))
    assert len({choice.place for choice in made}) == len({choice.robot for choice in made}) == len(made)
    assert all(math.isfinite(choice.cost_m) for choice in made)


@pytest.mark.parametrize("name", sorted(STOCK))
def test_a_stock_strategy_chooses_nothing_without_frontiers_or_robots(name: str) -> None:
    assert STOCK[name](on_a_line([], [R1])) == []
    assert STOCK[name](on_a_line([A], [])) == []


def test_an_unknown_strategy_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(ValueError, match=r"auto, .*, tours, or FILE.py:NAME; got nearst; did you mean nearest"):
        PlanningPolicy(exploration="nearst")
    with pytest.raises(UnknownEntry):
        strategy_of("nearst", lambda _name, _reason: None)


def test_names_of_earlier_versions_are_still_read() -> None:
    assert PlanningPolicy(exploration="assignment").exploration == JOINT
    assert PlanningPolicy(exploration="nearest_frontier").exploration == NEAREST
    assert msgspec.json.decode('{"exploration": "assignment"}', type=PlanningPolicy) == PlanningPolicy(
        exploration=JOINT
    )


def test_the_strategy_of_the_how_to_sends_robots_where_most_is_unknown(install) -> None:
    page = Path(__file__).parents[3] / "docs" / "how-to" / "extend-planning.md"
    code = re.findall(r"^```python\n(# widest.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)[0]
    install("widest", {"widest": "widest:widest"}, {"widest.py": code}, group="robrain.exploration_strategies")
    STRATEGIES.__init__(STRATEGIES.what, STRATEGIES.group, _stock(), has_files=True)  # type: ignore[misc]
    try:
        told: list[str] = []
        strategy = strategy_of("widest", lambda _name, why: told.append(why))
        ends = [A, B._replace(unknown_m2=9.0), C._replace(unknown_m2=5.0)]
        assert goals(strategy(on_a_line(ends, [R1, R2]))) == {"r1": B.place, "r2": C.place}
        assert told == []
    finally:
        STRATEGIES.__init__(STRATEGIES.what, STRATEGIES.group, _stock(), has_files=True)  # type: ignore[misc]


def _stock() -> dict[str, str]:
    return {name: f"{strategy.__module__}:{name}" for name, strategy in STOCK.items()}


@pytest.mark.parametrize(
    ("made", "said"),
    [
        ([Choice("r3", A.place, 0.0)], "r3 is not idle"),
        ([Choice("r1", A.place, 0.0), Choice("r1", B.place, 0.0)], "r1 is not idle, or is chosen twice"),
        ([Choice("r1", Point2D(7.0, 7.0), 0.0)], "r1 is sent to what is no frontier"),
        (
            [Choice("r1", A.place, 0.0), Choice("r2", A.place, 0.0)],
            "r2 is sent to what is no frontier, or is another's",
        ),
        ([Choice("r2", C.place, 0.0)], "r2 has no path to its frontier"),
        (["r1"], "expected a list of Choice, got one of str"),
        (None, "TypeError"),
    ],
)
def test_what_a_foreign_strategy_may_not_choose_is_told_and_the_stock_one_stands_in(monkeypatch, made, said) -> None:
    monkeypatch.setitem(STRATEGIES._loaded, "odd", lambda _situation: made)
    told: list[str] = []
    strategy = strategy_of("odd", lambda _name, why: told.append(why))
    assert strategy(on_a_line([A, B, C], [R1, R2], paths_m=PATHS_M)) == joint(
        on_a_line([A, B, C], [R1, R2], paths_m=PATHS_M)
    )
    assert len(told) == 1
    assert said in told[0]


GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 100, 60)
NEEDED_M = 0.28


def floor(*walls):
    """Open floor of 10 × 6 m; walls are boxes x0, y0, x1, y1 in metres."""
    classes = np.full(GEOMETRY.shape, FREE, np.int8)
    for box in walls:
        x0, y0, x1, y1 = (round(10 * edge_m) for edge_m in box)
        classes[y0:y1, x0:x1] = OCCUPIED
    return NavigationGrid(classes, GEOMETRY, NEEDED_M)


OPEN = floor()


def candidate(x_m, y_m=0.0, unknown_m2=4.0):
    return FrontierCandidate(Point2D(x_m, y_m), 1.0, unknown_m2)


def seeker(name, x_m=0.0, y_m=0.0, *avoided, goal=None):
    return Seeker(name, Point2D(x_m, y_m), tuple(avoided), goal)


def straight(candidates, seekers, busy=(), floor=None):
    """A situation on open floor: all ways are straight."""
    return Situation(
        candidates,
        seekers,
        busy,
        lambda place: np.array([place.distance_m(one.place) for one in candidates]),
        floor=floor,
    )


def assign_frontiers(navigation, candidates, seekers, taken):
    busy = [Busy(goal, goal) for goal in taken]
    return joint(Situation(candidates, seekers, busy, FrontierPaths(navigation, candidates).costs_m))


def test_the_cost_on_open_floor_is_the_way_less_the_unknown_floor_beyond():
    (choice,) = assign_frontiers(OPEN, [candidate(7.0, 3.0, 1.5)], [seeker("r1", 3.0, 3.0)], [])
    assert choice.cost_m == pytest.approx(4.0 - GAIN_M_PER_M2 * 1.5, abs=0.3)


@given(st.floats(0.0, 8.0))
@settings(max_examples=20, deadline=None)
def test_the_penalty_falls_off_with_the_distance_to_a_taken_goal(away_m):
    end, one = [candidate(1.0, 3.0)], [seeker("r1", 2.0, 3.0)]
    (free,), (crowded,) = (assign_frontiers(OPEN, end, one, taken) for taken in ([], [Point2D(1.0 + away_m, 3.0)]))
    expected_m = CROWD_PENALTY_M * max(0.0, 1.0 - away_m / CROWD_RADIUS_M)
    assert crowded.cost_m - free.cost_m == pytest.approx(expected_m, abs=1e-6)


def test_a_place_where_a_robot_failed_is_not_for_that_robot():
    ends = [candidate(4.0, 3.0)]
    assert assign_frontiers(OPEN, ends, [seeker("r1", 2.0, 3.0, Point2D(4.5, 3.0))], []) == []
    both = [seeker("r1", 2.0, 3.0, Point2D(4.5, 3.0)), seeker("r2", 9.0, 3.0)]
    assert goals(assign_frontiers(OPEN, ends, both, [])) == {"r2": Point2D(4.0, 3.0)}


def test_robot_looks_into_the_small_place_on_its_way_to_the_large_one():
    small, large = candidate(2.0, unknown_m2=4.0), candidate(10.0, unknown_m2=12.0)
    assert goals(tours(straight([small, large], [seeker("r1")]))) == {"r1": small.place}


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


def test_robot_is_sent_nowhere_it_avoids_and_nowhere_without_a_way():
    one, other = candidate(1.0), candidate(-6.0)
    assert goals(tours(straight([one, other], [seeker("r1", 0.0, 0.0, one.place)]))) == {"r1": other.place}
    none = Situation([one], [seeker("r1")], [], lambda _: np.array([math.inf]))
    assert tours(none) == []
    assert tours(straight([], [seeker("r1")])) == []
    assert tours(straight([one], [])) == []


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


@pytest.mark.slow
@settings(deadline=None, max_examples=200)
@given(problems())
def test_every_place_that_can_be_reached_is_in_one_tour_of_a_robot_that_reaches_it(problem):
    first_m = problem[0]
    made = plan_tours(Places(*problem, FAR_M))
    assert sorted(place for tour in made for place in tour) == np.nonzero(np.isfinite(first_m).any(axis=0))[0].tolist()
    assert all(math.isfinite(first_m[robot, place]) for robot, tour in enumerate(made) for place in tour)


ROOMS_GEOMETRY = GridGeometry(0.1, 0.0, 0.0, 120, 60)


class Look:
    """Rooms by x: one to each `room_m`."""

    def __init__(self, candidates, shares_m2, room_m=1000.0, room_m2=20.0):
        self._room_m = room_m
        self.room_m2 = room_m2
        self.shares_m2 = np.array(shares_m2, np.float64)
        self.frontier_rooms = np.array([self.room_of(one.place) for one in candidates])

    def room_of(self, place):
        return int((place.x_m + 500.0) // self._room_m)


def surveyed(candidates, seekers, busy=(), *, shares_m2=None, room_m=1000.0):
    return straight(candidates, seekers, busy, Look(candidates, shares_m2 or [4.0] * len(candidates), room_m))


def xs_m(choices):
    return {choice.robot: choice.place.x_m for choice in choices}


def test_much_unknown_floor_far_away_outweighs_a_little_nearby():
    near, far = candidate(-2.0), candidate(6.0)
    assert xs_m(rooms(surveyed([near, far], [seeker("r1")], shares_m2=[2.0, 2.0]))) == {"r1": -2.0}
    assert xs_m(rooms(surveyed([near, far], [seeker("r1")], shares_m2=[2.0, 40.0]))) == {"r1": 6.0}


def test_robot_in_front_of_much_work_leaves_the_rest_to_the_others():
    """The second goes where the first will have no time for, although that is nearer to the first."""
    large, beyond = candidate(3.0), candidate(5.0)
    made = xs_m(rooms(surveyed([large, beyond], [seeker("r1"), seeker("r2", -6.0)], shares_m2=[40.0, 4.0])))
    assert made == {"r1": 3.0, "r2": 5.0}


def test_robot_finishes_its_room_before_it_takes_something_nearer_outside():
    inside, outside = candidate(2.2), candidate(5.5)
    one = [seeker("r1", 4.0)]
    assert xs_m(rooms(surveyed([inside, outside], one))) == {"r1": 5.5}
    assert xs_m(rooms(surveyed([inside, outside], one, room_m=5.0))) == {"r1": 2.2}
    assert DOOR_M > 0.3


def test_way_against_another_robots_way_costs_more_and_one_behind_it_does_not():
    candidates = [candidate(10.0), candidate(-10.0)]
    towards = surveyed(candidates, [seeker("r1", 0.0), seeker("r2", 5.0, goal=Point2D(-10.0, 0.0))])
    assert meetings_m(towards).tolist() == [[MEET_M, 0.0], [0.0, 0.0]]
    behind = surveyed(candidates, [seeker("r1", 0.0), seeker("r2", 5.0, goal=Point2D(10.0, 0.0))])
    assert meetings_m(behind).tolist() == [[0.0, 0.0], [0.0, 0.0]]


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
    near, far = candidate(-2.0), candidate(6.0)
    busy = [Busy(Point2D(0.0, 90.0 + number), Point2D(0.0, 95.0 + number)) for number in range(robots - 1)]
    situation = surveyed([near, far], [seeker("r1")], busy, shares_m2=[2.0, 40.0])
    situation.floor.room_m2, situation.floor.known_m2 = room_m2, known_m2
    assert xs_m(rooms(situation)) == {"r1": 6.0}
    assert xs_m(tours(situation)) == xs_m(joint(situation)) == {"r1": -2.0}
    assert (auto(situation) == rooms(situation)) is by_rooms


def two_rooms():
    """A corridor of two rooms, known as far as 1 m from the ends; the right end is wider."""
    classes = np.full(ROOMS_GEOMETRY.shape, UNKNOWN, np.int8)
    classes[10:50, 20:100] = FREE
    classes[[9, 50], 10:100] = classes[9:51, 9] = OCCUPIED
    classes[10:50, 60] = OCCUPIED
    classes[27:34, 60] = FREE
    return classes


def test_map_tells_the_rooms_and_shares_of_frontiers():
    left, right = candidate(2.0, 3.0), candidate(9.9, 3.0)
    grid = OccupancyGrid(ROOMS_GEOMETRY)
    grid.merge_patch(0, 0, two_rooms(), 1)
    look = MapSurvey(grid, [left.place, right.place])
    assert look.frontier_rooms[0] == look.room_of(Point2D(4.0, 2.0)) != look.frontier_rooms[1]
    assert look.room_of(Point2D(-3.0, 2.0)) < 0
    # The door belongs to one of the rooms, of 16.0 and 15.6 m².
    assert look.room_m2 == pytest.approx((16.0**2 + 15.67**2) / (16.0 + 15.67), abs=0.05)
    assert look.shares_m2[0] == pytest.approx(4.0)
    assert look.shares_m2[1] > 8.0


@pytest.mark.slow
def test_a_team_explores_a_floor_by_the_nearest_frontier() -> None:
    scenario = Scenario.builtin("arena_small").replace(seed=3, robots=2, planning=PlanningPolicy(exploration=NEAREST))
    run = scenario.run()
    assert run.explored_fraction > 0.9
