"""Charges within routes: where they are made, and what they cost."""

import itertools
import math

import msgspec
import numpy as np
import pytest

from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.plan import make_plan
from robrain.algorithms.allocation.problem import Job, Objective, Problem, Worker
from robrain.algorithms.allocation.validate import validate


def problem(jobs, x_m, *, chargers=(1,), workers=1, usable_j=10.0, charge_w=1.0, horizon_s=math.inf, places=None):
    """Places on a line or in the plane, a joule and a second for each metre; robots start and end at place 0."""
    points = np.array([(x, 0.0) for x in x_m] if places is None else places)
    legs = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))[None]
    team = [
        Worker(
            name=f"r{number}",
            start=0,
            ends=(0,),
            usable_j=usable_j,
            chargers=chargers,
            full_j=10.0,
            charge_w=charge_w,
            capacity_kg=5.0,
        )
        for number in range(workers)
    ]
    return Problem(jobs=tuple(jobs), workers=tuple(team), energy_j=legs, time_s=legs, horizon_s=horizon_s)


def job(name, place, **fields):
    return Job(id=name, place=place, prize_j=1000.0, **fields)


def planned(asked, objective=Objective.ENERGY, iterations=5):
    plan = OptimalAllocator(objective, lambda: 0.0).plan(asked, iterations=iterations)
    assert validate(asked, plan) == []
    return plan


FAR = [job("far", 2)]


def test_robot_charges_on_the_way_there_and_back():
    plan = planned(problem(FAR, [0, 5, 9]))
    charges = [(charge.place, charge.before, charge.gained_j) for charge in plan.routes[0].charges]
    assert charges == [(1, 0, 5), (1, 1, 8)]
    assert (plan.cost_j, plan.makespan_s, plan.routes[0].left_j) == (18.0, 18.0 + 5.0 + 8.0, 5.0)


@pytest.mark.parametrize(
    "changed",
    [
        {"chargers": ()},  # it may not charge on the way
        {"horizon_s": 30.0},  # the charges take too long
        {"charge_w": 0.3},  # too slow for the job's latest end
        {"usable_j": 4.0},  # the charger is too far
    ],
)
def test_job_is_left_out_if_charges_do_not_help(changed):
    plan = planned(problem([job("far", 2, latest_s=20.0)], [0, 5, 9], **changed))
    assert [one.job for one in plan.unassigned] == ["far"]


def test_two_charges_in_a_row_reach_a_place_beyond_one():
    asked = problem([job("far", 3)], [0, 8, 16, 20], chargers=(1, 2))
    plan = make_plan(asked, [["far"]], Objective.ENERGY)
    assert validate(asked, plan) == []
    assert [charge.place for charge in plan.routes[0].charges] == [1, 2, 2, 1]


def test_pickup_and_delivery_are_done_by_one_robot_that_charges_between_them():
    jobs = [
        job("up", 2, load_kg=5.0),
        job("down", 3, load_kg=-5.0, after=("up",), same_worker_as="up"),
        job("other", 2, load_kg=5.0),
        job("last", 3, load_kg=-5.0, after=("other",), same_worker_as="other"),
    ]
    plan = planned(problem(jobs, [0, 5, 1, 9], workers=2))
    assert plan.unassigned == ()


def test_job_waits_for_its_predecessor_by_a_robot_that_charges():
    jobs = [*FAR, job("near", 1, after=("far",))]
    plan = planned(problem(jobs, [0, 5, 9], workers=2))
    ends = {stop.job: (stop.start_s, stop.end_s) for route in plan.routes for stop in route.stops}
    assert ends["near"][0] >= ends["far"][1]


@pytest.mark.parametrize("objective", [Objective.MAKESPAN, Objective.LIFETIME])
def test_other_objectives_charge_too(objective):
    assert planned(problem(FAR, [0, 5, 9]), objective, iterations=60).unassigned == ()


@pytest.mark.parametrize("seed", [*range(6), 62, 81])
def test_charges_of_an_order_cost_as_little_as_the_best_of_all(seed):
    rng = np.random.default_rng(seed)
    places = [(0.0, 0.0), *rng.uniform(-6, 6, (6, 2))]
    jobs = [job(f"j{place}", place) for place in (3, 4, 5, 6)]
    asked = problem(jobs, (), places=places, chargers=(1, 2))
    order = [one.id for one in jobs]
    legs = asked.energy_j[0]
    costs = []
    stops = [(), (1,), (2,), (1, 2), (2, 1)]
    for chosen in itertools.product(stops, repeat=len(jobs) + 1):
        route = [0]
        for between, target in zip(chosen, [*(one.place for one in jobs), 0], strict=True):
            route += [*between, target]
        left_j, is_possible = 10.0, True
        for before, after in itertools.pairwise(route):
            left_j -= legs[before, after]
            is_possible = is_possible and left_j >= -1e-6
            left_j = 10.0 if after in (1, 2) else left_j
        if is_possible:
            costs.append(sum(legs[before, after] for before, after in itertools.pairwise(route)))
    plan = make_plan(asked, [order], Objective.ENERGY)
    assert (validate(asked, plan) == []) == bool(costs)
    if costs:
        assert plan.cost_j == pytest.approx(min(costs))


@pytest.mark.parametrize("changed", [{"place": 2}, {"gained_j": 4.0}, {"end_s": 9.0}, {"arrive_s": 4.0}])
def test_wrong_charge_is_a_fault(changed):
    asked = problem(FAR, [0, 5, 9])
    plan = planned(asked)
    charges = (msgspec.structs.replace(plan.routes[0].charges[0], **changed), *plan.routes[0].charges[1:])
    wrong = msgspec.structs.replace(plan, routes=(msgspec.structs.replace(plan.routes[0], charges=charges),))
    assert validate(asked, wrong)


def test_worker_with_chargers_has_a_full_battery_and_a_power():
    with pytest.raises(ValueError, match="expected a full_j and a charge_w > 0"):
        Worker(name="r", start=0, ends=(0,), usable_j=1.0, chargers=(0,))
