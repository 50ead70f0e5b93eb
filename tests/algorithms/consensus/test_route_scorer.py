"""What tasks are worth on a robot's route: energy, chargers, deadlines; against counting every order."""

import math
import random
from itertools import permutations

from hypothesis import given, settings
from hypothesis import strategies as st

from robrain.algorithms.consensus.route_scorer import DriveCost, RouteScorer, RouteStop


def route_scorer(seed: int, tasks: int, usable_j: float = math.inf, latest_s: float = math.inf) -> RouteScorer:
    rng = random.Random(seed)
    places = [(rng.random() * 10, rng.random() * 10) for _ in range(tasks + 2)]
    costs = [[math.dist(one, other) for other in places] for one in places]
    stops = {
        f"t{index}": RouteStop(index, 20.0, service_s=1.0, service_j=0.5, latest_s=latest_s) for index in range(tasks)
    }
    return RouteScorer(DriveCost(costs, costs, tasks, (tasks, tasks + 1), usable_j), stops)


@given(st.integers(0, 10_000))
@settings(max_examples=50, deadline=None)
def test_gain_of_an_insertion_is_the_difference_of_the_routes(seed: int) -> None:
    scorer, path = route_scorer(seed, 6), ["t0", "t1", "t2", "t3"]
    found = scorer.insertion(path, "t5")
    assert found is not None
    longer = [*path[: found.position], "t5", *path[found.position :]]
    assert math.isclose(scorer.value(longer) - scorer.value(path), found.gain, abs_tol=1e-9)
    others = [scorer.value([*path[:at], "t5", *path[at:]]) for at in range(5)]
    assert math.isclose(max(others), scorer.value(longer), abs_tol=1e-9)


@given(st.integers(0, 10_000))
@settings(max_examples=50, deadline=None)
def test_no_move_and_no_reversal_shortens_an_ordered_path(seed: int) -> None:
    scorer, given_path = route_scorer(seed, 6), [f"t{index}" for index in range(6)]
    path = scorer.ordered(given_path)
    cost_j = scorer.cost_j(path)
    assert sorted(path) == given_path
    assert cost_j <= scorer.cost_j(given_path)
    for first, last in permutations(range(6), 2):
        rest = path[:first] + path[first + 1 :]
        assert scorer.cost_j([*rest[:last], path[first], *rest[last:]]) >= cost_j - 1e-6
        if first < last:
            turned = path[:first] + path[first : last + 1][::-1] + path[last + 1 :]
            assert scorer.cost_j(turned) >= cost_j - 1e-6


@given(st.integers(0, 10_000), st.floats(5.0, 40.0))
@settings(max_examples=50, deadline=None)
def test_a_route_that_does_not_reach_a_charger_is_never_made(seed: int, usable_j: float) -> None:
    scorer, path = route_scorer(seed, 5, usable_j), []
    for task in ("t0", "t1", "t2", "t3", "t4"):
        found = scorer.insertion(path, task)
        if found is not None:
            path.insert(found.position, task)
    assert scorer.cost_j(path) <= usable_j + 1e-6


def test_a_task_that_would_be_late_cannot_be_inserted() -> None:
    scorer = route_scorer(3, 4, latest_s=0.5)
    assert scorer.insertion([], "t0") is None


def test_a_task_that_the_robot_is_not_able_to_do_has_no_score() -> None:
    assert route_scorer(1, 2).insertion([], "elsewhere") is None
