"""Trips after a charge: feasible, only for jobs that are left out, and no worse a plan."""

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.algorithms.allocation.auction import AuctionAllocator
from robrain.algorithms.allocation.problem import Job, Problem, Worker
from robrain.algorithms.allocation.validate import validate
from robrain.coordinator.planning.plan_passes import PlanDraft
from robrain.coordinator.planning.plan_search import PlanSolver, charging_robots, without_chargers
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.model.tasks.objective import Objective
from robrain.protocol.reasons import LacksEnergy, NearestOut
from tests.algorithms.allocation.instances import team_problem


@st.composite
def problems(draw):
    """Random teams of which some charge."""
    robots = draw(st.integers(1, 4))
    share = st.sampled_from([0.0, 0.0, 0.4])
    problem = team_problem(
        robots,
        draw(st.integers(1, 9)),
        draw(st.integers(0, 10_000)),
        tightness=draw(st.sampled_from([0.5, 0.8, 1.5])),
        windows=draw(share),
        needs=draw(share),
        after=draw(share),
        pairs=draw(share),
        chargers=2,
        area_m=10.0,
    )
    late = draw(st.sets(st.integers(0, robots - 1)))
    full_share = draw(st.sampled_from([0.0, 1.0, 2.0]))
    workers = tuple(
        msgspec.structs.replace(
            worker,
            ready_s=40.0 * (index in late),
            chargers=worker.ends if full_share and worker.usable_j > 0 else (),
            full_j=full_share * worker.usable_j,
            charge_w=20.0,
        )
        for index, worker in enumerate(problem.workers)
    )
    return msgspec.structs.replace(problem, workers=workers)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(problems(), st.sampled_from(list(Objective)))
def test_trips_after_a_charge_contain_only_jobs_that_were_left_out(problem, objective):
    allocator = AuctionAllocator(objective)
    uncharged = without_chargers(problem)
    first = allocator.plan(uncharged, iterations=1)
    assert validate(uncharged, first) == []
    draft = PlanDraft(asked=problem, problem=uncharged, plan=first, orders={}, gain_min=0.0, allocator=allocator)
    refined = charging_robots(draft)
    shared, plan = refined.problem, refined.plan
    assert validate(shared, plan) == []
    assert plan.rank <= first.rank
    assert sum(map(len, plan.orders)) >= sum(map(len, first.orders))
    for before, after in zip(first.orders, plan.orders, strict=True):
        assert [job for job in after if job in set(before)] == list(before)
    assert all(one.reason is not None for one in plan.unassigned)


@pytest.mark.parametrize("able", ["r1", "r2"])
@pytest.mark.parametrize(("full_j", "charges"), [(100.0, [4.0]), (10.0, [])])
def test_the_only_robot_for_a_job_charges_first_and_lacks_energy_if_that_does_not_help(able, full_j, charges):
    """Robot r2 is charging already."""
    legs = np.array([[[0.0, 6.0], [6.0, 0.0]]])
    ready = Worker(name="r1", start=0, ends=(0,), usable_j=6.0, chargers=(0,), full_j=full_j, charge_w=23.5)
    late = msgspec.structs.replace(ready, name="r2", ready_s=40.0)
    job = Job(id="t", place=1, prize_j=1e3, forbidden_workers=frozenset({"r1", "r2"} - {able}))
    problem = Problem(jobs=(job,), workers=(ready, late), energy_j=legs, time_s=legs)
    plan = PlanSolver(problem, PlanningPolicy()).plan
    route = next(route for route in plan.routes if route.worker == able)
    assert [(charge.end_s - charge.arrive_s) for charge in route.charges] == charges
    reasons = [one.reason for one in plan.unassigned]
    assert reasons == ([] if charges else [NearestOut(able, LacksEnergy(6.0))])
