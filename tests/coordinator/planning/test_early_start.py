"""Of plans that are equally good, the one that begins earlier."""

import numpy as np

from robrain.algorithms.allocation.plan import make_plan
from robrain.algorithms.allocation.problem import Job, Objective, Problem, Worker
from robrain.algorithms.allocation.validate import validate
from robrain.coordinator.planning.plan_search import without_idling


def problem(*jobs: Job) -> Problem:
    """Places 0 to 4 on a line, a metre apart, a second and a joule a metre; the robot begins and ends at 0."""
    length_m = np.abs(np.subtract.outer(np.arange(5.0), np.arange(5.0)))[None]
    worker = Worker(name="r", start=0, ends=(0,), usable_j=100.0)
    return Problem(jobs=jobs, workers=(worker,), energy_j=length_m, time_s=length_m)


def eager(asked: Problem, *order: str) -> tuple[str, ...]:
    plan = make_plan(asked, [order], Objective.ENERGY)
    assert plan is not None
    better = without_idling(asked, plan)
    assert validate(asked, better) == []
    assert better.rank <= plan.rank
    return better.routes[0].jobs


def job(name: str, place: int, **fields) -> Job:
    return Job(id=name, place=place, prize_j=fields.pop("prize_j", 100.0), **fields)


def test_a_tour_is_gone_in_the_direction_in_which_dear_jobs_come_first():
    asked = problem(job("far", 4), job("near", 1, prize_j=900.0))
    assert eager(asked, "far", "near") == ("near", "far")
    asked = problem(job("far", 4, prize_j=9000.0), job("near", 1, service_s=3.0))
    assert eager(asked, "far", "near") == ("far", "near")


def test_what_can_be_done_meanwhile_is_also_where_the_other_direction_would_wait_longer():
    asked = problem(job("late", 2, earliest_s=50.0), job("now", 1), job("last", 3, earliest_s=60.0))
    assert eager(asked, "late", "now", "last") == ("now", "late", "last")


def test_what_it_is_at_stays_first_and_nothing_comes_too_late():
    asked = problem(job("at", 4, pinned_to="r"), job("far", 3), job("near", 1, prize_j=900.0))
    assert eager(asked, "at", "far", "near")[0] == "at"
    asked = problem(job("far", 4, latest_s=5.0), job("near", 1, service_s=2.0, prize_j=900.0))
    assert eager(asked, "far", "near") == ("far", "near")
