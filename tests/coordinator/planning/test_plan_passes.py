"""Refinement passes by name: those of robrain, and one of another distribution."""

import re
from pathlib import Path

import msgspec
import pytest

from robrain.coordinator.planning.plan_passes import PASSES
from robrain.coordinator.planning.plan_search import LockstepPlanner, PlanSolver
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.protocol.registry import Registry
from tests.coordinator.planning.recorded_plans import plan_again
from tests.coordinator.planning.snapshots import open_floor_snapshot
from tests.coordinator.planning.test_plan_solver import job, problem
from tests.installed_distributions import install  # noqa: F401 - a fixture

LAST_FIRST = '''
import msgspec

from robrain.algorithms.allocation.plan import make_plan
from robrain.protocol.reasons import plain

NOBODY = plain("nobody_there", "there is no robot")

def _with_orders(draft, orders):
    return msgspec.structs.replace(draft, plan=make_plan(draft.problem, orders, draft.plan.objective))


def last_first(draft):
    """Each robot does its tasks in reverse, but begins with what it is at."""
    pinned = {job.id for job in draft.problem.jobs if job.pinned_to}
    orders = [
        (*(job for job in jobs if job in pinned), *reversed([job for job in jobs if job not in pinned]))
        for jobs in draft.plan.orders
    ]
    return _with_orders(draft, orders)


def everything(draft):
    """Robots do everything in reverse, also what they are at."""
    return _with_orders(draft, [tuple(reversed(jobs)) for jobs in draft.plan.orders])


def leaves(draft):
    """Nobody does what is begun."""
    pinned = {job.id for job in draft.problem.jobs if job.pinned_to}
    return _with_orders(draft, [tuple(job for job in jobs if job not in pinned) for jobs in draft.plan.orders])


def nothing(draft):
    """No plan at all."""


def other(draft):
    """A plan for something else."""
    plan = msgspec.structs.replace(draft.plan, objective=type(draft.plan.objective).LIFETIME)
    return msgspec.structs.replace(draft, plan=plan)


def idle(draft):
    """Nobody does anything, and nobody says why."""
    pinned = {job.id for job in draft.problem.jobs if job.pinned_to}
    return _with_orders(draft, [tuple(job for job in jobs if job in pinned) for jobs in draft.plan.orders])


def choosy(draft):
    """Nobody does the rest, and this is why."""
    plan = idle(draft).plan
    left = tuple(msgspec.structs.replace(one, reason=NOBODY) for one in plan.unassigned)
    return msgspec.structs.replace(draft, plan=msgspec.structs.replace(plan, unassigned=left))


def broken(draft):
    raise ZeroDivisionError("by hand")


def changed(draft):
    """Another problem and other gains, which are not for a pass to change."""
    return msgspec.structs.replace(draft, problem=None, asked=None, gain_min=9.0, allocator=None)
'''
BAD = {
    "everything": "cannot be carried out: r0 is at at",
    "leaves": "r0 is at at; the plan does not begin with that",
    "nothing": "expected a PlanDraft, got NoneType",
    "other": "expected a plan for energy, got one for lifetime",
    "idle": "without a reason",
    "broken": "ZeroDivisionError: by hand",
}


@pytest.fixture
def last_first(install, monkeypatch):  # noqa: F811
    names = {name: f"last_first:{name}" for name in ("last_first", "changed", "choosy", *BAD)}
    install("last-first", names, {"last_first.py": LAST_FIRST}, PASSES.group)
    stock = {name: PASSES._points[name][0].value for name in PASSES._stock}
    fresh = Registry(PASSES.what, PASSES.group, stock, has_files=True)  # as in a new process
    for module in ("robrain.coordinator.planning.policy", "robrain.coordinator.planning.plan_passes"):
        monkeypatch.setattr(f"{module}.PASSES", fresh)


def solver(*passes, orders=None, gain_min=0.0):
    begun = msgspec.structs.replace(job("at", 1), pinned_to="r0")
    asked = problem(begun, job("a", 2), job("b", 1))
    return PlanSolver(asked, PlanningPolicy(method="auction", gain_min=gain_min, passes=passes), orders or {})


@pytest.mark.parametrize(
    ("passes", "words"),
    [
        (("stabilty",), r"one of .*stability, or FILE.py:NAME; got stabilty; did you mean stab"),
        (("stability", "stability"), "expected each pass once, got stability, stability"),
    ],
)
def test_unknown_and_repeated_passes_are_refused(passes, words):
    with pytest.raises(ValueError, match=words):
        PlanningPolicy(passes=passes)


def test_without_stability_tasks_change_robots_for_the_least_gain():
    orders = {"r1": ("b", "a")}
    assert solver("stability", orders=orders, gain_min=0.99).plan.orders == (("at",), ("b", "a"))
    assert solver(orders=orders, gain_min=0.99).plan.orders == (("at", "a", "b"), ())


def test_a_pass_of_another_distribution_refines_the_plan(last_first):
    assert PlanningPolicy(passes=("stability", "last_first")).passes == ("stability", "last_first")
    made = solver("last_first")
    assert made.plan.orders == (("at", "b", "a"), ())
    assert made.failures == ()


def test_the_pass_of_the_how_to_puts_valuable_tasks_first(install, monkeypatch):  # noqa: F811
    page = Path(__file__).parents[3] / "docs" / "how-to" / "extend-planning.md"
    code, *_others = re.findall(r"^```python\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)
    install("urgent-first", {"urgent_first": "urgent_first:urgent_first"}, {"urgent_first.py": code}, PASSES.group)
    stock = {name: PASSES._points[name][0].value for name in PASSES._stock}
    for module in ("policy", "plan_passes"):
        fresh = Registry(PASSES.what, PASSES.group, stock, has_files=True)
        monkeypatch.setattr(f"robrain.coordinator.planning.{module}.PASSES", fresh)
    begun = msgspec.structs.replace(job("at", 1), pinned_to="r0")
    asked = problem(begun, job("near", 1), msgspec.structs.replace(job("urgent", 2), prize_j=2000.0))
    made = PlanSolver(asked, PlanningPolicy(method="auction", passes=("early_start", "urgent_first")))
    assert made.plan.orders == (("at", "urgent", "near"), ())
    assert made.failures == ()


def test_passes_are_applied_in_the_order_in_which_they_are_listed(last_first):
    assert solver("last_first", "early_start").plan.orders == (("at", "b", "a"), ())
    assert solver("early_start", "last_first").plan.orders == (("at", "a", "b"), ())


@pytest.mark.slow
@pytest.mark.parametrize("name", BAD)
def test_a_bad_plan_of_a_pass_is_left_out_and_told(last_first, name):
    made = solver(name)
    assert made.plan.orders == solver().plan.orders
    (failure,) = made.failures
    assert (failure.what, failure.name) == ("plan_pass", name)
    assert BAD[name] in failure.reason


def test_a_pass_leaves_tasks_to_nobody_for_a_reason_of_its_own(last_first):
    made = solver("choosy")
    assert (made.plan.orders, made.failures) == ((("at",), ()), ())
    assert {(one.job, one.reason.code) for one in made.plan.unassigned} == {
        ("a", "nobody_there"),
        ("b", "nobody_there"),
    }


def test_of_what_a_pass_returns_the_plan_counts_alone(last_first):
    made = solver("changed", "stability", "early_start")
    assert made.plan.orders == solver("early_start").plan.orders
    assert made.problem is not None
    assert made.failures == ()


def test_a_recorded_plan_is_made_again_with_its_passes(last_first):
    planner = LockstepPlanner()
    planner.ask(open_floor_snapshot(1, 4), PlanningPolicy(passes=("last_first",)))
    (plan,) = planner.finished_plans()
    assert plan.problem.passes == ["last_first"]
    assert plan_again(plan.problem) == plan.problem.routes
    assert plan_again(msgspec.structs.replace(plan.problem, passes=[])) != plan.problem.routes


def test_what_failed_reaches_the_coordinator_with_the_plan(last_first):
    planner = LockstepPlanner()
    planner.ask(open_floor_snapshot(1, 4), PlanningPolicy(passes=("broken",)))
    (plan,) = planner.finished_plans()
    (failure,) = plan.failures
    assert failure.name == "broken"
    assert re.fullmatch(r".*last_first.py:\d+ in broken: ZeroDivisionError: by hand", failure.reason)
