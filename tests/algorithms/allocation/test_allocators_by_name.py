"""Allocators by name: those of robrain, and one of another distribution."""

import re

import msgspec
import pytest

from robrain.algorithms.allocation.allocator import ALLOCATORS
from robrain.coordinator.planning.plan_search import PlanSolver
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.registry import Registry
from tests.coordinator.planning.test_plan_solver import job, problem
from tests.installed_distributions import install  # noqa: F401 - a fixture
from tests.plain_reason import Plain

IN_TURN = '''
from robrain.algorithms.allocation.plan import make_plan
from robrain.algorithms.allocation.validate import validate


class InTurn:
    """Hands out one job to each robot in turn; a robot that cannot do its job is passed over."""

    def __init__(self, objective):
        self.objective = objective

    def plan(self, problem, *, deadline_s=None, iterations=None, seed=0, warm_start=None):
        robots = len(problem.workers)
        orders = [[job.id for job in problem.jobs if worker.name in job.pinned_to] for worker in problem.workers]
        plan = make_plan(problem, orders, self.objective)
        free = [job for job in problem.jobs if not job.pinned_to]
        for turn, job in enumerate(free):
            for robot in range(turn, turn + robots):
                tried = [[*order, job.id] if k == robot % robots else order for k, order in enumerate(orders)]
                found = make_plan(problem, tried, self.objective)
                if found is not None and not validate(problem, found):
                    orders, plan = tried, found
                    break
        return plan


class Careless(InTurn):
    """Gives each robot the same job."""

    def plan(self, problem, **_):
        return make_plan(problem, [[problem.jobs[0].id] for _ in problem.workers], self.objective)


class CarelessSearch(InTurn):
    """Makes a sound plan, which its search spoils."""

    def search(self):
        return Careless(self.objective)
'''


@pytest.fixture
def in_turn(install, monkeypatch):  # noqa: F811
    names = {"in_turn": "in_turn:InTurn", "careless": "in_turn:Careless", "search": "in_turn:CarelessSearch"}
    install("in-turn", names, {"in_turn.py": IN_TURN}, ALLOCATORS.group)
    stock = {name: ALLOCATORS._points[name][0].value for name in ALLOCATORS._stock}
    fresh = Registry(ALLOCATORS.what, ALLOCATORS.group, stock)  # as in a new process
    for module in ("robrain.coordinator.planning.policy", "robrain.algorithms.allocation.checked_allocator"):
        monkeypatch.setattr(f"{module}.ALLOCATORS", fresh)


def routes(method, *jobs):
    solver = PlanSolver(problem(*jobs), PlanningPolicy(method=method, gain_min=0.0))
    solver.run(rounds=1)
    plan = solver.plan
    return {route.worker: sorted(route.jobs) for route in plan.routes}


def test_an_allocator_of_another_distribution_makes_the_plans(in_turn):
    jobs = [job(name, 1) for name in "abcd"]
    assert PlanningPolicy(method="in_turn").method == "in_turn"
    assert routes("in_turn", *jobs) == {"r0": ["a", "c"], "r1": ["b", "d"]}
    assert routes("auction", *jobs) == {"r0": ["a", "b", "c", "d"], "r1": []}


def test_a_plan_of_somebody_else_that_cannot_be_carried_out_is_replaced_by_the_stock_plan(in_turn):
    solver = PlanSolver(problem(job("a", 1)), PlanningPolicy(method="careless"))
    assert solver.plan.orders == (("a",), ())
    (failure,) = solver.failures
    assert re.search(r"in_turn.py:\d+: ValueError: the plan cannot be carried out: ", failure.reason)


def test_a_bad_plan_of_a_search_is_dropped(in_turn):
    assert routes("search", job("a", 1), job("b", 2)) == {"r0": ["a"], "r1": ["b"]}


def test_a_job_that_is_left_out_without_a_reason_gets_one(in_turn):
    asked = problem(msgspec.structs.replace(job("photo", 1), needs=frozenset({"camera"})))
    solver = PlanSolver(asked, PlanningPolicy(method="in_turn"))
    assert [one.reason for one in solver.plan.unassigned] == [Plain("nobody_has", plugins=("camera",))]
