"""Time windows from a plan, within which visits may be moved without breaking what comes after what."""

import math

import pytest

from robrain.algorithms.allocation.coupling import Windows, windows_of
from robrain.algorithms.allocation.plan import make_plan
from robrain.algorithms.allocation.problem import Objective, Problem, make_arrays
from robrain.algorithms.allocation.validate import validate
from tests.algorithms.allocation.test_validate import job, line, worker


def windows(problem: Problem, orders: list[list[str]], share: float, end_s: float) -> tuple[Windows, dict]:
    """The windows, and for each job with visits their earliest and latest starts and whether they are required."""
    plan = make_plan(problem, orders, Objective.ENERGY)
    assert plan is not None
    assert validate(problem, plan) == []
    arrays = make_arrays(problem)
    found = windows_of(problem, arrays, plan, share, end_s)
    rows = zip(found.visits.job, found.visits.earliest_s, found.visits.latest_s, found.required, strict=True)
    told: dict[str, list[tuple[float, float, bool]]] = {}
    for index, earliest_s, latest_s, required in rows:
        told.setdefault(problem.jobs[index].id, []).append((float(earliest_s), float(latest_s), bool(required)))
    return found, told


@pytest.mark.parametrize(
    ("share", "moment_s"),
    # a starts at 1 and ends at 3, at the latest at 23 and 25; b starts at 4, at the latest at 26 (it is back at 30).
    [(0.0, (3.0 + 4.0) / 2), (1.0, (25.0 + 26.0) / 2), (0.5, (14.0 + 15.0) / 2), (0.25, (8.5 + 9.5) / 2)],
)
def test_between_a_job_and_the_one_after_it_a_moment_is_chosen(share, moment_s):
    jobs = [job("a", 1, service_s=2.0), job("b", 2, service_s=2.0, after=("a",))]
    _, told = windows(line(jobs, [worker("r1")]), [["a", "b"]], share, 30.0)
    assert told["a"] == [(0.0, pytest.approx(moment_s - 2.0), True)]
    assert told["b"] == [(pytest.approx(moment_s), math.inf, False)]


def test_a_latest_start_is_that_of_the_job_that_follows_on_another_route():
    jobs = [job("a", 1, service_s=1.0), job("b", 3, latest_s=10.0, after=("a",))]
    _, told = windows(line(jobs, [worker("r1"), worker("r2")]), [["a"], ["b"]], 1.0, 30.0)
    # b ends at 10 at the latest, so a must by then: nothing is between.
    assert told["a"] == [(0.0, pytest.approx(9.0), True)]
    assert told["b"] == [(pytest.approx(10.0), 10.0, False)]


@pytest.mark.parametrize(("share", "start_s"), [(0.0, 4.0), (0.5, 15.0), (1.0, 26.0)])
def test_a_job_for_several_robots_keeps_its_time(share, start_s):
    problem = line([job("lift", 4, robots=2)], [worker("r1"), worker("r2", start=1)])
    _, told = windows(problem, [["lift"], ["lift"]], share, 30.0)
    assert told["lift"] == [(pytest.approx(start_s), pytest.approx(start_s), True)] * 2


def test_what_the_plan_leaves_out_is_not_among_the_visits_and_holds_up_nobody():
    jobs = [job("a", 1), job("b", 5, after=("a",)), job("c", 5), job("d", 2, after=("a",))]
    found, told = windows(line(jobs, [worker("r1", usable_j=8.0)]), [["a", "d"]], 0.0, 10.0)
    assert found.rows.tolist() == [0, 2, 3]
    assert told == {"a": [(0.0, 1.5, True)], "c": [(0.0, math.inf, False)], "d": [(1.5, math.inf, False)]}


def test_what_a_robot_is_at_ends_when_it_ends():
    jobs = [job("at", 1, service_s=2.0, pinned_to="r1"), job("b", 2, after=("at",))]
    _, told = windows(line(jobs, [worker("r1"), worker("r2")]), [["at"], ["b"]], 1.0, 30.0)
    assert told == {"b": [(3.0, math.inf, False)]}
