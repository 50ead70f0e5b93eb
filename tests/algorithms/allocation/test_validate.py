"""The checker is tested by plans that are wrong in one way each."""

import math

import msgspec
import numpy as np
import pytest

from robrain.algorithms.allocation.plan import make_plan
from robrain.algorithms.allocation.problem import Job, Objective, Problem, Worker
from robrain.algorithms.allocation.validate import validate

WAYS = np.abs(np.subtract.outer(np.arange(6.0), np.arange(6.0)))
"""Six places in a row, 1 J and 1 s from one to the next."""


def job(name, place, **more):
    return Job(id=name, place=place, prize_j=10.0, **more)


def worker(name, start=0, usable_j=10.0, **more):
    return Worker(name=name, start=start, ends=(0,), usable_j=usable_j, **more)


def line(jobs, workers, **more):
    return Problem(jobs=tuple(jobs), workers=tuple(workers), energy_j=WAYS[None], time_s=WAYS[None], **more)


PAIR = [job("get", 1, load_kg=2.0), job("put", 2, load_kg=-2.0, after=("get",), same_worker_as="get")]
UNLOADED = [job("get", 1), job("put", 2, after=("get",), same_worker_as="get")]
MORE = [job("get2", 1, load_kg=2.0), job("put2", 2, load_kg=-2.0, after=("get2",), same_worker_as="get2")]


def faults(problem, *orders):
    plan = make_plan(problem, orders, Objective.ENERGY)
    assert plan is not None
    return validate(problem, plan)


def test_plan_with_nothing_wrong_has_no_faults():
    problem = line([job("a", 2), job("b", 1, after=("a",))], [worker("r1"), worker("r2")])
    assert faults(problem, ["a"], ["b"]) == []


@pytest.mark.parametrize(
    ("problem", "orders", "fault"),
    [
        # The way to the charger counts.
        (line([job("a", 3)], [worker("r1", usable_j=5.9)]), [["a"]], "lacks 0.100 J"),
        (line([job("a", 3, service_j=1.0)], [worker("r1", usable_j=6.9)]), [["a"]], "lacks 0.100 J"),
        # So does waiting.
        (line([job("a", 1, earliest_s=5.0)], [worker("r1", wait_w=1.0, usable_j=5.0)]), [["a"]], "lacks 1.000 J"),
        (line([job("a", 1, load_kg=3.0)], [worker("r1", capacity_kg=2.0)]), [["a"]], "carries 3 kg after a, of 2 kg"),
        (line([job("a", 1, load_kg=-1.0)], [worker("r1")]), [["a"]], "carries -1 kg after a"),
        (line([job("a", 1, load_kg=1.0)], [worker("r1", capacity_kg=2.0, load_kg=1.5)]), [["a"]], "carries 2.5 kg"),
        (
            line(UNLOADED, [worker("r1"), worker("r2")]),
            [["get"], ["put"]],
            "put and get are not done by the same robot",
        ),
        (line(PAIR, [worker("r1")]), [["get"]], "put and get are not done by the same robot"),
        (line([*PAIR, *MORE], [worker("r1", capacity_kg=3.0)]), [["get", "get2", "put", "put2"]], "carries 4 kg"),
        # The way to the charger begins where the job ends.
        (line([job("a", 1, end_place=4)], [worker("r1", usable_j=4.9)]), [["a"]], "lacks 0.100 J"),
        (line([job("a", 1, end_place=4), job("b", 5, latest_s=1.9)], [worker("r1")]), [["a", "b"]], "ends at 2.000 s"),
        (line([job("a", 3, latest_s=2.9)], [worker("r1")]), [["a"]], "ends at 3.000 s, after 2.900 s"),
        (line([job("a", 3, service_s=1.0, latest_s=3.9)], [worker("r1")]), [["a"]], "after 3.900 s"),
        (line([job("a", 3)], [worker("r1")], horizon_s=5.9), [["a"]], "at its charger at 6.000 s"),
        (line([job("a", 3, needs=frozenset({"camera"}))], [worker("r1")]), [["a"]], "lacks camera"),
        (line([job("a", 3, forbidden_workers=frozenset({"r1"}))], [worker("r1")]), [["a"]], "r1 is not to be given a"),
        (line([job("a", 1), job("b", 1, after=("a",))], [worker("r1")]), [["b"]], "comes after a, which nobody does"),
        (line([job("a", 1, robots=2)], [worker("r1"), worker("r2")]), [["a"], []], "asks for 2 robots"),
        (line([job("a", 1)], [worker("r1"), worker("r2")]), [["a"], ["a"]], "asks for 1 robots"),
        (line([job("a", 1), job("b", 1, pinned_to="r1")], [worker("r1")]), [["a", "b"]], "as number 2"),
        (line([job("b", 1, pinned_to="r1")], [worker("r1"), worker("r2")]), [[], ["b"]], "while r1 is at it"),
    ],
)
def test_each_broken_limit_is_named(problem, orders, fault):
    assert any(fault in one for one in faults(problem, *orders)), faults(problem, *orders)


def test_figures_that_are_not_so_are_faults():
    problem = line([job("a", 2), job("b", 3)], [worker("r1")])
    plan = make_plan(problem, [["a"]], Objective.ENERGY)
    for change in (
        {"cost_j": 3.0},
        {"lost_prize_j": 0.0},
        {"makespan_s": 3.0},
        {"least_left_j": 7.0},
        {"unassigned": ()},
    ):
        assert validate(problem, msgspec.structs.replace(plan, **change)), change
    (route,) = plan.routes
    for change in ({"left_j": route.left_j + 1.0}, {"end_s": route.end_s + 1.0}):
        changed = msgspec.structs.replace(plan, routes=(msgspec.structs.replace(route, **change),))
        assert any("which its route says otherwise" in fault for fault in validate(problem, changed)), change


def test_loads_and_pairs_that_fit_have_no_faults():
    assert faults(line([*PAIR, *MORE], [worker("r1", capacity_kg=4.0)]), ["get", "get2", "put", "put2"]) == []
    assert faults(line([*PAIR, *MORE], [worker("r1", capacity_kg=2.0)]), ["get", "put", "get2", "put2"]) == []
    # What a robot has in its gripper already must go with it, and may be left for a later plan.
    pinned = msgspec.structs.replace(PAIR[0], pinned_to="r1")
    assert faults(line([pinned, PAIR[1]], [worker("r1"), worker("r2")]), ["get"], []) == []
    assert faults(line([pinned, PAIR[1]], [worker("r1"), worker("r2")]), ["get"], ["put"]) != []


def test_orders_that_wait_for_each_other_make_no_plan():
    problem = line([job("a", 1), job("b", 2, after=("a",)), job("c", 3)], [worker("r1")])
    assert make_plan(problem, [["b", "a"]], Objective.ENERGY) is None


def test_robots_of_a_team_job_start_at_once():
    problem = line([job("a", 2, robots=2)], [worker("r1"), worker("r2", start=5)])
    plan = make_plan(problem, [["a"], ["a"]], Objective.ENERGY)
    assert [route.stops[0].start_s for route in plan.routes] == [3.0, 3.0]
    assert [route.stops[0].arrive_s for route in plan.routes] == [2.0, 3.0]
    assert validate(problem, plan) == []


def test_robots_of_a_team_job_that_do_not_start_at_once_are_a_fault():
    robots = [worker("r1"), worker("r2", start=5)]
    problem = line([job("a", 2, robots=2)], robots)
    plan = make_plan(problem, [["a"], ["a"]], Objective.ENERGY)
    # Each does it as if alone: r1 is there a second before r2.
    single = line([job("a", 2)], robots)
    first, second = (make_plan(single, orders, Objective.ENERGY) for orders in ([["a"], []], [[], ["a"]]))
    apart = msgspec.structs.replace(plan, routes=(first.routes[0], second.routes[1]))
    assert validate(problem, apart) == ["the robots of a do not start it at once"]


@pytest.mark.parametrize(
    ("build", "said"),
    [
        (lambda: job("a", 1, service_s=-1.0), "service_s"),
        (lambda: job("a", 1, earliest_s=math.inf), "earliest_s"),
        (lambda: job("a", 1, robots=0), "robots"),
        (lambda: job("a", 1, robots=2, pinned_to="r1"), "one robot"),
        (lambda: Worker(name="r", start=0, ends=(), usable_j=1.0), "at least one place"),
        (lambda: job("a", 1, load_kg=math.nan), "load_kg"),
        (lambda: job("a", 1, load_kg=1.0, robots=2), "expected one robot"),
        (lambda: job("a", 1, same_worker_as="b"), "expected b in `after`"),
        (lambda: line([*PAIR, msgspec.structs.replace(PAIR[1], id="third")], []), "one pair"),
        (lambda: worker("r", load_kg=3.0, capacity_kg=2.0), "load_kg"),
        (lambda: worker("r", capacity_kg=math.nan), "load_kg"),
        (lambda: worker("r", usable_j=math.nan), "usable_j"),
        (lambda: line([job("a", 6)], []), "place from 0 to 5"),
        (lambda: line([job("a", 1, end_place=6)], []), "place from 0 to 5"),
        (lambda: line([job("a", 1), job("a", 2)], []), "once"),
        (lambda: line([], [worker("r", profile=1)]), "profile"),
        (lambda: line([job("a", 1, pinned_to="r9")], [worker("r1")]), "pinned_to"),
        (lambda: line([job("a", 1), job("b", 1, after=("a",), pinned_to="r")], [worker("r")]), "nothing may have"),
        (lambda: Problem(jobs=(), workers=(), energy_j=WAYS, time_s=WAYS), "shape"),
        (lambda: Problem(jobs=(), workers=(), energy_j=-WAYS[None], time_s=WAYS[None]), "below 0"),
    ],
)
def test_nonsense_is_refused_with_its_field(build, said):
    with pytest.raises(ValueError, match=said):
        build()


@pytest.mark.parametrize("field", ["arrive_s", "start_s", "end_s", "left_j"])
def test_a_number_that_is_none_is_a_fault(field):
    problem = line([job("a", 2)], [worker("r1")])
    plan = make_plan(problem, [["a"]], Objective.ENERGY)
    route = plan.routes[0]
    stop = msgspec.structs.replace(route.stops[0], **{field: math.nan})
    routes = (msgspec.structs.replace(route, stops=(stop,)), *plan.routes[1:])
    assert validate(problem, msgspec.structs.replace(plan, routes=routes)) != []
