"""A plan as the coordinator follows it: when each robot sets out, who does nothing, and what is told of it."""

import msgspec
import numpy as np

from robrain.algorithms.allocation.plan import Unassigned, make_plan
from robrain.algorithms.allocation.problem import Job, Objective, Problem, Worker
from robrain.coordinator.planning.plan_in_force import PlannedStep, planned
from robrain.coordinator.planning.problem_builder import BuiltProblem
from robrain.protocol.messages.tasks.plan_messages import PlanProblem
from robrain.protocol.reasons import Refused, no_path, plain
from tests.coordinator.planning.snapshots import open_floor_snapshot

NOW_S = 100.0
WRITTEN = PlanProblem(plan=7, asked_ns=0, objective=Objective.ENERGY, method="optimal", seed=0, rounds=0, iterations=0,
                      question=b"")  # fmt: skip


LATE = plain("after_unplanned", "words")


def job(name, place, **fields):
    return Job(id=name, place=place, prize_j=1000.0, **fields)


def plan_of(orders, *jobs, only="", **fields):
    """Places 0 to 4 on a line, a metre apart, a second and a joule a metre; robots begin and end at 0."""
    length_m = np.abs(np.subtract.outer(np.arange(5.0), np.arange(5.0)))[None]
    workers = tuple(
        Worker(name=f"r{k}", start=0, ends=(0,), usable_j=100.0, ready_s=2.0 * k) for k in range(len(orders))
    )
    problem = Problem(jobs=jobs, workers=workers, energy_j=length_m, time_s=length_m)
    plan = make_plan(problem, orders, Objective.ENERGY)
    assert plan is not None
    unassigned = tuple(Unassigned(one.job, plain("no_robots", "words")) for one in plan.unassigned)
    plan = msgspec.structs.replace(plan, unassigned=unassigned)
    snapshot = msgspec.structs.replace(open_floor_snapshot(7, 0), now_ns=round(NOW_S * 1e9), **fields)
    asked = BuiltProblem(question=None, waiting={"late": LATE}, charger_distances={})
    return planned(snapshot, asked, problem, plan, WRITTEN, 0.25, only=only)


def ns(in_s):
    return round((NOW_S + in_s) * 1e9)


def test_a_robot_sets_out_when_it_is_free_and_for_what_begins_later_in_time():
    made = plan_of([[], ["a", "b"]], job("a", 1, service_s=5.0), job("b", 3, earliest_s=20.0))
    assert made.steps == {
        "r0": (),
        "r1": (PlannedStep("a", ns(2.0), 1.0, ns(3.0), 5.0, 1.0), PlannedStep("b", ns(18.0), 2.0, ns(20.0), 0.0, 2.0)),
    }  # it is free at 2, at a from 3 to 8, and could be at b at 10
    assert made.orders == {"r1": ("a", "b")}
    assert (made.problem, made.duration_s, made.waiting, made.left_out) == (WRITTEN, 0.25, {"late": LATE}, {})


def test_what_a_robot_is_at_comes_first_and_is_not_planned_again():
    made = plan_of([["a", "b"]], job("a", 1, service_s=5.0, pinned_to="r0"), job("b", 2))
    begun = PlannedStep("a", ns(0.0), 1.0, ns(1.0), 5.0, 1.0, has_begun=True)
    assert made.steps == {"r0": (begun, PlannedStep("b", ns(6.0), 1.0, ns(7.0), 0.0, 1.0))}
    assert made.orders == {"r0": ("b",)}


def test_what_nobody_does_is_left_out_with_its_reason_but_not_what_is_begun():
    made = plan_of([[]], job("a", 1), job("b", 2, pinned_to="r0"))
    assert made.left_out == {"a": plain("no_robots", "words")}


def test_costs_of_a_task_are_there_if_they_are_asked_for():
    tasks = job("a", 3), job("b", 2)
    assert plan_of([["a", "b"], []], *tasks).bids == ()
    first, second = plan_of([["a", "b"], []], *tasks, only="a", pauses={("a", "r1"): Refused(no_path())}).bids
    assert (first.robot, first.chosen, first.energy_j, first.arrives_in_s) == ("r0", True, 3.0, 3.0)
    assert (second.robot, second.chosen, second.reason) == ("r1", False, Refused(no_path()))
