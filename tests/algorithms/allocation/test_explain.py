import msgspec
import numpy as np
from hypothesis import HealthCheck, given, settings

from robrain.algorithms.allocation.auction import AuctionAllocator
from robrain.algorithms.allocation.explain import explain
from robrain.algorithms.allocation.plan import make_plan
from robrain.algorithms.allocation.problem import Objective, Problem, Worker
from robrain.algorithms.allocation.validate import validate
from robrain.protocol.reasons import BelowReserve, LacksEnergy, NearestOut, Refused, lacks_plugins, no_path
from tests.algorithms.allocation.test_allocators import problems
from tests.algorithms.allocation.test_validate import PAIR, job, line, worker
from tests.plain_reason import Plain


def only_bids(problem):
    """The reason of the only job, if it is left out, and the bids for it."""
    plan = AuctionAllocator().plan(problem)
    assert validate(problem, plan) == []
    return next((one.reason for one in plan.unassigned), None), explain(problem, plan, problem.jobs[0].id)


def chosen(bids):
    return [bid.robot for bid in bids if bid.chosen]


def test_each_reason_to_be_out_is_told():
    # 10 J full, 1.5 J of it reserve: what is left is counted with the reserve, as on the robot's own gauge.
    low = Worker(
        name="low", start=0, ends=(0,), usable_j=2.8, capacity_j=10.0, reserve_j=1.5, offers=frozenset({"camera"})
    )
    bare = worker("bare")
    late = worker("late", ready_s=118.0, offers=frozenset({"camera"}))
    poor = worker("poor", usable_j=3.0, offers=frozenset({"camera"}))
    good = worker("good", offers=frozenset({"camera"}))
    _, bids = only_bids(line([job("a", 2, needs=frozenset({"camera"}), latest_s=100.0)], [low, bare, late, poor, good]))
    assert chosen(bids) == ["good"]
    assert [bid.reason for bid in bids] == [
        BelowReserve(left=0.03, reserve=0.15),
        lacks_plugins(("camera",)),
        Plain("too_late", start_s=120.0, latest_s=100.0),
        LacksEnergy(missing_j=1.0),
        None,
    ]


def test_job_that_nobody_does_says_why_for_each_robot():
    reason, bids = only_bids(line([job("a", 5)], [worker("r1", usable_j=4.0), worker("r2", usable_j=8.0)]))
    assert chosen(bids) == []
    assert reason == NearestOut("r2", LacksEnergy(missing_j=2.0))
    assert [bid.reason for bid in bids] == [LacksEnergy(missing_j=6.0), LacksEnergy(missing_j=2.0)]


def test_job_that_only_robots_may_do_that_lack_something_says_what_keeps_each_from_it():
    jobs = [job("a", 2, needs=frozenset({"camera"}), forbidden_workers=frozenset({"r1"}))]
    camera = frozenset({"camera"})
    reason, bids = only_bids(line(jobs, [worker("r1", offers=camera)]))
    assert reason == Plain("nobody_allowed")
    assert [bid.reason for bid in bids] == [Plain("forbidden")]
    reason, _ = only_bids(line(jobs, [worker("r1"), worker("r3")]))
    assert reason == Plain("nobody_has", plugins=("camera",))


def test_job_without_a_way_says_so():
    ways = np.full((1, 3, 3), 1.0)
    ways[0, :, 2] = ways[0, 2, :] = np.inf
    _, bids = only_bids(Problem(jobs=(job("a", 2),), workers=(worker("r1"),), energy_j=ways, time_s=ways))
    assert chosen(bids) == []
    assert [bid.reason for bid in bids] == [Plain("no_way_and_back")]


def test_bids_know_where_a_job_ends():
    moved = job("moved", 1, end_place=5, service_j=4.0)
    _, bids = only_bids(line([moved], [worker("r1"), worker("r2", usable_j=9.0)]))
    assert [(bid.energy_j, bid.reason) for bid in bids] == [(5.0, None), (None, LacksEnergy(missing_j=1.0))]
    # The one after it begins at its end.
    after = job("next", 4)
    problem = line([moved, after], [worker("r1", usable_j=20.0)])
    (bid,) = explain(problem, make_plan(problem, [["moved", "next"]], Objective.ENERGY), "next")
    assert (bid.energy_j, bid.arrives_in_s) == (1.0, 2.0)


def test_robot_that_cannot_carry_a_load_says_so():
    robots = [worker("r1", capacity_kg=1.0), worker("r2", capacity_kg=2.0), worker("r3", usable_j=3.0)]
    for name, reason in (("get", Plain("full", load_kg=2.0)), ("put", Plain("full", load_kg=2.0))):
        problem = line(PAIR, robots)
        plan = AuctionAllocator().plan(problem)
        bids = explain(problem, plan, name)
        assert plan.orders == ((), ("get", "put"), ())
        assert [bid.reason for bid in bids] == [reason, None, LacksEnergy(missing_j=1.0)]
        assert chosen(bids) == ["r2"]
    reason, _ = only_bids(line(PAIR, robots[:1]))
    assert reason == NearestOut("r1", Plain("full", load_kg=2.0))


def test_robots_that_may_not_do_half_a_pair_say_so():
    pinned = msgspec.structs.replace(PAIR[0], pinned_to="r1")
    problem = line([pinned, PAIR[1]], [worker("r1"), worker("r2")])
    plan = AuctionAllocator().plan(problem)
    assert plan.orders == (("get", "put"), ())
    assert [bid.reason for bid in explain(problem, plan, "put")] == [None, Plain("not_holder")]
    forbidden = msgspec.structs.replace(PAIR[1], forbidden_workers=frozenset({"r1"}))
    problem = line([PAIR[0], forbidden], [worker("r1"), worker("r2")])
    plan = AuctionAllocator().plan(problem)
    assert [bid.reason for bid in explain(problem, plan, "get")] == [Plain("not_delivery"), None]


def test_robot_that_holds_too_much_for_the_job_it_is_at_gives_it_back():
    pinned = job("get", 1, load_kg=2.0, pinned_to="r1")
    plan = AuctionAllocator().plan(line([pinned], [worker("r1", capacity_kg=3.0, load_kg=2.0)]))
    assert [one.reason for one in plan.unassigned] == [Plain("holder_full", robot="r1")]


def test_job_that_a_robot_is_at_has_no_bids():
    assert only_bids(line([job("a", 2, pinned_to="r2")], [worker("r1"), worker("r2", start=5)])) == (None, ())


def test_robot_that_must_not_be_asked_says_why():
    problem = line([job("a", 2)], [worker("r1"), worker("r2")])
    plan = make_plan(problem, [["a"], []], Objective.ENERGY)
    first, second = explain(problem, plan, "a", {("a", "r2"): Refused(no_path())})
    assert (first.chosen, first.reason) == (True, None)
    assert (second.chosen, second.reason, second.energy_j) == (False, Refused(no_path()), None)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(problem=problems())
def test_who_does_a_job_never_is_out_and_who_is_out_has_a_reason(problem):
    plan = AuctionAllocator().plan(problem)
    for one in problem.jobs:
        for bid in explain(problem, plan, one.id):
            assert (bid.energy_j is None) == (bid.reason is not None)
            assert one.robots > 1 or not (bid.chosen and bid.reason), (bid, plan)
