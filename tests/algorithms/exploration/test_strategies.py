"""Exploration strategies: chosen by name, also those of other distributions, which are checked."""

import math
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robrain.algorithms.exploration.situation import KEEP_M, Busy, Choice, FrontierCandidate, Seeker, Situation
from robrain.algorithms.exploration.strategies import (
    AUTO,
    BURGARD,
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
from robrain.algorithms.exploration.tours import auto, rooms, tours
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.model.geometry import Point2D
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


def test_burgard_lowers_the_utility_near_the_goals_of_busy_robots() -> None:
    ends = [A, FrontierCandidate(Point2D(-3.0, 0.0), 1.0)]
    assert goals(burgard(on_a_line(ends, [R1]))) == {"r1": A.place}
    beside = Busy(Point2D(9.0, 0.0), Point2D(1.5, 0.0))
    assert goals(burgard(on_a_line(ends, [R1], [beside]))) == {"r1": ends[1].place}


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


def test_the_goal_that_a_robot_has_counts_as_nearer() -> None:
    bound = Seeker("r1", Point2D(0.0, 0.0), goal=Point2D(5.3, 0.0))
    situation = on_a_line([A, B, C], [bound])
    assert situation.paths_m.tolist() == [[1.0, 5.0 - KEEP_M, 9.0]]
    assert situation.column_of(Point2D(7.0, 0.0)) is None
    assert on_a_line([], [bound]).column_of(Point2D(5.0, 0.0)) is None


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


@pytest.mark.slow
def test_a_team_explores_a_floor_by_the_nearest_frontier() -> None:
    scenario = Scenario.builtin("arena_small").replace(seed=3, robots=2, planning=PlanningPolicy(exploration=NEAREST))
    run = scenario.run()
    assert run.explored_fraction > 0.9
