"""What every allocator must keep, over random teams and tasks."""

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from robrain.algorithms.allocation.auction import (
    GREATEST_GAIN,
    LEAST_BID,
    LEAST_PER_PRIZE,
    AuctionAllocator,
    GreedyAllocator,
    keep,
    repaired,
)
from robrain.algorithms.allocation.insertion import BY_ENERGY
from robrain.algorithms.allocation.optimal import OptimalAllocator
from robrain.algorithms.allocation.plan import make_plan
from robrain.algorithms.allocation.problem import Job, Objective, Problem, Worker
from robrain.algorithms.allocation.validate import SLACK, validate
from tests.algorithms.allocation.instances import team_problem
from tests.algorithms.allocation.oracle import exact_plan
from tests.algorithms.allocation.test_validate import job, line, worker
from tests.plain_reason import Plain

ITERATIONS = 60


def never():
    raise AssertionError("the clock is not read where only iterations count")


def optimal(objective=Objective.ENERGY, monotonic=never):
    return OptimalAllocator(objective, monotonic)


def allocators(objective):
    return [GreedyAllocator(objective), AuctionAllocator(objective), optimal(objective)]


@st.composite
def problems(draw):
    """Random teams on random ways, with everything that a problem may have."""
    robots, tasks = draw(st.integers(0, 4)), draw(st.integers(0, 9))
    share = st.sampled_from([0.0, 0.0, 0.4])
    problem = team_problem(
        robots,
        tasks,
        draw(st.integers(0, 10_000)),
        tightness=draw(st.sampled_from([None, 0.8, 1.5, 4.0])),
        windows=draw(share),
        needs=draw(share),
        after=draw(share),
        pairs=draw(share),
        driven=draw(share),
        deliveries=draw(st.sampled_from([0.0, 0.7])),
        loads=draw(share),
        wait_w=draw(st.sampled_from([0.0, 0.0, 5.0])),
        late_start=draw(st.sampled_from([0.0, 30.0])),
        chargers=2,
        area_m=10.0,
    )
    problem = msgspec.structs.replace(problem, horizon_s=draw(st.just(problem.horizon_s) | st.floats(0.0, 120.0)))
    if robots and tasks and draw(st.booleans()):
        # Some job is being done already, and some ways are missing.
        first = msgspec.structs.replace(problem.jobs[0], pinned_to="r0", robots=1, after=(), same_worker_as="")
        energy_j = problem.energy_j.copy()
        energy_j[:, tasks - 1, :tasks] = np.inf
        problem = msgspec.structs.replace(problem, jobs=(first, *problem.jobs[1:]), energy_j=energy_j)
    forbidden = frozenset(draw(st.sets(st.sampled_from([worker.name for worker in problem.workers]))) if robots else ())
    jobs = (
        job if job.pinned_to or number % 2 else msgspec.structs.replace(job, forbidden_workers=forbidden)
        for number, job in enumerate(problem.jobs)
    )
    return msgspec.structs.replace(problem, jobs=tuple(jobs))


@pytest.mark.slow
@pytest.mark.parametrize("objective", Objective)
@settings(max_examples=30, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(problem=problems(), seed=st.integers(0, 1000))
def test_no_plan_breaks_energy_windows_needs_precedence_or_gives_a_job_twice(objective, problem, seed):
    for allocator in allocators(objective):
        plan = allocator.plan(problem, iterations=ITERATIONS, seed=seed)
        assert validate(problem, plan) == [], type(allocator).__name__
        assert all(one.reason is not None for one in plan.unassigned)
        assert plan.objective is objective


@pytest.mark.slow
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(problem=problems(), objective=st.sampled_from(Objective))
def test_same_seed_gives_the_same_plan_and_none_is_worse_than_the_auction(problem, objective):
    plan = optimal(objective).plan(problem, iterations=ITERATIONS, seed=3)
    assert plan == optimal(objective).plan(problem, iterations=ITERATIONS, seed=3)
    assert plan.rank <= AuctionAllocator(objective).plan(problem).rank


@pytest.mark.slow
@settings(max_examples=20, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(problem=problems(), objective=st.sampled_from(Objective))
def test_warm_start_is_the_least_that_comes_back(problem, objective):
    plan = optimal(objective).plan(problem, iterations=ITERATIONS)
    assert AuctionAllocator(objective).plan(problem, warm_start=plan).rank <= plan.rank
    assert optimal(objective).plan(problem, iterations=1, warm_start=plan).rank <= plan.rank


def test_warm_start_of_other_jobs_and_robots_is_used_as_far_as_it_goes():
    problem = team_problem(4, 20, 5, tightness=0.6)
    plan = optimal().plan(problem, iterations=300)
    later = msgspec.structs.replace(problem, jobs=problem.jobs[4:], workers=problem.workers[1:])
    again = optimal().plan(later, iterations=1, warm_start=plan)
    assert validate(later, again) == []
    assert again.rank <= AuctionAllocator().plan(later).rank


@pytest.mark.parametrize(
    "problem",
    [
        line([job("a", 0, service_s=SLACK, latest_s=0.0)], [worker("r1")]),
        line([job("a", 0, service_s=SLACK)], [worker("r1")], horizon_s=0.0),
        line([job("a", 0)], [worker("r1", usable_j=-SLACK)]),
    ],
    ids=["latest end", "horizon", "energy"],
)
def test_a_warm_start_that_misses_a_limit_by_just_what_the_checker_allows_is_kept(problem):
    plan = make_plan(problem, [["a"]], Objective.ENERGY)
    assert validate(problem, plan) == []
    assert keep(problem, plan, Objective.ENERGY) == plan


def test_where_energy_does_not_suffice_the_job_that_saves_most_for_its_prize_is_left_out():
    """It need not be the last: on the way back from the far one, the near one takes nothing."""
    problem = line([job("far", 5), job("near", 1)], [worker("r1", usable_j=9.0)])
    assert repaired(problem, [["far", "near"]], Objective.ENERGY).orders == (("near",),)


def test_where_robots_wait_for_each_other_the_jobs_for_several_are_left_out():
    jobs = [job("lift", 1, robots=2), job("carry", 2, robots=2), job("go", 3)]
    problem = line(jobs, [worker("r1"), worker("r2")])
    plan = repaired(problem, [["lift", "go", "carry"], ["carry", "lift"]], Objective.ENERGY)
    assert plan is not None
    assert plan.orders == (("go",), ())


@pytest.mark.parametrize("deadline_s", [0.0, 0.02, 0.5])
@pytest.mark.parametrize("objective", Objective)
@pytest.mark.parametrize("after", [0.0, 0.3])
def test_answer_is_there_within_the_deadline_on_a_clock_that_a_step_moves(deadline_s, objective, after):
    """Each look at the clock moves it by 2 ms: what is counted is that the search stops looking in time."""
    now_s = [100.0]

    def monotonic():
        now_s[0] += 0.002
        return now_s[0]

    problem = team_problem(4, 20, 2, tightness=0.7, after=after)
    plan = optimal(objective, monotonic).plan(problem, deadline_s=deadline_s)
    assert validate(problem, plan) == []
    assert now_s[0] <= 100.0 + deadline_s + 0.02


def test_quick_robot_is_used_for_the_makespan_and_cheap_one_for_energy():
    energy = np.array([[[0.0, 10.0], [10.0, 0.0]], [[0.0, 50.0], [50.0, 0.0]]])
    time = np.array([[[0.0, 10.0], [10.0, 0.0]], [[0.0, 2.0], [2.0, 0.0]]])
    problem = Problem(
        jobs=(Job(id="a", place=1, prize_j=500.0),),
        workers=(
            Worker(name="slow", start=0, ends=(0,), usable_j=200.0),
            Worker(name="quick", start=0, ends=(0,), usable_j=200.0, profile=1),
        ),
        energy_j=energy,
        time_s=time,
    )
    for kind in (AuctionAllocator, optimal):
        assert kind(Objective.ENERGY).plan(problem, iterations=50).orders == (("a",), ())
        assert kind(Objective.MAKESPAN).plan(problem, iterations=50).orders == ((), ("a",))
        assert kind(Objective.LIFETIME).plan(problem, iterations=50).orders == (("a",), ())


def test_job_that_costs_more_than_its_prize_is_left_and_the_reason_says_so():
    problem = line([Job(id="a", place=5, prize_j=9.0)], [worker("r1")])
    plan = optimal().plan(problem, iterations=20)
    assert plan.unassigned[0].reason == Plain("not_worth_it", worth_j=9.0, robot="r1", needed_j=10.0)


def test_dear_first_job_is_done_for_what_follows_it():
    """Neither is worth the way alone; both together are."""
    jobs = [Job(id=name, place=5, prize_j=7.0) for name in "ab"]
    problem = line(jobs, [worker("r1")])
    for allocator in (AuctionAllocator(), optimal()):
        assert set(allocator.plan(problem, iterations=20).orders[0]) == {"a", "b"}


@pytest.mark.parametrize("kind", [GreedyAllocator, AuctionAllocator, optimal])
@pytest.mark.parametrize(("usable_j", "done"), [(9.0, 2), (8.9, 1)])
def test_the_next_path_begins_where_a_job_ends(kind, usable_j, done):
    """1 J to 1, 4 J along 1 to 5, 1 J to 4, 4 J home; from 1 or with the return from 1, it would take other sums."""
    moved, next_to_it = job("moved", 1, end_place=5, service_j=3.0, service_s=4.0), job("next", 4)
    plan = kind(Objective.ENERGY).plan(line([moved, next_to_it], [worker("r1", usable_j=usable_j)]), iterations=20)
    assert len(plan.routes[0].stops) == done
    if done == 2:
        assert plan.orders == (("moved", "next"),)
        assert plan.routes[0].end_s == 10.0


@pytest.mark.parametrize(("usable_j", "done"), [(6.0, ("a",)), (5.9, ())])
def test_a_robot_that_waits_for_what_it_is_at_needs_the_energy_to_wait(usable_j, done):
    """It is there at 1 s and waits 4 s at 1 W; the way there and back takes 2 J."""
    at = job("a", 1, earliest_s=5.0, pinned_to="r1")
    problem = line([at], [worker("r1", wait_w=1.0, usable_j=usable_j)])
    assert AuctionAllocator().plan(problem).orders == (done,)


@pytest.mark.parametrize("objective", Objective)
def test_large_budgets_long_ways_and_small_ones_do_not_overflow(objective):
    for scale in (1e-3, 1.0, 1e4):
        problem = team_problem(3, 12, 4, tightness=0.8)
        workers = tuple(msgspec.structs.replace(one, usable_j=one.usable_j * scale) for one in problem.workers)
        jobs = tuple(
            msgspec.structs.replace(one, prize_j=one.prize_j * scale, service_j=one.service_j * scale)
            for one in problem.jobs
        )
        scaled = Problem(jobs=jobs, workers=workers, energy_j=problem.energy_j * scale, time_s=problem.time_s)
        plan = optimal(objective).plan(scaled, iterations=100)
        assert validate(scaled, plan) == []
        assert plan.rank <= AuctionAllocator(objective).plan(scaled).rank


@pytest.mark.parametrize(("choice", "taken"), [(LEAST_BID, "near"), (GREATEST_GAIN, "dear"), (LEAST_PER_PRIZE, "dear")])
def test_auction_chooses_by_bid_by_gain_or_by_bid_for_its_prize(choice, taken):
    jobs = [Job(id="near", place=3, prize_j=5.0), Job(id="dear", place=0, prize_j=100.0)]
    problem = line(jobs, [Worker(name="r1", start=2, ends=(2,), usable_j=5.5)])
    plan, _ = AuctionAllocator().hold(problem, BY_ENERGY, choice)
    assert [stop.job for route in plan.routes for stop in route.stops] == [taken]


@pytest.mark.parametrize("choice", [LEAST_BID, GREATEST_GAIN, LEAST_PER_PRIZE])
def test_of_jobs_that_are_equally_good_the_auction_hands_out_the_first(choice):
    jobs = [job(name, 3, service_j=1.0) for name in ("first", "second", "third")]
    plan, _ = AuctionAllocator().hold(line(jobs, [worker("r1", usable_j=7.0)]), BY_ENERGY, choice)
    assert plan.orders == (("first",),)


SIZES = [(2, 8), (4, 8), (6, 6)]


@pytest.mark.slow
@pytest.mark.parametrize(("robots", "tasks"), SIZES)
@pytest.mark.parametrize(
    "kind",
    [
        {"prize_j": None, "tightness": None},
        {"tightness": 0.9},
        {"tightness": 0.9, "windows": 0.4, "needs": 0.3, "late_start": 20.0},
        {"tightness": 0.9, "windows": 0.4, "driven": 0.5},
        {"tightness": 0.9, "windows": 0.3, "needs": 0.3, "deliveries": 1.0},
        {"tightness": 0.9, "deliveries": 0.5, "loads": 0.7},
    ],
    ids=["energy", "prizes", "windows and needs", "other ends", "deliveries", "loads"],
)
def test_optimal_is_within_half_a_percent_of_the_exact_optimum(robots, tasks, kind):
    problem = team_problem(robots, tasks, 0, **kind)
    exact = exact_plan(problem)
    assert exact is not None
    assert validate(problem, exact) == []
    plan = OptimalAllocator(Objective.ENERGY, never).plan(problem, iterations=1000)
    # The oracle rounds to a millijoule a way: nobody is better by more.
    assert exact.value * (1 - 1e-5) <= plan.value <= exact.value * 1.005


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_nothing_is_better_than_the_exact_optimum_where_jobs_wait_for_each_other(seed):
    problem = team_problem(3, 7, seed, tightness=0.9, after=0.3, pairs=0.3, deliveries=0.3 * (seed % 2))
    exact = exact_plan(problem)
    assert exact is not None
    assert validate(problem, exact) == []
    plan = OptimalAllocator(Objective.ENERGY, never).plan(problem, iterations=600)
    assert validate(problem, plan) == []
    assert exact.value * (1 - 1e-5) <= plan.value
