"""Teams with fewer chargers than robots: who charges when, what waits for it, and what is told of it."""

import pytest

from robrain.coordinator.parts.charge_schedule import schedule_charges
from robrain.coordinator.parts.charging import CHARGED_SOC, Charging
from robrain.coordinator.planning.energy_budget import CHARGED_SHARE, when_charged
from robrain.coordinator.planning.policy import PlanningPolicy
from robrain.coordinator.planning.snapshot import AfterCharge
from robrain.protocol.links.inbox import Inbox
from robrain.protocol.messages.robots.robot_messages import BatteryState, RobotState
from robrain.protocol.messages.tasks import plan_messages
from robrain.protocol.messages.tasks.plan_messages import PlanningStatus
from robrain.protocol.messages.tasks.task_messages import TASK_EXPLAIN, TaskExplanation, TaskRequest
from robrain.protocol.model.geometry import Point2D, Pose2D
from robrain.protocol.model.tasks.stock_kinds import Recharge
from robrain.protocol.model.tasks.task import Task, TaskState, parameters_of
from robrain.protocol.wire.session import open_lockstep_session
from tests.coordinator.conftest import Team
from tests.coordinator.planning.recorded_plans import plan_again
from tests.coordinator.planning.worlds import CAPACITY_J, Worker, model, run

DOCKS = (Point2D(3.5, 2.5), Point2D(8.5, 2.5), Point2D(8.5, 5.5), Point2D(3.5, 5.5))
RESERVE_SOC = 0.1
DEAR = 100.0
"""So many times what usual ways take: a battery is empty after 40 m."""


def visit(name, x_m=6.0, y_m=4.0, **fields):
    return Task(id=name, kind="visit", place=Point2D(x_m, y_m), **fields)


def staff(team, socs, docks=1, *, dearer=1.0):
    workers = []
    for number, soc in enumerate(socs, start=1):
        robot = team.robot(f"r{number}", 4.0 + number, 4.0)
        robot.plugins = ["visit", "recharge"]
        robot.chargers = list(DOCKS[:docks])
        workers.append(Worker(robot, remaining_j=soc * CAPACITY_J, dearer=dearer))
    team.closed_room()
    return workers


def status(team):
    return team.ask(plan_messages.COORDINATOR_PLANNING, None, PlanningStatus)


def all_done(team):
    return lambda: set(team.states().values()) == {TaskState.DONE}


def charges_of(worker):
    return [offer.task for offer in worker.robot.offers if offer.task.kind == "recharge"]


def to_soc_of(charge):
    return parameters_of(charge, Recharge).until_soc


# -- the whole ------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_four_robots_do_many_costly_visits_with_two_chargers_and_keep_their_reserve():
    with open_lockstep_session() as session:
        team = Team(session)
        workers = staff(team, (0.22, 0.2, 0.18, 0.16), docks=2, dearer=DEAR)
        for number, worker in enumerate(workers):  # near a charger: no robot is so low that it does not get to one
            worker.robot.pose = Pose2D(4.0 + 0.6 * number, 3.0, 0.0)
        docked_most = 0

        def check():
            nonlocal docked_most
            docked = [worker.at_charger for worker in workers if worker.at_charger is not None]
            assert len(docked) == len(set(docked))
            docked_most = max(docked_most, len(docked))

        run(team, workers, 1.0)
        for number in range(30):
            team.submit(visit(f"t{number}", 3.4 + 5.2 * (0.618 * number % 1.0), 2.4 + 3.2 * (0.755 * number % 1.0)))
        assert run(team, workers, 1500.0, until=all_done(team), check=check), team.states()
        assert 1 <= docked_most <= 2
        assert min(worker.least_j for worker in workers) > 0.9 * RESERVE_SOC * CAPACITY_J
        team.close()


# -- those who charge are counted on --------------------------------------------------------------------------------


def test_a_task_that_only_a_robot_that_charges_can_do_waits_for_it_and_says_so(team):
    ears = Inbox(1000, every=True)
    team.endpoint().subscribe(ears, plan_messages.TASK_PROBLEM)
    (worker,) = staff(team, (0.102,))
    run(team, [worker], 1.0)
    team.submit(visit("t1", 8.5))
    assert run(team, [worker], 20.0, until=lambda: worker.at_charger is not None)
    run(team, [worker], 1.0)
    assert team.coordinator.planning.left_out == {}
    why = team.ask(TASK_EXPLAIN, TaskRequest(id="t1"), TaskExplanation)
    assert (why.record.reason.robot, why.record.reason.to_soc) == ("r1", 0.35)  # enough for the task, less than full
    assert why.record.estimate.robot == "r1"
    assert why.record.estimate.starts_in_s == pytest.approx(why.reason.values["in_s"], abs=0.1)
    assert status(team).planned == 1
    assert [offer.task.kind for offer in worker.robot.offers] == ["recharge"]  # offered when it is free
    assert run(team, [worker], 120.0, until=all_done(team))
    problems = [received.message for received in ears.drain()]
    assert all(plan_again(one) == one.routes for one in problems)
    waited = [change.why for change in team.ask(TASK_EXPLAIN, TaskRequest(id="t1"), TaskExplanation).changes]
    levels = [why.split(",")[0] for why in waited if why.startswith("waits until r1 has charged")]
    # Told once for each level: before it stands at the charger it is to charge whole.
    assert levels == ["waits until r1 has charged to 95%", "waits until r1 has charged to 35%"]
    (charge,) = charges_of(worker)
    assert team.history(charge.id)[-1] is TaskState.CANCELLED
    assert team.why(charge.id) == "r1 has charged to 35%, enough for the tasks that wait for it"


def test_a_plan_has_a_robot_charge_between_two_tasks(team):
    (worker,) = staff(team, (0.6,), dearer=3.5 * DEAR)
    run(team, [worker], 1.0)
    team.submit(visit("near", 4.0, 5.4))
    team.submit(visit("far", 8.0, 4.0))
    run(team, [worker], 1.0)
    assert (status(team).planned, status(team).skipped) == (1, 0)
    near, far = (team.ask(TASK_EXPLAIN, TaskRequest(id=name), TaskExplanation) for name in ("near", "far"))
    assert near.record.robot == "r1"
    assert far.reason.values["to_soc"] == CHARGED_SOC
    assert far.record.estimate.arrives_in_s > far.record.estimate.starts_in_s + 30.0  # it charges on the way
    assert run(team, [worker], 1500.0, until=all_done(team))
    assert [offer.task.kind for offer in worker.robot.offers] == ["visit", "recharge", "visit"]
    assert worker.least_j > 0.9 * RESERVE_SOC * CAPACITY_J


@pytest.mark.parametrize(("until_soc", "soc", "gain_j"), [(0.75, 0.75, 0.25 * CAPACITY_J), (0.3, 0.5, 0.0)])
def test_a_robot_that_charges_is_planned_with_as_it_will_be_and_with_no_less_than_it_has(until_soc, soc, gain_j):
    has_j = 0.5 * CAPACITY_J
    battery = BatteryState(voltage_v=16.0, current_a=1.0, temperature_c=20.0, soc=0.5, remaining_j=has_j)
    now = RobotState(robot="r1", pose=Pose2D(1.0, 2.0, 3.0), battery=battery, energy=model(has_j))
    then = when_charged(now, AfterCharge(0, Point2D(4.0, 5.0), until_soc))
    assert then.pose == Pose2D(4.0, 5.0, 3.0)
    assert (then.battery.soc, then.battery.remaining_j) == pytest.approx((soc, has_j + gain_j))
    assert then.energy.usable_j == pytest.approx(has_j + CHARGED_SHARE * gain_j)


def test_what_somebody_free_can_do_does_not_wait_for_one_that_charges_though_that_is_cheaper(team):
    low, fresh = staff(team, (0.102, 0.8))
    fresh.dearer = 3.0
    run(team, [low, fresh], 1.0)
    low.robot.plugins.append("camera")
    run(team, [low, fresh], 11.0)
    team.submit(visit("only-r1", 8.5, needs=("camera",)))
    assert run(team, [low, fresh], 30.0, until=lambda: low.at_charger is not None)
    team.submit(visit("beside-r1", 3.8, 2.6))
    run(team, [low, fresh], 0.5)
    assert fresh.robot.offers[-1].task.id == "beside-r1"
    why = team.ask(TASK_EXPLAIN, TaskRequest(id="beside-r1"), TaskExplanation)
    assert {one.robot: one.chosen for one in why.robots} == {"r1": False, "r2": True}


def test_a_task_is_not_given_up_while_its_robot_waits_for_a_charger(team):
    team.begin(None, PlanningPolicy(give_up_s=5.0))
    workers = staff(team, (0.13, 0.1), dearer=DEAR)
    assert run(team, workers, 30.0, until=lambda: workers[1].at_charger is not None)
    team.submit(visit("t1", 7.0, needs=("r1",)))
    run(team, workers, 15.0)
    assert "t1" in team.coordinator.planning.left_out
    assert team.states() == {"t1": TaskState.QUEUED}
    assert run(team, workers, 600.0, until=all_done(team))


def test_a_robot_that_is_halted_while_it_charges_is_counted_on_no_more(team):
    (worker,) = staff(team, (0.102,))
    run(team, [worker], 1.0)
    team.submit(visit("t1", 8.5))
    assert run(team, [worker], 20.0, until=lambda: worker.at_charger is not None)
    assert status(team).planned == 1
    worker.robot.halted = True
    run(team, [worker], 1.5)
    assert status(team).planned == 0


# -- the schedule ---------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_who_waits_is_told_for_which_charger_and_sets_out_so_as_to_be_there_in_time(team):
    ears = Inbox(1000, every=True)
    team.endpoint().subscribe(ears, plan_messages.COORDINATOR_CHARGES)
    workers = staff(team, (0.2, 0.1))
    assert run(team, workers, 30.0, until=lambda: workers[1].at_charger is not None)
    run(team, workers, 12.0)  # the charger's power is known by now
    first, second = status(team).charges
    assert (first.robot, first.is_there, first.behind, first.why) == ("r2", True, "", "")
    assert (second.robot, second.has_set_out, second.behind) == ("r1", False, "r2")
    assert second.why.startswith("waits for the charger at (3.5, 2.5), free in ")
    assert second.why.endswith(" s: r2 has it before")
    assert (second.charger, second.reason.values["behind"]) == (DOCKS[0], "r2")
    assert team.coordinator.part(Charging).waiting == {"r1": second.reason}
    assert second.from_ns >= first.until_ns
    free_ns = first.until_ns
    assert run(team, workers, 60.0, until=lambda: charges_of(workers[0]))
    assert team.clock.now_ns() < free_ns  # it is on its way before the charger is free
    assert run(team, workers, 60.0, until=lambda: workers[0].at_charger is not None)
    assert workers[0].waited_s < 15.0
    told = [received.message.charges for received in ears.drain()]
    assert len(told) < 12
    assert told[-1][-1].robot == "r1"
    assert all(len({one.robot for one in charges}) == len(charges) for charges in told)
    assert run(team, workers, 60.0, until=lambda: status(team).charges == ())


@pytest.mark.parametrize(("to_soc", "is_whole"), [(0.25, [True]), (CHARGED_SOC, [])])
def test_who_has_had_a_short_turn_and_done_nothing_with_it_gets_a_whole_one(team, monkeypatch, to_soc, is_whole):
    seen = []

    def schedule(seekers, power):
        seekers = list(seekers)
        seen.extend((one.name, one.is_whole) for one in seekers if one.bound_for is None)
        return tuple(turn._replace(to_soc=to_soc) for turn in schedule_charges(seekers, power))

    monkeypatch.setattr("robrain.coordinator.parts.charging.schedule_charges", schedule)
    (worker,) = staff(team, (0.2,))
    assert run(team, [worker], 60.0, until=lambda: charges_of(worker))
    assert to_soc_of(charges_of(worker)[0]) == to_soc
    assert set(seen) == {("r1", False)}
    ended = charges_of(worker)[0].id
    seen.clear()
    assert run(team, [worker], 90.0, until=lambda: worker.robot.task.state is TaskState.DONE)
    run(team, [worker], 0.2)
    assert worker.robot.offers[0].task.id == ended
    assert [whole for _, whole in seen[:1]] == is_whole


@pytest.mark.parametrize(("soc", "charges"), [(0.5, True), (0.92, False)])
def test_a_robot_charges_first_for_a_task_that_needs_it(team, soc, charges):
    workers = staff(team, (soc,))
    run(team, workers, 5.0)
    assert charges_of(workers[0]) == []  # with nothing to do it has enough
    team.submit(visit("long", service_s=0.6 * CAPACITY_J / 8.0))
    run(team, workers, 5.0)
    assert status(team).skipped == 0
    assert bool(charges_of(workers[0])) is charges


def test_a_robot_that_refuses_to_charge_is_asked_again_after_half_a_minute(team):
    (worker,) = staff(team, (0.2,))
    worker.robot.accepts = False
    run(team, [worker], 25.0)
    assert len(charges_of(worker)) == 1
    run(team, [worker], 15.0)
    assert len(charges_of(worker)) == 2
