"""Exploration strategies: chosen by name, also those of other distributions, which are checked."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robrain.coordinator.exploration.assignment import Candidate, Choice, Seeker, assign, nearest_frontier

from robrain.coordinator.exploration.strategies import ASSIGNMENT, NEAREST_FRONTIER, STRATEGIES, strategy_of
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.model.geometry import Point2D
from robrain.protocol.registry import UnknownEntry
from robrain.sim.scenarios.scenario import Scenario
from tests.installed_distributions import install

__all__ = ["install"]

A, B, C = (Candidate(Point2D(float(x_m), 0.0), 1.0, 1.0) for x_m in (1, 5, 9))
R1, R2 = Seeker("r1", Point2D(0.0, 0.0)), Seeker("r2", Point2D(2.0, 0.0))
WAYS_M = np.array([[1.0, 5.0, 9.0], [1.0, 3.0, math.inf]])

GREEDY = """
from robrain.coordinator.exploration.assignment import Choice

def last(ways_m, candidates, seekers, taken, *, is_narrow=False):
    return [Choice(seekers[0].name, candidates[-1].place, 0.0)] if candidates else []

def fails(*_arguments, **_options):
    return 1 / 0
"""


def goals(choices) -> dict[str, Point2D]:
    return {choice.robot: choice.place for choice in choices}


def test_the_nearest_frontier_goes_to_the_first_robot_that_it_is_nearest_to() -> None:
    made = nearest_frontier(WAYS_M, [A, B, C], [R1, R2], [])
    assert goals(made) == {"r1": A.place, "r2": B.place}
    assert [choice.way_m for choice in made] == [1.0, 3.0]


def test_the_nearest_frontier_is_none_that_is_taken_or_shunned_or_out_of_reach() -> None:
    assert goals(nearest_frontier(WAYS_M, [A, B, C], [R1], [A.place])) == {"r1": B.place}
    shy = R1._replace(avoided=(A.place,))
    assert goals(nearest_frontier(WAYS_M, [A, B, C], [shy], [])) == {"r1": B.place}
    assert nearest_frontier(np.full((1, 3), math.inf), [A, B, C], [R1], []) == []


@given(st.lists(st.lists(st.sampled_from([0.5, 1.0, 2.0, math.inf]), min_size=3, max_size=3), min_size=1, max_size=4))
def test_no_stock_strategy_gives_two_robots_a_frontier_or_one_without_a_path(ways: list[list[float]]) -> None:
    seekers = [Seeker(f"r{row}", Point2D(0.0, float(row))) for row in range(len(ways))]
    for strategy in (assign, nearest_frontier):
        made = strategy(np.array(ways), [A, B, C], seekers, [])
        assert len({choice.place for choice in made}) == len({choice.robot for choice in made}) == len(made)
        assert all(math.isfinite(choice.way_m) for choice in made)


def test_the_stock_strategies_are_registered() -> None:
    assert STRATEGIES.get(ASSIGNMENT) is assign
    assert STRATEGIES.get(NEAREST_FRONTIER) is nearest_frontier


def test_an_unknown_strategy_is_refused_with_those_that_there_are() -> None:
    with pytest.raises(ValueError, match=r"expected exploration to be one of assignment, nearest_frontier; got nearst"):
        PlanningPolicy(exploration="nearst")
    with pytest.raises(UnknownEntry):
        strategy_of("nearst", lambda _name, _why: None)


def test_a_strategy_of_another_distribution_is_used(install) -> None:
    install("greedy", {"last": "greedy:last"}, {"greedy.py": GREEDY}, group="robrain.exploration_strategies")
    STRATEGIES.__init__(STRATEGIES.what, STRATEGIES.group, _stock())  # type: ignore[misc]
    try:
        told: list[tuple[str, str]] = []
        strategy = strategy_of("last", lambda name, why: told.append((name, why)))
        assert goals(strategy(WAYS_M, [A, B, C], [R1, R2], [])) == {"r1": C.place}
        assert told == []
        assert PlanningPolicy(exploration="last").exploration == "last"
    finally:
        STRATEGIES.__init__(STRATEGIES.what, STRATEGIES.group, _stock())  # type: ignore[misc]


def _stock() -> dict[str, str]:
    home = "robrain.coordinator.exploration.assignment"
    return {ASSIGNMENT: f"{home}:assign", NEAREST_FRONTIER: f"{home}:nearest_frontier"}


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
        (["r1"], "expected choices, got str"),
        (None, "TypeError"),
    ],
)
def test_what_a_foreign_strategy_may_not_choose_is_told_and_the_stock_one_stands_in(monkeypatch, made, said) -> None:
    monkeypatch.setitem(STRATEGIES._loaded, "odd", lambda *_arguments, **_options: made)
    told: list[str] = []
    strategy = strategy_of("odd", lambda _name, why: told.append(why))
    assert strategy(WAYS_M, [A, B, C], [R1, R2], []) == assign(WAYS_M, [A, B, C], [R1, R2], [])
    assert len(told) == 1
    assert said in told[0]


def test_a_team_explores_a_floor_by_the_nearest_frontier() -> None:
    scenario = Scenario.builtin("arena_small").replace(
        seed=3, robots=2, planning=PlanningPolicy(exploration=NEAREST_FRONTIER)
    )
    run = scenario.run()
    assert run.explored_fraction > 0.9
